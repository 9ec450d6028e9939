// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/doctor/piece_source.hpp"

#include <utility>

#include "storage/doctor/fault.hpp"
#include "storage/doctor/value_check.hpp"
#include "storage/piece_blob.hpp"

namespace tind {

bool StoredTiles::has_any_of(const PieceKey& piece) const {
  if (is_pole(piece)) {
    if (piece.level >= codes_.size()) return false;
    const std::uint32_t y = piece.j == 0 ? 0 : piece.j - 1;
    const auto& codes = codes_[piece.level];
    return std::any_of(codes.begin(), codes.end(),
                       [y](std::uint64_t code) { return morton_decode_even(code >> 1) == y; });
  }
  const auto tiles = tiles_of(piece);
  return std::any_of(tiles.begin(), tiles.end(), [this](const TileKey& tile) { return has(tile); });
}

std::optional<Corner> PieceSource::corner(const PieceKey& key) const {
  const auto value = snapshot.find(key.canonical());
  if (!value) return std::nullopt;
  const auto record = unpack_strictly(*value);
  if (!record) return std::nullopt;
  const auto corner = decode_corner(*record);
  return corner ? std::optional(*corner) : std::nullopt;
}

std::optional<EdgeChain> PieceSource::edge(const PieceKey& key) const {
  const auto value = snapshot.find(key.canonical());
  if (!value) return std::nullopt;
  const auto record = unpack_strictly(*value);
  if (!record) return std::nullopt;
  auto edge = decode_edge(*record);
  return edge ? std::optional(std::move(*edge)) : std::nullopt;
}

}  // namespace tind
