// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>

namespace tind {

/// Number of root tiles along x (nRootCountX of Zheng et al. 2016, 2.1). Two roots of 180 degrees cover the globe.
/// Both Cesium clients take this tiling for granted (EPSG:4326, TMS).
inline constexpr int kRootCountX = 2;

/// Cells along a tile side of a level's own grid (the 256 of eq. 1).
inline constexpr int kCellsPerTile = 256;

/// Deepest level that keys, Morton codes and lattice coordinates can express.
inline constexpr int kMaxLevel = 28;

/// One tile of the geodetic quadtree (EPSG:4326).
/// Level 0 has two tiles of 180 x 180 degrees; each level halves the side. x grows east from longitude -180, y grows
/// NORTH from latitude -90 (TMS rows). Valid: level in [0, kMaxLevel], x in [0, 2^(level+1)), y in [0, 2^level).
/// Row origin and projection are stated here and nowhere else.
struct TileKey {
  std::uint8_t level = 0;
  std::uint32_t x = 0;
  std::uint32_t y = 0;

  friend bool operator==(const TileKey&, const TileKey&) = default;

  /// Number of tiles along x at `level`.
  static constexpr std::uint32_t count_x(int level) { return std::uint32_t{kRootCountX} << level; }
  /// Number of tiles along y at `level`.
  static constexpr std::uint32_t count_y(int level) { return std::uint32_t{1} << level; }
  /// True iff level, x and y are in range.
  constexpr bool valid() const { return level <= kMaxLevel && x < count_x(level) && y < count_y(level); }
  /// The tile one level up that contains this one. Precondition: level > 0.
  constexpr TileKey parent() const { return {static_cast<std::uint8_t>(level - 1), x / 2, y / 2}; }
  /// Child `c` in Morton order: 0 SW, 1 SE, 2 NW, 3 NE. Precondition: c in [0, 4), level < kMaxLevel.
  constexpr TileKey child(int c) const {
    return {static_cast<std::uint8_t>(level + 1), 2 * x + static_cast<std::uint32_t>(c & 1),
            2 * y + static_cast<std::uint32_t>(c >> 1)};
  }
};

/// Interleaves the bits of x (even bits) and y (odd bits): the Z-order of a level. x, y < 2^32.
constexpr std::uint64_t morton_code(std::uint32_t x, std::uint32_t y) {
  const auto spread = [](std::uint64_t v) {
    v = (v | (v << 16)) & 0x0000FFFF0000FFFFull;
    v = (v | (v << 8)) & 0x00FF00FF00FF00FFull;
    v = (v | (v << 4)) & 0x0F0F0F0F0F0F0F0Full;
    v = (v | (v << 2)) & 0x3333333333333333ull;
    return (v | (v << 1)) & 0x5555555555555555ull;
  };
  return spread(x) | (spread(y) << 1);
}

/// Inverse of morton_code for the even bits; pass `code >> 1` to get y.
constexpr std::uint32_t morton_decode_even(std::uint64_t code) {
  code &= 0x5555555555555555ull;
  code = (code | (code >> 1)) & 0x3333333333333333ull;
  code = (code | (code >> 2)) & 0x0F0F0F0F0F0F0F0Full;
  code = (code | (code >> 4)) & 0x00FF00FF00FF00FFull;
  code = (code | (code >> 8)) & 0x0000FFFF0000FFFFull;
  return static_cast<std::uint32_t>(code | (code >> 16));
}

/// True iff (ax, ay) comes before (bx, by) in Z-order, for coordinates of any width (no interleaving needed).
constexpr bool morton_less(std::uint64_t ax, std::uint64_t ay, std::uint64_t bx, std::uint64_t by) {
  const std::uint64_t dx = ax ^ bx, dy = ay ^ by;
  // The coordinate whose highest differing bit is higher decides; on a tie y (the odd bits) decides.
  return (dx > dy && (dx & ~dy) > dy) ? ax < bx : (dy != 0 ? ay < by : ax < bx);
}

}  // namespace tind

template <>
struct std::hash<tind::TileKey> {
  std::size_t operator()(const tind::TileKey& k) const noexcept {
    return std::hash<std::uint64_t>{}(tind::morton_code(k.x, k.y) * 31 + k.level);
  }
};
