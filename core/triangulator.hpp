// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/border_line.hpp"
#include "core/height_field.hpp"
#include "core/virtual_node.hpp"

namespace tind {

/// One tile to be triangulated.
struct TileTask {
  TileKey key;
  double tolerance_m = 0;    ///< Refinement tolerance of the level.
  double height_step_m = 1;  ///< Quantized-mesh rounds border heights of the level to multiples of this power of two.
  /// Border vertices of the level in ring direction, local coordinates; border b starts with its corner C_b and ends
  /// before the next corner.
  std::array<std::vector<LocalVertex>, 4> borders;
  /// Envelope per border, ascending in t; t in local lattice steps along the border's axis (east or north).
  std::array<std::vector<EnvelopeKnot>, 4> envelopes;
  /// Interior vertices to start from (the parent's, seeds); duplicates are dropped.
  std::vector<LocalVertex> initial;
  /// Pieces of break lines inside the tile, local coordinates, the most important first: edges of the triangulation
  /// while it is refined, gone with it (Zheng et al. 2016, step 3). Ends on the border must be border vertices. A piece
  /// that would cross an earlier one is left out.
  std::vector<std::array<LocalVertex, 2>> constraints;
  int n_cell_levels =
      0;  ///< The tile's errors are summed up by its descendants so many levels down: 0..kMostCellLevels.
};

/// Errors of a tile's mesh at the posts of one of its cells: 2^n x 2^n squares, n = TileTask::n_cell_levels, row-major
/// from the south-west.
struct CellErrors {
  std::uint64_t n_posts = 0;
  double sum_m2 = 0;  ///< Of their squares.
  float largest_m = 0;
  friend bool operator==(const CellErrors&, const CellErrors&) = default;
};
inline constexpr int kMostCellLevels = 5;

/// What refinement makes of it.
struct TileSurface {
  std::vector<LocalVertex> interior;  ///< Morton order.
  std::vector<Triangle> triangles;    ///< Local order, counter-clockwise, smallest index first, sorted.
  TileStats stats;                    ///< Without coverage.
  std::vector<CellErrors> cells;      ///< What stats' errors are made of, irregular posts apart.
  std::uint64_t n_inserted = 0;       ///< Vertices that greedy insertion added.
  std::uint64_t n_of_lines = 0;       ///< Interior vertices that only break lines brought in.
  std::uint64_t n_left_out = 0;       ///< Pieces of break lines that crossed another.
};

/// Constrained Delaunay triangulation of the border ring and the initial vertices, then greedy insertion of the worst
/// post until every post of the tile is within the tolerance, also when virtual triangles are tessellated to any finer
/// border (the guard of DESIGN "Seams"), and when positions and heights are rounded as quantized-mesh rounds them.
/// Posts outside the grid are the level's own 256 x 256 grid at the base height. Irregular posts count as those of the
/// grid do; interpolated posts of the grid are held to nothing. Pure: the same
/// task gives the same bytes; thread safe. `threads` >= 1 of them share what can be shared of a tile that has much of
/// the data to itself.
TileSurface triangulate(const HeightField& field, const TileTask& task, int threads = 1);

}  // namespace tind
