// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/doctor/fault.hpp"

#include <fmt/format.h>

namespace tind {

std::string name_of(const TileKey& tile) { return fmt::format("tile {}/{}/{}", tile.level, tile.x, tile.y); }

std::string name_of(const PieceKey& piece) {
  if (piece.kind == PieceKind::kBody) return fmt::format("body of {}", name_of(TileKey{piece.level, piece.i, piece.j}));
  if (piece.kind == PieceKind::kInputs)
    return fmt::format("inputs of {}", name_of(TileKey{piece.level, piece.i, piece.j}));
  constexpr const char* kNames[] = {"corner", "edge h", "edge v"};
  std::string text =
      fmt::format("{} {}/{}/{} of ", kNames[static_cast<std::size_t>(piece.kind)], piece.level, piece.i, piece.j);
  if (is_pole(piece)) return text + "all tiles at the " + (piece.j == 0 ? "south" : "north") + " pole";
  const std::vector<TileKey> tiles = tiles_of(piece);
  for (std::size_t k = 0; k < tiles.size(); ++k) text += (k == 0 ? "" : ", ") + name_of(tiles[k]);
  return text;
}

}  // namespace tind
