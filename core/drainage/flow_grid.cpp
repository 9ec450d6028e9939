// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/drainage/flow_grid.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace tind {
namespace {

/// Metres per radian of longitude and of latitude at a latitude (radii of curvature of the ellipsoid).
struct MetresPerRadian {
  double east = 0, north = 0;
};

MetresPerRadian metres_per_radian(const Ellipsoid& ellipsoid, double lat_rad) {
  const double f = 1 / ellipsoid.inverse_flattening, e2 = f * (2 - f);
  const double sin_lat = std::sin(lat_rad), w = 1 - e2 * sin_lat * sin_lat;
  return {ellipsoid.semi_major_m / std::sqrt(w) * std::cos(lat_rad),
          ellipsoid.semi_major_m * (1 - e2) / (w * std::sqrt(w))};
}

}  // namespace

double FlowGrid::step_m(std::int64_t r, int d) const {
  const auto k = static_cast<std::size_t>(d);
  if (kStepRows[k] == 0) return east_m[static_cast<std::size_t>(r)];
  const auto low = static_cast<std::size_t>(kStepRows[k] > 0 ? r : r - 1);
  if (kStepCols[k] == 0) return north_m[low];
  return std::hypot((east_m[low] + east_m[low + 1]) / 2, north_m[low]);
}

FlowGrid make_flow_grid(const HeightField& field, std::uint8_t* marks) {
  FlowGrid g;
  g.n_rows = field.n_rows;
  g.n_cols = field.n_cols;
  g.wraps = field.wraps;
  g.closed_south = field.continues_south;
  g.closed_north = field.continues_north;
  g.heights_m = field.heights_m;
  g.marks = marks;
  // Within a lattice step of a pole all posts of a row are one point.
  const bool south_pole = field.continues_south && field.y0 < 1;
  const bool north_pole =
      field.continues_north && field.post_y(field.n_rows - 1) > static_cast<double>(field.lattice.height()) - 1;
  std::int64_t first = -1, last = -1;
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    const bool pole = (r == 0 && south_pole) || (r == g.n_rows - 1 && north_pole);
    for (std::int64_t i = r * g.n_cols; i < (r + 1) * g.n_cols; ++i) {
      const PostOrigin origin = field.origins[i];
      const bool takes_part =
          origin == PostOrigin::kSource || origin == PostOrigin::kInterpolated || origin == PostOrigin::kFilled;
      marks[i] = 0;
      if (takes_part) marks[i] = kInside;
      if (origin == PostOrigin::kFilled) marks[i] |= kVoid;
      if (pole) marks[i] = kClosed;
      if (takes_part) {
        if (first < 0) first = r;
        last = r;
      }
    }
  }
  const double step_rad = field.lattice.step_deg() * std::numbers::pi / 180;
  const auto lat_of = [&](double row) {
    return std::clamp((field.y0 + row * field.dy) * step_rad - std::numbers::pi / 2, -std::numbers::pi / 2,
                      std::numbers::pi / 2);
  };
  // A post within a millionth of a step of the pole still has a width, so that slopes stay finite.
  const double least_east_m = 1e-6 * field.dx * step_rad * field.lattice.ellipsoid.semi_major_m;
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    const double east = metres_per_radian(field.lattice.ellipsoid, lat_of(static_cast<double>(r))).east;
    g.east_m.push_back(std::max(east * field.dx * step_rad, least_east_m));
    const double north = metres_per_radian(field.lattice.ellipsoid, lat_of(static_cast<double>(r) + 0.5)).north;
    g.north_m.push_back(north * field.dy * step_rad);
  }
  const MetresPerRadian middle =
      metres_per_radian(field.lattice.ellipsoid, lat_of(static_cast<double>(first + last) / 2));
  g.cell_area_m2 = std::max(middle.east * field.dx * step_rad, least_east_m) * middle.north * field.dy * step_rad;
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    const double cells = g.area_m2(r) / g.cell_area_m2;
    g.share.push_back(static_cast<std::uint64_t>(std::max<std::int64_t>(1, std::llround(cells * double{kCell}))));
  }
  return g;
}

FlowGrid make_flow_grid(const float* heights_m, std::int64_t n_rows, std::int64_t n_cols, double east_m, double north_m,
                        std::uint8_t* marks) {
  FlowGrid g;
  g.n_rows = n_rows;
  g.n_cols = n_cols;
  g.heights_m = heights_m;
  g.marks = marks;
  g.east_m.assign(static_cast<std::size_t>(n_rows), east_m);
  g.north_m.assign(static_cast<std::size_t>(n_rows), north_m);
  g.share.assign(static_cast<std::size_t>(n_rows), kCell);
  g.cell_area_m2 = east_m * north_m;
  for (std::int64_t i = 0; i < g.size(); ++i) {
    marks[i] = 0;
    if (std::isfinite(heights_m[i])) marks[i] = kInside;
  }
  return g;
}

void mark_outlets(const FlowGrid& g) {
  bool any = false;
  std::int64_t lowest = -1;
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    for (std::int64_t c = 0; c < g.n_cols; ++c) {
      const std::int64_t i = r * g.n_cols + c;
      if (!(g.marks[i] & kInside)) continue;
      bool outlet = (g.marks[i] & kSea) != 0;
      for (int d = 0; d < 8 && !outlet; ++d) {
        const std::int64_t n = g.neighbour(r, c, d), rr = r + kStepRows[static_cast<std::size_t>(d)];
        if (n >= 0) {
          outlet = !(g.marks[n] & (kInside | kClosed));
        } else {
          outlet = !(rr < 0 ? g.closed_south : rr >= g.n_rows && g.closed_north);
        }
      }
      if (outlet) g.marks[i] |= kOutlet;
      any = any || outlet;
      if (lowest < 0 || g.heights_m[i] < g.heights_m[lowest]) lowest = i;
    }
  }
  if (!any && lowest >= 0) g.marks[lowest] |= kOutlet;
}

}  // namespace tind
