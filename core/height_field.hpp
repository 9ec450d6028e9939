// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>

#include "core/lattice.hpp"
#include "core/pinned_points.hpp"
#include "core/post_blocks.hpp"
#include "core/post_pages.hpp"

namespace tind {

/// Where a post of the extended grid comes from.
enum class PostOrigin : std::uint8_t {
  kBase = 0,     ///< Exactly the base height.
  kSource = 1,   ///< A post of the source.
  kFilled = 2,   ///< Inside an interior void: filled smoothly.
  kFalloff = 3,  ///< Outside the data: on its way from the nearest values down to the base height.
  /// Between the irregular posts of a point source: interpolated from them, held to no promise of its own.
  kInterpolated = 4,
};

/// An irregular post: a kept point of a point source, at its own real lattice position.
struct PointPost {
  double x = 0, y = 0;
  float height_m = 0;
};

/// The irregular posts of a height field, by blocks of a regular grid. Not owned; const access is thread safe.
/// Block (r, c), row-major from the south-west, holds the points with x0 + c * side <= x < x0 + (c + 1) * side (y
/// alike), ascending by (llround(y), llround(x)); no two points round to one lattice point.
struct PointBlocks {
  double x0 = 0, y0 = 0;  ///< Lattice position of the south-west corner; as HeightField::x0.
  double side = 1;        ///< Lattice steps along a block.
  std::int64_t n_rows = 0, n_cols = 0;
  const std::uint64_t* first = nullptr;  ///< n_rows * n_cols + 1 offsets into `posts`.
  const PointPost* posts = nullptr;

  bool empty() const { return n_rows == 0; }
  std::span<const PointPost> block(std::int64_t r, std::int64_t c) const {
    const std::uint64_t* at = first + r * n_cols + c;
    return {posts + at[0], static_cast<std::size_t>(at[1] - at[0])};
  }
  /// Calls visit(post) for every point of the blocks that meet west <= x <= east, south <= y <= north (a superset of
  /// the points in it).
  template <class Visit>
  void for_blocks(double west, double south, double east, double north, Visit visit) const {
    const auto index = [this](double v, double origin, std::int64_t n) {
      return static_cast<std::int64_t>(std::clamp(std::floor((v - origin) / side), -1.0, static_cast<double>(n)));
    };
    if (empty()) return;
    const std::int64_t r_last = std::min(index(north, y0, n_rows), n_rows - 1);
    const std::int64_t c_last = std::min(index(east, x0, n_cols), n_cols - 1);
    for (std::int64_t r = std::max<std::int64_t>(index(south, y0, n_rows), 0); r <= r_last; ++r) {
      for (std::int64_t c = std::max<std::int64_t>(index(west, x0, n_cols), 0); c <= c_last; ++c) {
        for (const PointPost& p : block(r, c)) visit(p);
      }
    }
  }
  /// The point that rounds to a lattice point (x as the blocks count it); null when there is none.
  const PointPost* find(std::int64_t x, std::int64_t y) const;
};

/// ONE height field for all levels: a regular grid of posts (source posts, filled voids and a rim of falloff) and the
/// base height everywhere else. A value with pointers to arrays it does not own; const access is thread safe.
///
/// Grid: n_rows x n_cols posts, row-major, row 0 the SOUTHERNMOST, column 0 the WESTERNMOST. Post (r, c) lies at
/// lattice X = x0 + c * dx, Y = y0 + r * dy (real numbers: posts are not rounded here). X may run past the lattice's
/// width when the source crosses longitude 180. Heights in metres.
struct HeightField {
  Lattice lattice;
  std::int64_t n_rows = 0;
  std::int64_t n_cols = 0;
  double x0 = 0, y0 = 0;  ///< Lattice position of post (0, 0); 0 <= x0 < lattice.width().
  double dx = 0, dy = 0;  ///< Lattice steps between posts; both > 0.
  bool wraps = false;     ///< The columns close around the globe: n_cols * dx == lattice.width().
  /// The last row is within one spacing of the south pole (or on it): from it heights run linearly to the pole's one
  /// height.
  bool continues_south = false;
  bool continues_north = false;  ///< Same at the north pole.
  double south_pole_m = 0;       ///< Height of the pole itself when continues_south.
  double north_pole_m = 0;
  double base_height_m = 0;
  double disagreement_m = 0;            ///< Largest |source post - its height here| where overlapping sources disagree.
  const float* heights_m = nullptr;     ///< n_rows * n_cols; null: there are `pages` instead.
  const PostOrigin* origins = nullptr;  ///< n_rows * n_cols; as heights_m.
  const PostPages* pages = nullptr;     ///< The grid's posts where they are not in memory. Not owned.
  const PostBlocks* blocks = nullptr;   ///< Of the grid's posts, as they are now; null: not made. Not owned.
  PointBlocks points;                   ///< Irregular posts; empty for a raster.
  PinnedPoints pinned;                  ///< Vertices with a height of their own: those of break lines.

