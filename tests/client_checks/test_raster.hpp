// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <functional>
#include <optional>
#include <string>

namespace tind::test {

/// A GeoTIFF to write: Int16 metres, EPSG:4326, `n` x `n` posts 0.01 degrees apart whose first is at (west, north).
struct RasterPlan {
  int n = 200;
  double west_deg = 10, north_deg = 46;
  double rotation = 0;  ///< Makes the file one that is not north-up.
  std::optional<double> nodata;
  std::function<int(int row, int column)> height_m = [](int r, int c) {
    return 400 + ((r * 37 + c * 91) % 173) * 5 + r * 2;
  };
};

void write_raster(const std::string& path, const RasterPlan& plan);

}  // namespace tind::test
