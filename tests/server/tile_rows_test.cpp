// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/tile_rows.hpp"

#include <gtest/gtest.h>

#include <random>
#include <set>
#include <tuple>

namespace tind {
namespace {

constexpr auto kFiller = TileCoverage::kFiller, kPartial = TileCoverage::kPartial, kReal = TileCoverage::kReal;
using Tile = std::tuple<std::size_t, std::uint32_t, std::uint32_t>;  // level, y, x

std::set<Tile> tiles_of(const TileRows& rows) {
  std::set<Tile> tiles;
  for (std::size_t level = 0; level < rows.size(); ++level) {
    for (const TileRun& run : rows[level]) {
      for (std::uint32_t x = run.x_first; x <= run.x_last; ++x) {
        EXPECT_TRUE(tiles.insert({level, run.y, x}).second) << "a tile twice";
      }
    }
  }
  return tiles;
}

TEST(TileRows, OwnAreRealTilesAndPartialOnesThatTheBaseLacks) {
  Manifest manifest;
  manifest.levels.resize(4);
  manifest.levels[2].rows = {{1, 0, 1, kFiller}, {1, 2, 3, kPartial}, {1, 4, 5, kReal}};
  manifest.levels[3].rows = {{2, 0, 3, kFiller}, {2, 4, 7, kPartial}, {2, 8, 9, kReal}};
  const TileRows base = {{}, {}, {{1, 0, 7, kReal}}, {{2, 5, 5, kReal}}};
  EXPECT_EQ(tiles_of(own_rows(manifest, base)),
            (std::set<Tile>{{2, 1, 4}, {2, 1, 5}, {3, 2, 4}, {3, 2, 6}, {3, 2, 7}, {3, 2, 8}, {3, 2, 9}}));
}

TEST(TileRows, JoiningIsUnionForRandomRows) {
  std::mt19937 random(7);
  const auto make = [&] {
    TileRows rows(3);
    for (auto& level : rows) {
      for (std::uint32_t y = 0; y < 4; ++y) {
        for (std::uint32_t x = random() % 4; x < 16;) {
          const std::uint32_t last = std::min<std::uint32_t>(15, x + random() % 4);
          level.push_back({y, x, last, kReal});
          x = last + 1 + random() % 5;
        }
      }
    }
    return rows;
  };
  for (int round = 0; round < 200; ++round) {
    const TileRows a = make(), b = make();
    std::set<Tile> both = tiles_of(a);
    both.merge(tiles_of(b));
    const TileRows joined = join_rows(a, b);
    ASSERT_EQ(tiles_of(joined), both);
    for (std::uint8_t level = 0; level < 3; ++level) {
      for (std::uint32_t y = 0; y < TileKey::count_y(level); ++y) {
        for (std::uint32_t x = 0; x < TileKey::count_x(level); ++x) {
          ASSERT_EQ(has_tile(joined, {level, x, y}), both.contains({level, y, x}));
        }
      }
    }
  }
}

}  // namespace
}  // namespace tind
