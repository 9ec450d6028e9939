// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
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

/// The posts that a tile's vertices are, as far as they shape its mesh: with them and the task the mesh can be told to
/// be the same without looking at the other posts (docs/decisions/0013).
struct VertexPosts {
  double served_step_m = 0;      ///< Bound of the step that quantized-mesh rounds inner heights to.
  std::vector<float> heights_m;  ///< Of the grid's posts that round to interior vertices, in the vertices' order.
};

/// What refinement makes of it.
struct TileSurface {
  std::vector<LocalVertex> interior;  ///< Morton order.
  std::vector<Triangle> triangles;    ///< Local order, counter-clockwise, smallest index first, sorted.
  TileStats stats;                    ///< Without coverage.
  std::vector<CellErrors> cells;      ///< What stats' errors are made of, irregular posts apart.
  VertexPosts vertex_posts;           ///< Empty where TileTask::n_cell_levels is 0.
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

/// A tile as it came out of the same task over a field that differed in heights and origins of posts only. Not owned.
struct EarlierTile {
  std::span<const LocalVertex> interior;
  std::span<const Triangle> triangles;
  std::span<const CellErrors> cells;
  std::span<const TileKey> changed;  ///< The tile's descendants that have between them all posts that changed.
  /// Whether these are the VertexPosts that the earlier tile had.
  std::function<bool(const VertexPosts&)> has;
};

/// Whether posts are so far apart, in lattice steps, that repeat_triangulation can tell which of them are vertices.
bool can_be_repeated(const HeightField& field);

/// What triangulate would make of the task, where it is told to be the earlier tile's mesh by looking at few posts:
/// those that its vertices are, and those of the changed descendants. Errors are measured in their cells alone. nullopt
/// where the mesh may be another one, or so much has changed that this does not pay. docs/decisions/0013 has the proof.
/// Preconditions: can_be_repeated(field), task.n_cell_levels > 0.
std::optional<TileSurface> repeat_triangulation(const HeightField& field, const TileTask& task,
                                                const EarlierTile& earlier, int threads = 1);

}  // namespace tind
