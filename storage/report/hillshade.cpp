// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/report/hillshade.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

namespace tind {
namespace {

/// Root mean square slope that reads well under light at 45 degrees.
constexpr double kVisibleSlope = 0.3;
constexpr double kMostExaggeration = 50;
constexpr std::uint8_t kNoData = 255;

struct Slope {
  double east = 0, north = 0;
};

/// Horn's slope from the eight neighbours; those beyond the grid, or without a height, count as the post itself.
std::optional<Slope> slope_at(const ShadedGrid& g, std::int64_t r, std::int64_t c) {
  const float own = g.heights_m[static_cast<std::size_t>(r * g.n_cols + c)];
  if (std::isnan(own)) return std::nullopt;
  const auto z = [&](std::int64_t dr, std::int64_t dc) {
    const std::int64_t rr = std::clamp<std::int64_t>(r + dr, 0, g.n_rows - 1);
    const std::int64_t cc = std::clamp<std::int64_t>(c + dc, 0, g.n_cols - 1);
    const float height = g.heights_m[static_cast<std::size_t>(rr * g.n_cols + cc)];
    return static_cast<double>(std::isnan(height) ? own : height);
  };
  const double east = (z(1, 1) + 2 * z(0, 1) + z(-1, 1)) - (z(1, -1) + 2 * z(0, -1) + z(-1, -1));
  const double north = (z(1, -1) + 2 * z(1, 0) + z(1, 1)) - (z(-1, -1) + 2 * z(-1, 0) + z(-1, 1));
  return Slope{east / (8 * g.east_m), north / (8 * g.north_m)};
}

}  // namespace

std::vector<std::uint8_t> hillshade(const ShadedGrid& g, double exaggeration) {
  // Towards the light: from the north-west, 45 degrees up.
  const double across = 0.5, up = std::numbers::sqrt2 / 2;
  std::vector<std::uint8_t> grey;
  grey.reserve(static_cast<std::size_t>(g.n_rows * g.n_cols));
  for (std::int64_t r = g.n_rows; r-- > 0;) {
    for (std::int64_t c = 0; c < g.n_cols; ++c) {
      const auto slope = slope_at(g, r, c);
      if (!slope) {
        grey.push_back(kNoData);
        continue;
      }
      const double p = slope->east * exaggeration, q = slope->north * exaggeration;
      const double light = (p * across - q * across + up) / std::sqrt(1 + p * p + q * q);
      grey.push_back(static_cast<std::uint8_t>(std::lround(std::clamp(light, 0.0, 1.0) * 254)));
    }
  }
  return grey;
}

double visible_exaggeration(const ShadedGrid& g) {
  double squares = 0;
  std::int64_t n = 0;
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    for (std::int64_t c = 0; c < g.n_cols; ++c) {
      if (const auto slope = slope_at(g, r, c)) {
        squares += slope->east * slope->east + slope->north * slope->north;
        ++n;
      }
    }
  }
  const double rms = n ? std::sqrt(squares / static_cast<double>(n)) : 0;
  return rms > 0 ? std::clamp(std::round(kVisibleSlope / rms), 1.0, kMostExaggeration) : 1;
}

}  // namespace tind
