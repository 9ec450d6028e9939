// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/lattice.hpp"

namespace tind {

/// Where a post of the extended grid comes from.
enum class PostOrigin : std::uint8_t {
  kBase = 0,     ///< Exactly the base height.
  kSource = 1,   ///< A post of the source.
  kFilled = 2,   ///< Inside an interior void: filled smoothly.
  kFalloff = 3,  ///< Outside the data: on its way from the nearest values down to the base height.
};

/// ONE height field for all levels: a regular grid of posts (source posts, filled voids and a rim of falloff) and the base
/// height everywhere else. A value with pointers to arrays it does not own; const access is thread safe.
///
/// Grid: n_rows x n_cols posts, row-major, row 0 the SOUTHERNMOST, column 0 the WESTERNMOST. Post (r, c) lies at
/// lattice X = x0 + c * dx, Y = y0 + r * dy (real numbers: posts are not rounded here). X may run past the lattice's
/// width when the source crosses longitude 180. Heights in metres.
struct HeightField {
  Lattice lattice;
  std::int64_t n_rows = 0;
  std::int64_t n_cols = 0;
  double x0 = 0, y0 = 0;         ///< Lattice position of post (0, 0); 0 <= x0 < lattice.width().
  double dx = 0, dy = 0;         ///< Lattice steps between posts; both > 0.
  bool wraps = false;            ///< The columns close around the globe: n_cols * dx == lattice.width().
  bool continues_south = false;  ///< The grid ends at the south pole: south of row 0 its heights run on to the pole's.
  bool continues_north = false;  ///< Same for the last row and the north pole.
  double south_pole_m = 0;       ///< Height of the pole itself when continues_south.
  double north_pole_m = 0;
  double base_height_m = 0;
  double disagreement_m = 0;     ///< Largest |source post - its height here| where overlapping sources disagree.
  const float* heights_m = nullptr;       ///< n_rows * n_cols
  const PostOrigin* origins = nullptr;    ///< n_rows * n_cols

  double post_x(std::int64_t c) const { return x0 + static_cast<double>(c) * dx; }
  double post_y(std::int64_t r) const { return y0 + static_cast<double>(r) * dy; }
  double height_at(std::int64_t r, std::int64_t c) const {
    return static_cast<double>(heights_m[r * n_cols + c]);
  }
  PostOrigin origin_at(std::int64_t r, std::int64_t c) const { return origins[r * n_cols + c]; }

  /// Height in metres at any real lattice position: bilinear between posts, the base height outside the grid.
  double sample_m(double x, double y) const;
  /// THE height of lattice point (x, y) in height units, the same for every level, tile and line that has a vertex there.
  /// A point that a post rounds to has the post's own height, a point that rounds onto a post row or column is sampled on it.
  std::int32_t lattice_height(std::int64_t x, std::int64_t y) const;
};

}  // namespace tind
