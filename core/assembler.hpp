// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>

#include "core/lattice.hpp"
#include "core/result.hpp"
#include "core/virtual_node.hpp"

namespace tind {

/// The nine decoded pieces of a tile. Corners in ring order C0 SW, C1 SE, C2 NE, C3 NW; edges by border b (0 south,
/// 1 east, 2 north, 3 west), each in its STORED direction (W->E or S->N).
struct TilePieces {
  std::array<Corner, 4> corners;
  std::array<EdgeChain, 4> edges;
  TileBody body;
};

/// Puts a tile together. Fails with kCorrupt when the pieces do not fit each other (counts, indices, positions).
/// Pure and thread safe; safe for untrusted pieces.
Result<VirtualNode> assemble(const Lattice& lattice, const TileKey& key, TilePieces pieces);

}  // namespace tind
