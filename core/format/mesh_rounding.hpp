// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/result.hpp"
#include "core/virtual_node.hpp"

namespace tind {

/// A tile's mesh with its positions rounded to the grid 0..n_steps on both axes. Vertex indices are the tile's own.
struct RoundedMesh {
  std::vector<std::array<std::uint16_t, 2>> positions;  ///< (u east, v north) per vertex of the tile.
  std::vector<Triangle> triangles;  ///< All strictly counter-clockwise on the grid; dropped vertices are in none.
};

/// Rounds a tile's lattice positions to a coarser grid so that no triangle has zero area or turns over.
///
/// Vertices go to the nearest grid point, but none that is inside the tile on an axis goes to its sides there: one step
/// beside them. Border vertices stay on their side. Those that fall together become one by a rule that
/// sees the edge record alone (corners win, else the first in stored direction), so both tiles beside it agree. An
/// interior vertex that cannot go to its nearest grid point goes to one nearby, and is dropped where none is free: the
/// hole is triangulated again. The mesh is valid after every single step, by exact integer predicates, so the result
/// always is.
///
/// `side`: lattice steps of the tile's side, 1 <= side <= 2^44. `n_steps`: 1 <= n_steps <= 32767.
/// Fails with kCorrupt when the tile's own triangles are no triangulation of its square and plain rounding does not
/// give positive triangles by itself. Safe for untrusted meshes. Pure, thread safe.
Result<RoundedMesh> round_to_grid(const VirtualNode& node, std::int64_t side, std::int64_t n_steps);

}  // namespace tind
