// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "tests/client/source_posts.hpp"
#include "tests/client/tile_id.hpp"

namespace tind::client {

/// A point of a surface over a tile: lattice steps from the SW corner, metres. Lattice integers up to 2^45 are exact
/// here.
struct SurfacePoint {
  double x = 0, y = 0, z_m = 0;
};

/// The posts that lie in the closed area of a tile: rows row0.. and columns column0.. of the grid, post (row0 + r,
/// column0 + c) at (x + c * dx, y + r * dy) steps from the tile's SW corner.
struct PostWindow {
  std::int64_t row0 = 0, column0 = 0, n_rows = 0, n_columns = 0;
  double x = 0, y = 0, dx = 0, dy = 0;
  double nudge = 0;  ///< A post so close (steps) to a line counts as lying on it: the rounding of its real position.

  double post_x(std::int64_t c) const { return x + static_cast<double>(c) * dx; }
  double post_y(std::int64_t r) const { return y + static_cast<double>(r) * dy; }
};

/// The windows of a tile: one, or two where the grid and the tile meet on both sides of longitude 180. Empty ones are
/// left out.
std::vector<PostWindow> post_windows(const SourcePosts& posts, const LatticeFrame& frame, const TileId& id);

/// Calls visit(r, c, z_m) for every post of the window in the closed triangle, with the surface's height at the post's
/// own real position. Heights are interpolated along the triangle's sides, then along the row, so a sliver cannot leave
/// the range of its corners.
template <class Visit>
void scan_triangle(const std::array<SurfacePoint, 3>& p, const PostWindow& w, const Visit& visit) {
  const double low = std::min({p[0].y, p[1].y, p[2].y}), high = std::max({p[0].y, p[1].y, p[2].y});
  const auto first_row = std::max<std::int64_t>(0, static_cast<std::int64_t>(std::ceil((low - w.y - w.nudge) / w.dy)));
  const auto last_row =
      std::min<std::int64_t>(w.n_rows - 1, static_cast<std::int64_t>(std::floor((high - w.y + w.nudge) / w.dy)));
  for (std::int64_t r = first_row; r <= last_row; ++r) {
    const double y = std::clamp(w.post_y(r), low, high);
    double xl = 1e300, xr = -1e300, zl = 0, zr = 0;
    const auto meet = [&](double x, double z) {
      if (x < xl) {
        xl = x;
        zl = z;
      }
      if (x > xr) {
        xr = x;
        zr = z;
      }
    };
    for (std::size_t k = 0; k < 3; ++k) {
      const SurfacePoint& a = p[k];
      const SurfacePoint& b = p[(k + 1) % 3];
      if (y < std::min(a.y, b.y) || y > std::max(a.y, b.y)) continue;
      if (a.y == b.y) {
        meet(a.x, a.z_m);
        meet(b.x, b.z_m);
      } else {
        const double t = (y - a.y) / (b.y - a.y);
        meet(a.x + t * (b.x - a.x), a.z_m + t * (b.z_m - a.z_m));
      }
    }
    const auto first = std::max<std::int64_t>(0, static_cast<std::int64_t>(std::ceil((xl - w.x - w.nudge) / w.dx)));
    const auto last =
        std::min<std::int64_t>(w.n_columns - 1, static_cast<std::int64_t>(std::floor((xr - w.x + w.nudge) / w.dx)));
    const double slope = xr > xl ? (zr - zl) / (xr - xl) : 0;
    for (std::int64_t c = first; c <= last; ++c) {
      visit(r, c, zl + (std::clamp(w.post_x(c), xl, xr) - xl) * slope);
    }
  }
}

/// How far a surface height is from the values that the sources have for one post.
struct PostErrors {
  double nearest = 0;   ///< Distance to the nearest value.
  double farthest = 0;  ///< Distance to the farthest value.
};

/// Distances of `z_m` from every value at grid index `at`, which must have one.
PostErrors post_errors(const SourcePosts& posts, std::int64_t at, double z_m);

/// What |TIN - h| may exceed E_L by without being an error: rounding of this program's own arithmetic, and of heights
/// that are no floats.
double error_slack_m(const SourcePosts& posts, double height_m);

}  // namespace tind::client
