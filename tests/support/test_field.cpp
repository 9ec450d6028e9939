// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/support/test_field.hpp"

#include <cmath>

namespace tind::test {

TestField::TestField(const GridPlace& place, const HeightAt& height) {
  const std::int64_t n_posts = place.n_rows * place.n_cols;
  heights_m.reserve(static_cast<std::size_t>(n_posts));
  for (std::int64_t r = 0; r < place.n_rows; ++r) {
    for (std::int64_t c = 0; c < place.n_cols; ++c) heights_m.push_back(static_cast<float>(height(r, c)));
  }
  origins.assign(heights_m.size(), PostOrigin::kSource);
  field.lattice.level = place.lattice_level;
  field.lattice.height_exponent = place.height_exponent;
  field.n_rows = place.n_rows;
  field.n_cols = place.n_cols;
  field.x0 = place.x0;
  field.y0 = place.y0;
  field.dx = place.dx;
  field.dy = place.dy;
  field.base_height_m = place.base_height_m;
  field.heights_m = heights_m.data();
  field.origins = origins.data();
}

double noise(std::uint64_t seed, std::int64_t a, std::int64_t b) {
  // splitmix64
  std::uint64_t v = seed * 0x9E3779B97F4A7C15ull + static_cast<std::uint64_t>(a) * 0xBF58476D1CE4E5B9ull +
                    static_cast<std::uint64_t>(b) * 0x94D049BB133111EBull;
  v = (v ^ (v >> 30)) * 0xBF58476D1CE4E5B9ull;
  v = (v ^ (v >> 27)) * 0x94D049BB133111EBull;
  return static_cast<double>((v ^ (v >> 31)) >> 11) * 0x1p-53;
}

HeightAt rough_terrain(std::uint64_t seed, double amplitude_m) {
  return [=](std::int64_t r, std::int64_t c) {
    double height = amplitude_m / 10 * noise(seed, r, c), share = amplitude_m / 2;
    for (const double period : {32.0, 16.0, 8.0, 4.0}) {
      const double u = static_cast<double>(c) / period, v = static_cast<double>(r) / period;
      const double i = std::floor(u), j = std::floor(v), a = u - i, b = v - j;
      const auto at = [&](int di, int dj) {
        return noise(seed + static_cast<std::uint64_t>(period), static_cast<std::int64_t>(i) + di,
                     static_cast<std::int64_t>(j) + dj);
      };
      height += share * ((1 - b) * ((1 - a) * at(0, 0) + a * at(1, 0)) + b * ((1 - a) * at(0, 1) + a * at(1, 1)));
      share /= 2;
    }
    return height;
  };
}

GridPlace place_over(std::uint8_t level, std::int64_t x, std::int64_t y, int lattice_level, double spacing,
                     int overlap) {
  GridPlace place;
  place.lattice_level = lattice_level;
  const double side = std::ldexp(1.0, 16 + lattice_level - level);
  place.dx = place.dy = spacing;
  place.n_rows = place.n_cols = static_cast<std::int64_t>(std::ceil(side / spacing)) + 2 * overlap;
  place.x0 = static_cast<double>(x) * side - overlap * spacing + 0.37 * spacing;
  place.y0 = static_cast<double>(y) * side - overlap * spacing + 0.59 * spacing;
  return place;
}

}  // namespace tind::test
