// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/drainage/flow_grid.hpp"

#include <algorithm>
#include <atomic>
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

FlowGrid make_flow_grid(const HeightField& field, std::uint8_t* marks, const FlowRun& run) {
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
  std::vector<std::uint8_t> row_takes_part(static_cast<std::size_t>(g.n_rows), 0);
  for_row_bands(run, g.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
    for (std::int64_t r = row_begin; r < row_end; ++r) {
      const bool pole = (r == 0 && south_pole) || (r == g.n_rows - 1 && north_pole);
      std::uint8_t any = 0;
      for (std::int64_t i = r * g.n_cols; i < (r + 1) * g.n_cols; ++i) {
        const PostOrigin origin = field.origins[i];
        const bool filled = origin == PostOrigin::kFilled;
        const bool known = origin == PostOrigin::kSource || origin == PostOrigin::kInterpolated;
        const auto mark = static_cast<std::uint8_t>((known || filled ? kInside : 0) | (filled ? kVoid : 0));
        any = static_cast<std::uint8_t>(any | mark);
        marks[i] = pole ? kClosed : mark;
      }
      row_takes_part[static_cast<std::size_t>(r)] = any & kInside;
    }
  });
  std::int64_t first = -1, last = -1;
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    if (!row_takes_part[static_cast<std::size_t>(r)]) continue;
    if (first < 0) first = r;
    last = r;
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

namespace {

// Sets kOutlet in a row; true iff it has one.
bool mark_row(const FlowGrid& g, std::int64_t r, std::vector<std::uint8_t>& leaves) {
  const std::int64_t n = g.n_cols;
  // Whether water may leave over a post of this row, or of the two beside it in its column.
  const auto open = [&](std::int64_t rr, bool closed) {
    if (rr < 0 || rr >= g.n_rows) {
      if (closed) return;
      std::fill(leaves.begin(), leaves.end(), std::uint8_t{1});
      return;
    }
    const std::uint8_t* const row = g.marks + rr * n;
    for (std::int64_t c = 0; c < n; ++c) {
      const std::uint8_t out = (row[c] & (kInside | kClosed)) == 0 ? 1 : 0;
      leaves[static_cast<std::size_t>(c)] = static_cast<std::uint8_t>(leaves[static_cast<std::size_t>(c)] | out);
    }
  };
  std::fill(leaves.begin(), leaves.end(), std::uint8_t{0});
  open(r - 1, g.closed_south);
  open(r, false);
  open(r + 1, g.closed_north);
  std::uint8_t* const row = g.marks + r * n;
  std::uint8_t any = 0;
  const auto mark = [&](std::int64_t c, std::uint8_t west, std::uint8_t east) {
    const bool out = (west | leaves[static_cast<std::size_t>(c)] | east) != 0 || (row[c] & kSea);
    const std::uint8_t bit = (row[c] & kInside) && out ? kOutlet : std::uint8_t{0};
    row[c] = static_cast<std::uint8_t>(row[c] | bit);
    any = static_cast<std::uint8_t>(any | bit);
  };
  for (std::int64_t c = 1; c + 1 < n; ++c) {
    mark(c, leaves[static_cast<std::size_t>(c - 1)], leaves[static_cast<std::size_t>(c + 1)]);
  }
  const std::uint8_t beyond = g.wraps ? 0 : 1;
  mark(0, g.wraps ? leaves.back() : beyond, n > 1 ? leaves[1] : beyond);
  if (n > 1) mark(n - 1, leaves[static_cast<std::size_t>(n - 2)], g.wraps ? leaves.front() : beyond);
  return any != 0;
}

}  // namespace

void mark_outlets(const FlowGrid& g, const FlowRun& run) {
  std::atomic<bool> any{false};
  for_row_bands(run, g.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
    std::vector<std::uint8_t> leaves(static_cast<std::size_t>(g.n_cols));
    for (std::int64_t r = row_begin; r < row_end; ++r) {
      if (mark_row(g, r, leaves)) any = true;
    }
  });
  if (any || run.stopped()) return;
  std::int64_t lowest = -1;
  for (std::int64_t i = 0; i < g.size(); ++i) {
    if ((g.marks[i] & kInside) && (lowest < 0 || g.heights_m[i] < g.heights_m[lowest])) lowest = i;
  }
  if (lowest >= 0) g.marks[lowest] |= kOutlet;
}

}  // namespace tind
