// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>
#include <vector>

#include "core/piece_key.hpp"

namespace tind {

/// Something in a file that docs/format.md does not allow.
struct Fault {
  std::string where;  ///< "tile 12/3/4", "edge h 12/3/4 of tiles ..", "manifest", "file".
  std::string what;
};

using Faults = std::vector<Fault>;

/// A corner that a whole row of tiles has: up to 2^29 of them, so nobody should list them.
constexpr bool is_pole(const PieceKey& piece) {
  return piece.kind == PieceKind::kCorner && (piece.j == 0 || piece.j == TileKey::count_y(piece.level));
}

/// "tile 12/3/4"
std::string name_of(const TileKey& tile);
/// A piece and, for people who look for tiles, the tiles that it belongs to: "corner 12/3/4 of tile 12/3/4, 12/2/4,
/// ..".
std::string name_of(const PieceKey& piece);

}  // namespace tind
