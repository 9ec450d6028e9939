// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "core/result.hpp"
#include "storage/readers/raster_file.hpp"

namespace tind {

/// A place: longitude and latitude in degrees, or column and row in cells (cell (c, r) reaches from c to c + 1 and from
/// r to r + 1, its centre is at c + 0.5, r + 0.5). Not finite: no such place.
struct Place {
  double x = 0, y = 0;
};

/// Exact way between WGS 84 longitude and latitude (EPSG:4326) and the cells of one raster, through PROJ and the
/// raster's geotransform. One coordinate operation for the whole raster: the one that PROJ takes for its middle.
/// One thread at a time.
class PixelTransform {
 public:
  /// kInvalidInput: PROJ knows no operation, or none that works in the middle of the raster.
  static Result<PixelTransform> create(const RasterFile& file);
  PixelTransform(PixelTransform&&) noexcept;
  PixelTransform& operator=(PixelTransform&&) noexcept;
  ~PixelTransform();

  /// Longitudes and latitudes in degrees become columns and rows, in place. Where the raster's coordinates repeat
  /// around the globe (longitudes, Mercator), the turn is taken that lies inside the raster, if one does.
  void to_cells(std::span<Place> places) const;
  /// Columns and rows become longitudes and latitudes in degrees, in place; infinite where the cell is not on the
  /// globe: where to_cells() does not come back to within kReturnCells. Rows of a geographic raster beyond a pole are
  /// taken as the pole.
  void to_globe(std::span<Place> places) const;

  static constexpr double kReturnCells = 0.1;
  bool is_inside(const Place& cell) const;  ///< In [0, n_cols) x [0, n_rows).
  /// Columns and rows of one turn around the globe, if the coordinates repeat.
  const std::optional<Place>& turn() const;
  /// The operation from EPSG:4326 to the raster's CRS as a PROJ pipeline.
  const std::string& operation() const;

 private:
  struct Impl;
  explicit PixelTransform(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace tind
