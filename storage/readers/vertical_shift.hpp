// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <memory>
#include <span>
#include <string>

#include "core/result.hpp"
#include "storage/readers/pixel_transform.hpp"

namespace tind {

/// What the heights of the input are, as the user says it, and the way to heights above the ellipsoid of WGS 84
/// (docs/decisions/0006-vertical-datum.md). One thread at a time.
class VerticalShift {
 public:
  /// `vertical_datum`: a vertical, compound or three-dimensional geographic CRS by any name that PROJ knows, or empty.
  /// `geoid`: path of a grid that PROJ reads (N in metres), or empty; it is what shifts when both are given. One must
  /// not be empty. kInvalidInput: not such a CRS, PROJ knows no way, or the grid is not there or no grid.
  static Result<VerticalShift> create(const std::string& vertical_datum, const std::string& geoid);
  VerticalShift(VerticalShift&&) noexcept;
  VerticalShift& operator=(VerticalShift&&) noexcept;
  ~VerticalShift();

  double unit_m() const;                 ///< Metres per unit of the CRS; 1 without one.
  const std::string& datum() const;      ///< Name of what the input's heights are.
  const std::string& ellipsoid() const;  ///< Datum whose ellipsoid the heights are above after apply(); after settle().
  const std::string& operation() const;  ///< PROJ's; empty: the heights are ellipsoidal already.

  /// Chooses among PROJ's operations the one for the middle of the data, longitude and latitude in degrees. To be
  /// called once before apply(). kInvalidInput as create().
  Result<void> settle(const Place& middle);
  /// h = H + N in place, metres; voids (NaN) stay. places: longitude, latitude in degrees. kInvalidInput: the grid has
  /// no value at a place.
  Result<void> apply(std::span<const Place> places, float* heights_m) const;

 private:
  struct Impl;
  explicit VerticalShift(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace tind
