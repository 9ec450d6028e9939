// SPDX-License-Identifier: GPL-3.0-or-later
// Posts of rasters that are no grid of degrees: only the client's source_* files include this.
#pragma once

#include <vector>

#include "tests/client/source_raster.hpp"

namespace tind::client {

/// One value at (column, row) of a raster, counted in cells from its north-west corner (centres at + 0.5), as
/// docs/verify.md has it: void unless the cell there has a height; between the four nearest centres bilinear, void ones
/// dropped and the other weights scaled up; `cubic` (Keys, a = -0.5) where all sixteen centres have heights. NaN: no
/// value. `uncertain` is set when a millionth of a cell decides whether there is a value, or which.
double interpolate_cells(const CellWindow& window, double column, double row, bool cubic, bool& uncertain);

/// Makes the posts at whole multiples of the claim's spacing that lie on the rasters.
Outcome<SourcePosts> read_warped(const std::vector<SourceRaster>& rasters, const GridClaim& claim);

}  // namespace tind::client
