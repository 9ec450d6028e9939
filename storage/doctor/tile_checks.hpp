// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <optional>

#include "storage/doctor/fault.hpp"
#include "storage/doctor/piece_source.hpp"

namespace tind {

/// What a tile's body counts, for the sums of the manifest.
struct BodyCounts {
  TileStats stats;
  std::uint64_t n_interior = 0, n_triangles = 0, n_bytes = 0;
};

struct TileFindings {
  Faults faults;
  std::optional<BodyCounts> counts;  ///< nullopt: the body does not decode.
};

/// All that docs/format.md 5 says of a stored tile: its nine pieces are there and fit each other; its triangles cover
/// it; its virtual triangles and their runs; heights, counts and errors; sibling-completeness; its edges' lines (those
/// that no other tile checks). And that its terrain tile is one that clients can read. Thread safe.
TileFindings check_tile(const PieceSource& pieces, const TileKey& tile);

}  // namespace tind
