// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <span>
#include <vector>

#include "core/border_line.hpp"
#include "core/triangulator.hpp"

namespace tind::test {

/// A tile built alone from its four border lines, each refined down to spec.bottom_level() as if finer tiles lay
/// beside all of it.
struct TestTile {
  TileKey key;
  std::array<std::vector<LineVertex>, 4> lines;  ///< south, east, north, west; stored direction
  TileTask task;
  TileSurface surface;
};

/// Vertices (local lattice steps, metres) and triangles.
struct Mesh {
  std::vector<LocalVertex> vertices;
  std::vector<Triangle> triangles;
};

/// Tolerances E, E/2, .. from `level` on, less half a height unit as the builder takes, one segment a side, height
/// steps of a height unit.
RefinementSpec spec_from(int level, double tolerance_m, int n_levels, const Lattice& lattice);

/// The border lines and the task of a tile; `surface` is empty.
TestTile make_task(const HeightField& field, const RefinementSpec& spec, const TileKey& key);
/// make_task and triangulate.
TestTile build_tile(const HeightField& field, const RefinementSpec& spec, const TileKey& key);

/// The tile as it is.
Mesh mesh_of(const TestTile& tile);
/// The tile with every virtual triangle tessellated to the border lines of level[b] along border b (docs/format.md 6).
Mesh tessellate(const TestTile& tile, const std::array<int, 4>& levels);

/// What a mesh does at the posts of the closed tile: found by trying all triangles around each post, in long double.
struct PostCheck {
  double worst_m = 0;         ///< largest |TIN - h| at a post; a post on an edge counts in both triangles
  double worst_base_m = 0;    ///< same at the uncovered points of the tile's 256 x 256 grid, against the base height
  std::int64_t n_posts = 0;   ///< posts in the closed tile
  std::int64_t n_missed = 0;  ///< posts or grid points in no triangle
  std::int64_t n_own_source = 0;           ///< source posts with west <= X < east, south <= Y < north
  double own_worst_m = 0, own_rmse_m = 0;  ///< over those
};
PostCheck check_posts(const HeightField& field, const TileKey& key, const Mesh& mesh);

/// Twice the sum of the plan areas in lattice steps, exact; a triangle without positive area makes it -1.
__extension__ using Int128 = __int128;
Int128 doubled_area(const Mesh& mesh);

}  // namespace tind::test
