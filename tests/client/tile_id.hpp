// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <string>

namespace tind::client {

/// Deepest level that docs/format.md allows.
inline constexpr int kDeepestLevel = 28;

/// Exact products of two lattice differences (up to 2^45 each) need 90 bits.
__extension__ typedef __int128 Int128;

/// A tile of the geodetic quadtree as docs/format.md 1 has it: level L has 2^(L+1) x 2^L tiles, y grows north.
struct TileId {
  int level = 0;
  std::uint32_t x = 0;
  std::uint32_t y = 0;

  friend bool operator==(const TileId&, const TileId&) = default;

  static std::uint32_t count_x(int level) { return std::uint32_t{2} << level; }
  static std::uint32_t count_y(int level) { return std::uint32_t{1} << level; }
  bool valid() const { return level >= 0 && level <= kDeepestLevel && x < count_x(level) && y < count_y(level); }
  TileId parent() const { return {level - 1, x / 2, y / 2}; }
  /// Child c: 0 SW, 1 SE, 2 NW, 3 NE.
  TileId child(int c) const {
    return {level + 1, 2 * x + static_cast<std::uint32_t>(c & 1), 2 * y + static_cast<std::uint32_t>(c >> 1)};
  }
  /// A number that is different for each tile.
  std::uint64_t number() const {
    return (static_cast<std::uint64_t>(level) << 58) | (static_cast<std::uint64_t>(y) << 29) | x;
  }
  std::string text() const { return std::to_string(level) + "/" + std::to_string(x) + "/" + std::to_string(y); }
};

/// Numbers the borders in ring order and names them for people.
inline constexpr std::array<const char*, 4> kBorderNames = {"south", "east", "north", "west"};

/// The numbers that place tiles on the lattice (docs/format.md 1).
struct LatticeFrame {
  int lattice_level = 0;
  int height_exponent = 0;

  std::int64_t side(int level) const { return std::int64_t{1} << (16 + lattice_level - level); }
  std::int64_t width() const { return 2 * side(0); }
  std::int64_t height() const { return side(0); }
  std::int64_t origin_x(const TileId& t) const { return static_cast<std::int64_t>(t.x) * side(t.level); }
  std::int64_t origin_y(const TileId& t) const { return static_cast<std::int64_t>(t.y) * side(t.level); }
  double step_deg() const { return 180.0 / static_cast<double>(side(0)); }
  double unit_m() const { return 1.0 / static_cast<double>(std::int64_t{1} << height_exponent); }
};

/// The level at which the line of border `b` of a tile is first a tile side: entry levels on it cannot be lower.
inline int first_level_of_line(const TileId& t, int b) {
  const bool vertical = b == 1 || b == 3;
  const std::uint32_t index = vertical ? t.x + (b == 1 ? 1u : 0u) : t.y + (b == 2 ? 1u : 0u);
  const std::uint32_t count = vertical ? TileId::count_x(t.level) : TileId::count_y(t.level);
  if (index == 0 || index == count) return 0;
  const int shift = std::countr_zero(index);
  return shift >= t.level ? 0 : t.level - shift;
}

/// Twice the signed plan area of (a, b, c): positive when counter-clockwise. Exact.
inline Int128 twice_area(std::int64_t ax, std::int64_t ay, std::int64_t bx, std::int64_t by, std::int64_t cx,
                         std::int64_t cy) {
  return static_cast<Int128>(bx - ax) * (cy - ay) - static_cast<Int128>(by - ay) * (cx - ax);
}

/// Z-order of two points with y on the odd, higher bits, for coordinates of any width.
inline bool before_in_morton_order(std::uint64_t ax, std::uint64_t ay, std::uint64_t bx, std::uint64_t by) {
  const std::uint64_t dx = ax ^ bx, dy = ay ^ by;
  const int bit_x = dx == 0 ? -1 : std::bit_width(dx), bit_y = dy == 0 ? -1 : std::bit_width(dy);
  return bit_x > bit_y ? ax < bx : ay < by;
}

}  // namespace tind::client
