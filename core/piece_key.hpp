// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <compare>
#include <cstdint>
#include <vector>

#include "core/tile_key.hpp"

namespace tind {

/// The stored parts of a tile. The values are persistent (docs/format.md) and order the pieces of one lattice cell.
/// kInputs is no part of what is served: it tells what a body was made of.
enum class PieceKind : std::uint8_t { kCorner = 0, kEdgeH = 1, kEdgeV = 2, kBody = 3, kInputs = 4 };

/// Address of one stored piece.
/// Corner (i, j): the point where tile (i, j) has its SW corner. EdgeH (i, j): the south side of tile (i, j), stored
/// W->E. EdgeV (i, j): the west side of tile (i, j), stored S->N. Body and Inputs (i, j): tile (i, j).
/// Canonical: i in [0, 2^(level+1)) (longitude +180 is -180); j in [0, 2^level] for corners and horizontal edges,
/// [0, 2^level) for the others; corners at j = 0 and j = 2^level (poles) have i = 0.
struct PieceKey {
  PieceKind kind = PieceKind::kCorner;
  std::uint8_t level = 0;
  std::uint32_t i = 0;
  std::uint32_t j = 0;

  friend bool operator==(const PieceKey&, const PieceKey&) = default;

  /// True iff the key is in range; i may still be 2^(level+1) for what canonical() wraps.
  constexpr bool valid() const {
    if (level > kMaxLevel) return false;
    const bool on_row_line = kind == PieceKind::kCorner || kind == PieceKind::kEdgeH;
    const bool on_column_line = kind == PieceKind::kCorner || kind == PieceKind::kEdgeV;
    return i < TileKey::count_x(level) + (on_column_line ? 1u : 0u) &&
           j < TileKey::count_y(level) + (on_row_line ? 1u : 0u);
  }
  /// The one key under which the piece is stored. Precondition: valid().
  constexpr PieceKey canonical() const {
    PieceKey key = *this;
    if (key.i == TileKey::count_x(level)) key.i = 0;
    if (kind == PieceKind::kCorner && (j == 0 || j == TileKey::count_y(level))) key.i = 0;
    return key;
  }
  /// Storage order: level, Morton code of (i, j), kind.
  friend constexpr bool operator<(const PieceKey& a, const PieceKey& b) {
    if (a.level != b.level) return a.level < b.level;
    const auto ma = morton_code(a.i, a.j), mb = morton_code(b.i, b.j);
    return ma != mb ? ma < mb : a.kind < b.kind;
  }
};

/// The nine pieces of a tile in the local order of the paper (2.3): C0 SW, B0 south, C1 SE, B1 east, C2 NE, B2 north,
/// C3 NW, B3 west, body. B2 and B3 are stored the other way round (W->E, S->N) than the ring runs.
constexpr std::array<PieceKey, 9> pieces_of(const TileKey& t) {
  const auto corner = [&](std::uint32_t i, std::uint32_t j) {
    return PieceKey{PieceKind::kCorner, t.level, i, j}.canonical();
  };
  return {corner(t.x, t.y),
          PieceKey{PieceKind::kEdgeH, t.level, t.x, t.y},
          corner(t.x + 1, t.y),
          PieceKey{PieceKind::kEdgeV, t.level, t.x + 1, t.y}.canonical(),
          corner(t.x + 1, t.y + 1),
          PieceKey{PieceKind::kEdgeH, t.level, t.x, t.y + 1},
          corner(t.x, t.y + 1),
          PieceKey{PieceKind::kEdgeV, t.level, t.x, t.y},
          PieceKey{PieceKind::kBody, t.level, t.x, t.y}};
}

/// The tiles that a piece belongs to: the four around a corner (a whole row around a pole), the two beside an edge (one
/// along a pole), one. Precondition: canonical.
inline std::vector<TileKey> tiles_of(const PieceKey& key) {
  const std::uint32_t n_x = TileKey::count_x(key.level), n_y = TileKey::count_y(key.level);
  const bool is_corner = key.kind == PieceKind::kCorner;
  const bool has_west = is_corner || key.kind == PieceKind::kEdgeV;
  const bool has_south = is_corner || key.kind == PieceKind::kEdgeH;
  std::vector<TileKey> tiles;
  if (is_corner && (key.j == 0 || key.j == n_y)) {
    for (std::uint32_t x = 0; x < n_x; ++x) tiles.push_back({key.level, x, key.j == 0 ? 0 : n_y - 1});
    return tiles;
  }
  for (std::uint32_t south = 0; south <= (has_south ? 1u : 0u); ++south) {
    if (key.j < south || key.j - south >= n_y) continue;
    for (std::uint32_t west = 0; west <= (has_west ? 1u : 0u); ++west) {
      tiles.push_back({key.level, (key.i + n_x - west) % n_x, key.j - south});
    }
  }
  return tiles;
}

}  // namespace tind
