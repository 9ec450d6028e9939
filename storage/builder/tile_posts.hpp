// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "core/height_field.hpp"
#include "core/result.hpp"
#include "core/virtual_node.hpp"
#include "storage/builder/plan.hpp"

namespace tind {

/// Calls visit(window) for the windows of grid posts of all cells that meet the tile; they may reach beyond the grid.
template <class Visit>
void for_windows_around(const HeightField& field, const TileKey& tile, Visit visit) {
  const double side = static_cast<double>(field.lattice.tile_side(tile.level));
  const double width = static_cast<double>(field.lattice.width());
  const auto r_first = static_cast<std::int64_t>(std::floor((side * tile.y - field.y0) / field.dy));
  const auto r_last = static_cast<std::int64_t>(std::ceil((side * (tile.y + 1.0) - field.y0) / field.dy));
  for (const double turn : {-width, 0.0, width}) {
    const auto c_first = static_cast<std::int64_t>(std::floor((side * tile.x - field.x0 - turn) / field.dx));
    const auto c_last = static_cast<std::int64_t>(std::ceil((side * (tile.x + 1.0) - field.x0 - turn) / field.dx));
    visit(PostBlocks::Extent{r_first, c_first, r_last - r_first + 1, c_last - c_first + 1});
  }
}

/// Calls visit(row, column) for the grid posts of all cells that meet the tile.
template <class Visit>
void for_posts_around(const HeightField& field, const TileKey& tile, Visit visit) {
  for_windows_around(field, tile, [&](const PostBlocks::Extent& w) {
    for (std::int64_t r = std::max<std::int64_t>(w.row, 0); r < std::min(w.row + w.n_rows, field.n_rows); ++r) {
      for (std::int64_t c = std::max<std::int64_t>(w.col, 0); c < std::min(w.col + w.n_cols, field.n_cols); ++c) {
        visit(r, c);
      }
    }
  });
}

/// kIo where posts could not be read: what was made of them since must not be stored.
Result<void> posts_are_read(const HeightField& field);

/// True iff the post has its height from the source: its own post, or between irregular ones.
inline bool is_of_source(PostOrigin origin) {
  return origin == PostOrigin::kSource || origin == PostOrigin::kInterpolated;
}

/// How much of a tile comes from the source, judged by the grid posts of all cells that the tile meets.
TileCoverage coverage_of(const HeightField& field, const TileKey& tile);

/// Whether a lattice point lies beyond the data: its nearest grid post is falloff or base.
bool is_outside(const HeightField& field, std::int64_t x, std::int64_t y);

/// The levels' height steps (docs/format.md 9, `height_step_m`), index = level: for each level the smallest power of
/// two in which every tile's heights span at most 32767 steps. Pinned heights may differ from the posts' by `slack_m`.
std::vector<double> height_steps(const HeightField& field, const TilePlan& plan, double slack_m, int threads = 1);

}  // namespace tind
