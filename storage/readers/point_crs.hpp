// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/result.hpp"
#include "storage/readers/las.hpp"

class OGRSpatialReference;
class OGRCoordinateTransformation;

namespace tind {

/// What a point file's numbers mean: where x and y lie on the globe, and how many metres a unit of z has. Through GDAL
/// and PROJ. Moves only; one thread at a time.
class PointCrs {
 public:
  /// From anything that OGR takes: "EPSG:2949", "EPSG:2949+5713", WKT, PROJ strings. `what` is for messages.
  static Result<PointCrs> from_user_input(const std::string& text, const std::string& what);
  /// From the records of a LAS file: its WKT, else its GeoTIFF keys; nullopt when it has neither.
  static Result<std::optional<PointCrs>> from_las(const LasCrs& crs, const std::string& path);
  PointCrs(PointCrs&&) noexcept;
  PointCrs& operator=(PointCrs&&) noexcept;
  ~PointCrs();

  std::string name;                     ///< The CRS's own name, and its code in brackets where it has one.
  std::string vertical_datum;           ///< What it says that heights are; empty: nothing.
  std::string height_kind = "unknown";  ///< "orthometric", "ellipsoidal" or "unknown".
  /// Metres per unit of z: the vertical part's, else the GeoTIFF key's (VerticalUnits 4099), else the linear unit of
  /// the plan coordinates (the convention of ASPRS); nullopt: it says nothing.
  std::optional<double> metres_per_z_unit;

  /// Longitudes and latitudes (WGS 84, EPSG:4326) in degrees, in place. A point that has none gets infinities. Returns
  /// how many these are.
  std::size_t to_degrees(std::span<double> x, std::span<double> y) const;

 private:
  PointCrs();
  Result<void> set_up(OGRSpatialReference& crs, const std::string& what);
  std::unique_ptr<OGRCoordinateTransformation> transform_;  ///< None: x and y are the degrees.
  bool is_identity_ = false;
};

}  // namespace tind
