// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/tile_key.hpp"

#include <random>
#include <set>

#include <gtest/gtest.h>

#include "core/piece_key.hpp"

namespace tind {
namespace {

TEST(MortonCode, PutsXOnEvenAndYOnOddBits) {
  EXPECT_EQ(morton_code(1, 0), 1u);
  EXPECT_EQ(morton_code(0, 1), 2u);
  EXPECT_EQ(morton_code(5, 3), 0b011011u);
  EXPECT_EQ(morton_code(0xffffffff, 0), 0x5555555555555555u);
  EXPECT_EQ(morton_code(0, 0xffffffff), 0xaaaaaaaaaaaaaaaau);
}

TEST(MortonCode, DecodesAndOrdersAsMortonLess) {
  std::mt19937_64 random(1);
  for (int k = 0; k < 20000; ++k) {
    // Close pairs as well as distant ones.
    const auto mask = (std::uint64_t{1} << (1 + random() % 32)) - 1;
    const auto ax = static_cast<std::uint32_t>(random()), ay = static_cast<std::uint32_t>(random());
    const auto bx = static_cast<std::uint32_t>(ax ^ (random() & mask)),
               by = static_cast<std::uint32_t>(ay ^ (random() & mask));
    EXPECT_EQ(morton_decode_even(morton_code(ax, ay)), ax);
    EXPECT_EQ(morton_decode_even(morton_code(ax, ay) >> 1), ay);
    EXPECT_EQ(morton_less(ax, ay, bx, by), morton_code(ax, ay) < morton_code(bx, by))
        << ax << ' ' << ay << ' ' << bx << ' ' << by;
  }
  EXPECT_FALSE(morton_less(7, 7, 7, 7));
  EXPECT_TRUE(morton_less(std::uint64_t{1} << 40, 0, 0, std::uint64_t{1} << 40));
}

TEST(TileKey, HasItsChildrenInMortonOrderAndTheirParent) {
  const TileKey tile{4, 9, 3};
  EXPECT_EQ(tile.child(0), (TileKey{5, 18, 6}));
  EXPECT_EQ(tile.child(1), (TileKey{5, 19, 6}));
  EXPECT_EQ(tile.child(2), (TileKey{5, 18, 7}));
  for (int c = 0; c < 4; ++c) {
    EXPECT_EQ(tile.child(c).parent(), tile);
    EXPECT_EQ(morton_code(tile.child(c).x, tile.child(c).y),
              4 * morton_code(tile.x, tile.y) + static_cast<unsigned>(c));
  }
}

TEST(TileKey, IsValidOnTheGlobeOnly) {
  EXPECT_TRUE((TileKey{0, 1, 0}).valid());
  EXPECT_FALSE((TileKey{0, 2, 0}).valid());
  EXPECT_FALSE((TileKey{0, 0, 1}).valid());
  EXPECT_TRUE((TileKey{28, (1u << 29) - 1, (1u << 28) - 1}).valid());
  EXPECT_FALSE((TileKey{29, 0, 0}).valid());
}

TEST(PieceKey, WrapsLongitude180AndJoinsPoles) {
  const std::uint32_t n_x = TileKey::count_x(3), n_y = TileKey::count_y(3);
  EXPECT_EQ((PieceKey{PieceKind::kCorner, 3, n_x, 2}).canonical(), (PieceKey{PieceKind::kCorner, 3, 0, 2}));
  EXPECT_EQ((PieceKey{PieceKind::kEdgeV, 3, n_x, 2}).canonical(), (PieceKey{PieceKind::kEdgeV, 3, 0, 2}));
  EXPECT_EQ((PieceKey{PieceKind::kCorner, 3, 7, 0}).canonical(), (PieceKey{PieceKind::kCorner, 3, 0, 0}));
  EXPECT_EQ((PieceKey{PieceKind::kCorner, 3, 7, n_y}).canonical(), (PieceKey{PieceKind::kCorner, 3, 0, n_y}));
  EXPECT_EQ((PieceKey{PieceKind::kEdgeH, 3, 7, n_y}).canonical(), (PieceKey{PieceKind::kEdgeH, 3, 7, n_y}));
  EXPECT_FALSE((PieceKey{PieceKind::kEdgeH, 3, n_x, 0}).valid());
  EXPECT_FALSE((PieceKey{PieceKind::kEdgeV, 3, 0, n_y}).valid());
  EXPECT_FALSE((PieceKey{PieceKind::kBody, 3, 0, n_y}).valid());
  EXPECT_FALSE((PieceKey{PieceKind::kCorner, 3, n_x + 1, 0}).valid());
}

TEST(PieceKey, NeighboursShareTheirBordersAroundTheGlobe) {
  const std::uint32_t n_x = TileKey::count_x(2), n_y = TileKey::count_y(2);
  std::set<std::tuple<PieceKind, std::uint32_t, std::uint32_t>> all;
  for (std::uint32_t y = 0; y < n_y; ++y) {
    for (std::uint32_t x = 0; x < n_x; ++x) {
      const auto own = pieces_of({2, x, y}), east = pieces_of({2, (x + 1) % n_x, y});
      EXPECT_EQ(own[2], east[0]);  // C1 is the neighbour's C0
      EXPECT_EQ(own[3], east[7]);  // B1, B3
      EXPECT_EQ(own[4], east[6]);  // C2, C3
      if (y + 1 < n_y) {
        const auto north = pieces_of({2, x, y + 1});
        EXPECT_EQ(own[6], north[0]);
        EXPECT_EQ(own[5], north[1]);
        EXPECT_EQ(own[4], north[2]);
      }
      for (const PieceKey& key : own) {
        EXPECT_TRUE(key.valid());
        EXPECT_EQ(key, key.canonical());
        all.insert({key.kind, key.i, key.j});
      }
    }
  }
  const std::uint32_t n_corners = n_x * (n_y - 1) + 2;
  EXPECT_EQ(all.size(), n_corners + n_x * (n_y + 1) + n_x * n_y + n_x * n_y);
}

TEST(PieceKey, IsOrderedByLevelThenMortonCodeThenKind) {
  const PieceKey a{PieceKind::kBody, 1, 3, 1}, b{PieceKind::kCorner, 2, 0, 0}, c{PieceKind::kBody, 2, 0, 0},
      d{PieceKind::kCorner, 2, 1, 0}, e{PieceKind::kCorner, 2, 0, 1};
  EXPECT_TRUE(a < b && b < c && c < d && d < e);
  EXPECT_FALSE(b < a || c < b || d < c || e < d || a < a);
}

}  // namespace
}  // namespace tind
