// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/height_field.hpp"

#include <cmath>
#include <tuple>
#include <utility>

namespace tind {
namespace {

/// Rounding slack of the half lattice step within which a point belongs to a post row or column, so that an ulp does
/// not decide.
constexpr double kSnapSteps = 0.5 + 0x1p-10;

/// A position along one axis of the grid: between post `index` and the next, `fraction` of the way.
struct AxisPosition {
  std::int64_t index = 0;
  double fraction = 0;
};

/// `steps`: lattice steps from post 0. With `snap` a point within half a step of a post is moved onto it.
AxisPosition locate(double steps, double spacing, bool snap) {
  const double u = steps / spacing;
  const double nearest = std::floor(u + 0.5);
  if (snap && std::abs(steps - nearest * spacing) <= kSnapSteps) return {static_cast<std::int64_t>(nearest), 0.0};
  const double below = std::floor(u);
  return {static_cast<std::int64_t>(below), u - below};
}

double mix(double a, double b, double fraction) { return (1.0 - fraction) * a + fraction * b; }

/// Samples a field at lattice position (x, y), x in [0, width), y in [0, height].
double sample(const HeightField& f, double x, double y, bool snap) {
  const double width = static_cast<double>(f.lattice.width()), height = static_cast<double>(f.lattice.height());
  const double north_y = f.post_y(f.n_rows - 1);
  // The fast way out: most of a globe is base.
  const bool beyond_south = y<f.y0 - kSnapSteps, beyond_north = y> north_y + kSnapSteps;
  if ((beyond_south && !f.continues_south) || (beyond_north && !f.continues_north)) return f.base_height_m;

  double east = x - f.x0;
  if (east < 0) east += width;
  const double span = static_cast<double>(f.n_cols - 1) * f.dx;
  if (!f.wraps && east > span + 0.5 * (width - span)) east -= width;  // nearer to the grid's western side
  AxisPosition col = locate(east, f.dx, snap);
  bool outside = false;
  if (f.wraps) {
    col.index %= f.n_cols;
  } else {
    outside = col.index < 0 || col.index > f.n_cols - 1 || (col.index == f.n_cols - 1 && col.fraction > 0);
  }
  const std::int64_t next_col = f.wraps && col.index == f.n_cols - 1 ? 0 : col.index + 1;
  const bool south_row_is_pole = f.continues_south && f.y0 <= kSnapSteps;
  const bool north_row_is_pole = f.continues_north && north_y >= height - kSnapSteps;
  const auto on_row = [&](std::int64_t r) {
    if (r == 0 && south_row_is_pole) return f.south_pole_m;
    if (r == f.n_rows - 1 && north_row_is_pole) return f.north_pole_m;
    if (outside) return f.base_height_m;
    const double a = f.height_at(r, col.index);
    return col.fraction == 0 ? a : mix(a, f.height_at(r, next_col), col.fraction);
  };

  if (beyond_south) return south_row_is_pole ? f.south_pole_m : mix(f.south_pole_m, on_row(0), y / f.y0);
  if (beyond_north) {
    const double from_pole = height - y, last_from_pole = height - north_y;
    return north_row_is_pole ? f.north_pole_m : mix(f.north_pole_m, on_row(f.n_rows - 1), from_pole / last_from_pole);
  }
  AxisPosition row = locate(y - f.y0, f.dy, snap);
  // Within the slack of the first and last row.
  if (row.index < 0) row = {0, 0.0};
  if (row.index >= f.n_rows - 1) row = {f.n_rows - 1, 0.0};
  const double south = on_row(row.index);
  return row.fraction == 0 ? south : mix(south, on_row(row.index + 1), row.fraction);
}

}  // namespace

const PointPost* PointBlocks::find(std::int64_t x, std::int64_t y) const {
  const PointPost* found = nullptr;
  // A point belongs to the block of its real position: one that rounds to (x, y) may lie in a block beside.
  const double at_x = static_cast<double>(x), at_y = static_cast<double>(y);
  using Key = std::pair<std::int64_t, std::int64_t>;
  const auto key = [](const PointPost& p) { return Key{std::llround(p.y), std::llround(p.x)}; };
  const auto index = [this](double v, double origin) {
    return static_cast<std::int64_t>(std::floor((v - origin) / side));
  };
  for (std::int64_t r = index(at_y - 0.5, y0); r <= index(at_y + 0.5, y0); ++r) {
    for (std::int64_t c = index(at_x - 0.5, x0); c <= index(at_x + 0.5, x0); ++c) {
      if (r < 0 || c < 0 || r >= n_rows || c >= n_cols) continue;
      const std::span<const PointPost> posts_of = block(r, c);
      const auto at = std::lower_bound(posts_of.begin(), posts_of.end(), Key{y, x},
                                       [&](const PointPost& p, const Key& k) { return key(p) < k; });
      if (at != posts_of.end() && key(*at) == Key{y, x}) found = &*at;
    }
  }
  return found;
}

double HeightField::sample_m(double x, double y) const {
  const double width = static_cast<double>(lattice.width());
  x -= width * std::floor(x / width);
  return sample(*this, x < width ? x : 0.0, y, false);
}

std::int32_t HeightField::lattice_height(std::int64_t x, std::int64_t y) const {
  const std::int64_t width = lattice.width();
  if (x < 0 || x >= width) x = ((x % width) + width) % width;
  if (const auto z = pinned.find(x, y)) return *z;
  if (!points.empty()) {
    for (const std::int64_t turn : {std::int64_t{0}, width}) {
      if (const PointPost* p = points.find(x + turn, y)) {
        return lattice.height_from_m(static_cast<double>(p->height_m));
      }
    }
  }
  return lattice.height_from_m(sample(*this, static_cast<double>(x), static_cast<double>(y), true));
}

}  // namespace tind
