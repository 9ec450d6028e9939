// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <vector>

#include "core/result.hpp"
#include "storage/readers/pixel_transform.hpp"

namespace tind {

/// Where a raster lies on the globe and how fine it is there (docs/decisions/0005-warped-posts.md).
struct WarpExtent {
  double west_deg = 0, width_deg = 0;  ///< All around the globe: width_deg == 360.
  double south_deg = 0, north_deg = 0;
  double cells_per_degree_east = 0, cells_per_degree_north = 0;  ///< The most that any sample has.
};

/// Posts of one source on the common grid: column i at i / lon_per_degree degrees, row j at j / lat_per_degree.
struct WarpWindow {
  std::int64_t first_col = 0, first_row = 0, n_cols = 0, n_rows = 0;
};

struct WarpGrid {
  std::int64_t lon_per_degree = 1, lat_per_degree = 1;
  std::vector<WarpWindow> windows;  ///< One per source, same order.
};

/// kInvalidInput: nothing of the raster lies on the globe.
Result<WarpExtent> measure_extent(const RasterFile& file, const PixelTransform& transform);

/// The coarsest grid of whole parts of a degree that is nowhere coarser than any source. kInvalidInput names the first
/// source that makes it absurdly large.
Result<WarpGrid> plan_warp(const std::vector<WarpExtent>& extents, const std::vector<RasterFile>& files);

}  // namespace tind
