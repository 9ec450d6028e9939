// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace tind {

/// A grid of heights to be shaded: row-major, row 0 southernmost, NaN where there is none.
struct ShadedGrid {
  std::int64_t n_rows = 0, n_cols = 0;
  double east_m = 0, north_m = 0;  ///< Between posts.
  std::span<const float> heights_m;
};

/// Grey values of light from the north-west at 45 degrees (Horn 1981, Hill shading and the reflectance map), heights
/// times `exaggeration`. n_rows x n_cols, NORTHERNMOST row first; 255 where there is no height.
std::vector<std::uint8_t> hillshade(const ShadedGrid& grid, double exaggeration);

/// The whole number >= 1 by which heights must be multiplied for slopes that can be seen.
double visible_exaggeration(const ShadedGrid& grid);

}  // namespace tind
