// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "core/height_field.hpp"

namespace tind::test {

/// Where a made-up grid of posts lies.
struct GridPlace {
  int lattice_level = 0;
  int height_exponent = 4;
  double x0 = 0, y0 = 0, dx = 256, dy = 256;  ///< as in HeightField
  std::int64_t n_rows = 0, n_cols = 0;
  double base_height_m = 0;
};

using HeightAt = std::function<double(std::int64_t row, std::int64_t col)>;

/// A HeightField that owns its arrays. All posts are source posts at first; change `origins` and `field` at will.
struct TestField {
  std::vector<float> heights_m;
  std::vector<PostOrigin> origins;
  HeightField field;

  TestField(const GridPlace& place, const HeightAt& height);
  TestField(TestField&&) = default;
};

/// Reproducible noise in [0, 1) from integers; no state.
double noise(std::uint64_t seed, std::int64_t a, std::int64_t b);

/// Mountains: four octaves of interpolated noise of the given amplitude, and white noise of a tenth of it.
HeightAt rough_terrain(std::uint64_t seed, double amplitude_m);

/// Posts over tile `key`, `overlap` of them beyond each side, `spacing` lattice steps apart from an uneven origin.
GridPlace place_over(std::uint8_t level, std::int64_t x, std::int64_t y, int lattice_level, double spacing,
                     int overlap);

}  // namespace tind::test
