// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>

#include "core/height_field.hpp"
#include "storage/readers/cancel.hpp"

namespace tind {

/// A grid of posts in work: n_rows x n_cols, row-major, row 0 southernmost. A post of origin kBase is still a void: its
/// height is not read. Arrays are not owned.
struct PostGrid {
  std::int64_t n_rows = 0, n_cols = 0;
  bool wraps = false;  ///< Column n_cols - 1 is the western neighbour of column 0.
  float* heights_m = nullptr;
  PostOrigin* origins = nullptr;
  CancelFlag cancel = nullptr;  ///< When it is set, the fills end early and the grid is of no use.
  /// Above 0: only posts of the first and last so many rows and columns are there, and no other one is a void. At most
  /// half of the grid's sides then.
  std::int64_t rim = 0;

  /// Place in the arrays of a post that is there. What lies together in a row is together.
  std::int64_t index(std::int64_t r, std::int64_t c) const {
    if (rim == 0 || r < rim) return r * n_cols + c;
    if (r >= n_rows - rim) return rim * n_cols + (n_rows - 2 * rim) * 2 * rim + (r - (n_rows - rim)) * n_cols + c;
    return rim * n_cols + (r - rim) * 2 * rim + (c < rim ? c : c - n_cols + 2 * rim);
  }
  /// How many posts are there.
  std::int64_t n_posts() const { return rim == 0 ? n_rows * n_cols : 2 * rim * (n_cols + n_rows - 2 * rim); }
};

/// The first of posts [from, n) that is a void, or that is none; n: there is no such post.
std::int64_t next_void(const PostOrigin* origins, std::int64_t from, std::int64_t n);
std::int64_t next_post(const PostOrigin* origins, std::int64_t from, std::int64_t n);

/// The bounding grid of the data inside a PostGrid (inclusive), and on which sides the world goes on beyond it (a pole
/// is the end of the world, a grid that wraps has none in x).
struct DataFrame {
  std::int64_t south_row = 0, north_row = 0, west_col = 0, east_col = 0;
  bool open_south = true, open_north = true;
};

/// Fills the voids that do not touch an open side of the frame (4-connected) with a membrane (Laplace's equation with
/// the void's rim as boundary), solved from coarse to fine: no value leaves the range of the rim. Sets kFilled. Returns
/// the number of posts filled. Deterministic. Memory: the bounding window of one void at a time. Precondition: all of
/// the grid's posts are there.
std::uint64_t fill_interior_voids(PostGrid& grid, const DataFrame& frame);

}  // namespace tind
