// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>
#include <vector>

#include "tests/client/tile.hpp"

namespace tind::client {

/// What a tile must be on its own (docs/format.md 1 and 5). Each function gives one line per fault, none for a good
/// tile; pure.

/// Four corners in place, sides strictly monotone and on the tile's border.
std::vector<std::string> find_outline_faults(const Tile& tile, const LatticeFrame& frame);
/// Interior vertices strictly inside, in Morton order, no two alike.
std::vector<std::string> find_interior_faults(const Tile& tile, const LatticeFrame& frame);
/// Positive plan areas that sum to the tile, each inner edge once each way, the ring as border, every vertex used,
/// stored order.
std::vector<std::string> find_triangle_faults(const Tile& tile, const LatticeFrame& frame);
/// The virtual triangle list names exactly the triangles with a border edge, in ring order with the right fields; runs
/// do not fall.
std::vector<std::string> find_vt_faults(const Tile& tile);
/// min_z and max_z are those of the vertices.
std::vector<std::string> find_range_faults(const Tile& tile);

}  // namespace tind::client
