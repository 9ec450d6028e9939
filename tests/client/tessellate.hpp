// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "tests/client/byte_cursor.hpp"
#include "tests/client/tile.hpp"

namespace tind::client {

/// What a finer line adds to each interval of a border, in ring direction: inserted[k] lies strictly inside interval k.
struct SideInserts {
  std::vector<std::vector<SideVertex>> inserted;
  bool any = false;
};

/// Decodes a finer line by entry levels (docs/format.md 6): a vertex with entry level <= the tile's ends the current
/// interval of border b, any other belongs to it. `finer` runs in STORED direction from corner to corner. Refuses,
/// naming the vertex, when the line does not start and end at the corners or an ending vertex is not the coarse side's
/// next one.
Outcome<SideInserts> decode_by_entry_levels(const Tile& tile, int b, std::vector<SideVertex> finer);

/// A tile after crack tessellation.
struct TessellatedTile {
  std::vector<Vertex> vertices;    ///< The tile's own, then those from finer lines.
  std::vector<Corners> triangles;  ///< Untouched ones first.
  std::size_t first_changed = 0;   ///< From here on: pieces of re-triangulated virtual triangles.
  std::size_t changed_vts = 0;
};

/// Re-triangulates the virtual triangles whose intervals got vertices: a fan for one border edge, the zig-zag for two.
/// Refuses when the tile's virtual triangle list does not fit its triangles.
Outcome<TessellatedTile> tessellate(const Tile& tile, const std::array<std::optional<SideInserts>, 4>& sides);

}  // namespace tind::client
