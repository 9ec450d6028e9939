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

/// A triangle cut by a line of constant y: from (left, its height) to (right, its height).
struct TriangleRow {
  double left = 1e300, right = -1e300, z_left = 0, z_right = 0;

  /// Heights are interpolated along the triangle's sides, so a sliver cannot leave the range of its corners.
  TriangleRow(const std::array<SurfacePoint, 3>& p, double y) {
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
  }
  double height_m(double x) const {
    const double slope = right > left ? (z_right - z_left) / (right - left) : 0;
    return z_left + (std::clamp(x, left, right) - left) * slope;
  }

 private:
  void meet(double x, double z) {
    if (x < left) {
      left = x;
      z_left = z;
    }
    if (x > right) {
      right = x;
      z_right = z;
    }
  }
};

/// Calls visit(r, c, z_m) for every post of the window in the closed triangle, with the surface's height at the post's
/// own real position.
template <class Visit>
void scan_triangle(const std::array<SurfacePoint, 3>& p, const PostWindow& w, const Visit& visit) {
  const double low = std::min({p[0].y, p[1].y, p[2].y}), high = std::max({p[0].y, p[1].y, p[2].y});
  const auto first_row = std::max<std::int64_t>(0, static_cast<std::int64_t>(std::ceil((low - w.y - w.nudge) / w.dy)));
  const auto last_row =
      std::min<std::int64_t>(w.n_rows - 1, static_cast<std::int64_t>(std::floor((high - w.y + w.nudge) / w.dy)));
  for (std::int64_t r = first_row; r <= last_row; ++r) {
    const TriangleRow row(p, std::clamp(w.post_y(r), low, high));
    const auto first =
        std::max<std::int64_t>(0, static_cast<std::int64_t>(std::ceil((row.left - w.x - w.nudge) / w.dx)));
    const auto last = std::min<std::int64_t>(w.n_columns - 1,
                                             static_cast<std::int64_t>(std::floor((row.right - w.x + w.nudge) / w.dx)));
    for (std::int64_t c = first; c <= last; ++c) visit(r, c, row.height_m(w.post_x(c)));
  }
}

/// The posts in the closed area of one tile, of any kind of source, numbered from 0: their slots. A slot of a grid may
/// hold no post. `posts` must outlive it; const access is thread safe.
class TilePosts {
 public:
  /// A slot's index in SourcePosts, and where it lies: steps from the tile's SW corner.
  struct Place {
    std::int64_t at = 0;
    double x = 0, y = 0;
  };

  TilePosts(const SourcePosts& posts, const LatticeFrame& frame, const TileId& id);

  std::size_t size() const { return n_slots_; }
  bool empty() const { return n_slots_ == 0; }
  /// A post so close (steps) to a line counts as lying on it.
  double nudge() const { return nudge_; }
  Place place(std::size_t slot) const;
  bool has(std::size_t slot) const { return posts_->has(place(slot).at); }

  /// Calls visit(slot, z_m) for every slot in the closed triangle, with the surface's height there.
  template <class Visit>
  void scan(const std::array<SurfacePoint, 3>& p, const Visit& visit) const {
    for (const Window& w : windows_) {
      scan_triangle(p, w.window, [&](std::int64_t r, std::int64_t c, double z) {
        visit(w.first_slot + static_cast<std::size_t>(r * w.window.n_columns + c), z);
      });
    }
    if (!places_.empty()) scan_points(p, visit);
  }

 private:
  struct Window {
    PostWindow window;
    std::size_t first_slot = 0;
  };
  std::size_t bin_of(double steps) const {
    return static_cast<std::size_t>(std::clamp(steps / bin_side_, 0.0, static_cast<double>(n_bins_ - 1)));
  }
  template <class Visit>
  void scan_points(const std::array<SurfacePoint, 3>& p, const Visit& visit) const {
    const double low = std::min({p[0].y, p[1].y, p[2].y}), high = std::max({p[0].y, p[1].y, p[2].y});
    const double west = std::min({p[0].x, p[1].x, p[2].x}), east = std::max({p[0].x, p[1].x, p[2].x});
    for (std::size_t r = bin_of(low - nudge_); r <= bin_of(high + nudge_); ++r) {
      const std::size_t first = bins_[r * n_bins_ + bin_of(west - nudge_)],
                        end = bins_[r * n_bins_ + bin_of(east + nudge_) + 1];
      for (std::size_t slot = first; slot < end; ++slot) {
        const Place& at = places_[slot];
        if (at.y < low - nudge_ || at.y > high + nudge_) continue;
        const TriangleRow row(p, std::clamp(at.y, low, high));
        if (at.x >= row.left - nudge_ && at.x <= row.right + nudge_) visit(slot, row.height_m(at.x));
      }
    }
  }

  const SourcePosts* posts_;
  double nudge_ = 0;
  std::size_t n_slots_ = 0;
  std::vector<Window> windows_;  ///< Grids.
  std::vector<Place> places_;    ///< Points, sorted by bins of the tile: n_bins_ x n_bins_, row-major from the SW.
  std::vector<std::size_t> bins_;
  std::size_t n_bins_ = 1;
  double bin_side_ = 1;
};

/// How far a surface height is from the values that the sources have for one post.
struct PostErrors {
  double nearest = 0;   ///< Distance to the range of the values: some field between them may be that close.
  double farthest = 0;  ///< Distance to the farthest value.
};

/// Distances of `z_m` from every value at grid index `at`, which must have one.
PostErrors post_errors(const SourcePosts& posts, std::int64_t at, double z_m);

/// What |TIN - h| may exceed E_L by without being an error: rounding of this program's own arithmetic, and of heights
/// that are no floats.
double error_slack_m(const SourcePosts& posts, double height_m);

/// What a post may be off a line by, in steps: degrees carry about 1e-13 of rounding, so do real lattice positions.
double line_nudge(const LatticeFrame& frame);

}  // namespace tind::client
