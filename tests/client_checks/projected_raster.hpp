// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <functional>
#include <optional>
#include <string>

namespace tind::test {

/// A GeoTIFF of Float32 to write, in any coordinate system.
struct ProjectedPlan {
  std::string crs = "EPSG:32611";
  std::array<double, 6> transform = {400000, 30, 0, 3800000, 0, -30};  ///< As GDAL's.
  int n_columns = 60, n_rows = 50;
  std::optional<double> nodata;
  std::string unit;
  bool pixel_is_point = false;
  /// Height of the cell whose CENTRE is at (x, y) of the system.
  std::function<double(double x, double y)> height = [](double x, double y) {
    return 500 + 0.01 * (x - 400000) - 0.02 * (y - 3800000);
  };
};

/// Writes it; a path that starts with /vsimem/ stays in memory.
void write_projected(const std::string& path, const ProjectedPlan& plan);

/// (lon, lat) in degrees of WGS 84 in the plan's system.
std::array<double, 2> project(const std::string& crs, double lon_deg, double lat_deg);

}  // namespace tind::test