  double post_x(std::int64_t c) const { return x0 + static_cast<double>(c) * dx; }
  double post_y(std::int64_t r) const { return y0 + static_cast<double>(r) * dy; }
  double height_at(std::int64_t r, std::int64_t c) const {
    return static_cast<double>(pages != nullptr ? pages->height_m(r, c) : heights_m[r * n_cols + c]);
  }
  PostOrigin origin_at(std::int64_t r, std::int64_t c) const {
    return pages != nullptr ? pages->origin(r, c) : origins[r * n_cols + c];
  }

  /// Post (r, c) and those beside it in arrays or, as far as they are in the same page, in that; a row has `stride`.
  /// Valid as long as the arrays, or until this thread asks for another page.
  struct Posts {
    const float* heights_m;
    const PostOrigin* origins;
    std::int64_t stride;
  };
  Posts posts_from(std::int64_t r, std::int64_t c) const {
    if (pages == nullptr) return {heights_m + r * n_cols + c, origins + r * n_cols + c, n_cols};
    const PostPage& page = pages->of_post(r, c);
    return {page.heights_m + PostPages::index(r, c), page.origins + PostPages::index(r, c), PostPages::kSide};
  }

  /// PostBlocks::visit over the grid's posts; where there are no blocks, posts() is called for all rows of the window.
  template <class Settle, class Posts>
  void visit_posts(const PostBlocks::Extent& window, Settle settle, Posts posts) const {
    if (blocks != nullptr) return blocks->visit(window, settle, posts);
    const std::int64_t col_begin = std::max<std::int64_t>(window.col, 0);
    const std::int64_t col_end = std::min(window.col + window.n_cols, n_cols);
    for (std::int64_t r = std::max<std::int64_t>(window.row, 0); r < std::min(window.row + window.n_rows, n_rows);
         ++r) {
      if (col_begin < col_end) posts(r, col_begin, col_end);
    }
  }

  /// True iff (x, y) lies between posts (or between the last row and its pole): where this is false the height is the
  /// base.
  bool covers(double x, double y) const {
    if (y < (continues_south ? 0.0 : y0)) return false;
    if (y > (continues_north ? static_cast<double>(lattice.height()) : post_y(n_rows - 1))) return false;
    if (wraps) return true;
    const double width = static_cast<double>(lattice.width());
    const double last = post_x(n_cols - 1);
    return (x >= x0 && x <= last) || (x + width >= x0 && x + width <= last) || (x - width >= x0 && x - width <= last);
  }
  /// Height in metres at any real lattice position, x modulo the lattice's width: bilinear between posts, on to the
  /// pole where the grid continues there, the base height outside.
  double sample_m(double x, double y) const;
  /// THE height of lattice point (x, y) in height units, the same for every level, tile and line that has a vertex
  /// there. A pinned point has its own, else a point that a post rounds to has the post's own height, a point that
  /// rounds onto a post row or column is sampled on it.
  std::int32_t lattice_height(std::int64_t x, std::int64_t y) const;
};

}  // namespace tind
