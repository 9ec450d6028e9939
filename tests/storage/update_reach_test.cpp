// SPDX-License-Identifier: GPL-3.0-or-later
// What changed posts reach, held against a look at every stretch, tile and edge of the plan.
#include "storage/builder/update_reach.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <set>
#include <tuple>
#include <vector>

#include <gtest/gtest.h>

#include "core/piece_key.hpp"
#include "storage/builder/border_lines.hpp"
#include "tests/support/test_field.hpp"

namespace tind {
namespace {

constexpr int kBottom = 6;
using Stretch = std::tuple<int, bool, std::int64_t, std::int64_t>;
using Position = std::tuple<int, std::uint32_t, std::uint32_t>;

Stretch name_of(const RootEdge& root) { return {root.level, root.vertical, root.at, root.start}; }
Position name_of(const TileKey& tile) { return {tile.level, tile.x, tile.y}; }

// Some tiles of data; in the second world across longitude 180, in the third at the south pole.
test::TestField make_field(int world) {
  test::GridPlace place;
  place.lattice_level = kBottom;
  Lattice lattice;
  lattice.level = kBottom;
  const double side = static_cast<double>(lattice.tile_side(kBottom));
  place.dx = place.dy = side / 3;
  place.n_rows = 14;
  place.n_cols = 17;
  place.x0 = world == 1 ? static_cast<double>(lattice.width()) - 2.2 * side : 13.4 * side;
  place.y0 = world == 2 ? 0.4 * side : 30.7 * side;
  return test::TestField(place, test::rough_terrain(5, 100));
}

class UpdateReachTest : public ::testing::TestWithParam<int> {
 protected:
  bool is_planned(const RootEdge& root) const {
    const auto roots = plan_.root_edges(root.level, lattice_);
    return std::any_of(roots.begin(), roots.end(), [&](const RootEdge& r) { return name_of(r) == name_of(root); });
  }
  // Whether closed intervals meet on the circle of longitudes, or on a straight axis (turn 0).
  static bool meet(std::int64_t a, std::int64_t a_end, std::int64_t b, std::int64_t b_end, std::int64_t turn) {
    for (const std::int64_t shift : {-turn, std::int64_t{0}, turn}) {
      if (a + shift <= b_end && a_end + shift >= b) return true;
    }
    return false;
  }

  const test::TestField data_ = make_field(GetParam());
  const Lattice lattice_ = data_.field.lattice;
  const TilePlan plan_{data_.field, kBottom};
  const UpdateReach reach_{plan_, lattice_};
};

TEST_P(UpdateReachTest, FindsTheStretchesThatABottomTileMeets) {
  ASSERT_GT(plan_.tiles(kBottom).size(), 30u);
  const std::int64_t side = lattice_.tile_side(kBottom), width = lattice_.width();
  for (const TileKey& tile : plan_.tiles(kBottom)) {
    std::set<Stretch> found, wanted;
    for (const RootEdge& root : reach_.roots_at(tile)) found.insert(name_of(root));
    const std::int64_t x = side * tile.x, y = side * tile.y;
    for (int level = 0; level <= kBottom; ++level) {
      for (const RootEdge& root : plan_.root_edges(level, lattice_)) {
        const std::int64_t end = root.start + lattice_.tile_side(level);
        const bool meets = root.vertical
                               ? meet(root.at, root.at, x, x + side, width) && meet(root.start, end, y, y + side, 0)
                               : meet(root.start, end, x, x + side, width) && meet(root.at, root.at, y, y + side, 0);
        if (meets) wanted.insert(name_of(root));
      }
    }
    EXPECT_EQ(found, wanted) << tile.x << ' ' << tile.y;
  }
}

TEST_P(UpdateReachTest, FindsTheTilesAndEdgesAlongAStretch) {
  for (int level = 0; level <= kBottom; ++level) {
    for (const RootEdge& root : plan_.root_edges(level, lattice_)) {
      std::set<Position> tiles, wanted;
      std::set<PieceKey> edges, wanted_edges;
      for (const TileKey& tile : reach_.tiles_along(root)) tiles.insert(name_of(tile));
      for (const PieceKey& edge : reach_.edges_along(root)) edges.insert(edge);
      for (int finer = 0; finer <= kBottom; ++finer) {
        for (const TileKey& tile : plan_.tiles(finer)) {
          const auto borders = BorderLines::roots_of(lattice_, tile);
          const auto pieces = pieces_of(tile);
          for (std::size_t b = 0; b < 4; ++b) {
            if (name_of(borders[b]) != name_of(root)) continue;
            wanted.insert(name_of(tile));
            wanted_edges.insert(pieces[2 * b + 1]);
          }
        }
      }
      EXPECT_EQ(tiles, wanted) << level << ' ' << root.at << ' ' << root.start;
      EXPECT_EQ(edges, wanted_edges) << level << ' ' << root.at << ' ' << root.start;
    }
  }
}

TEST_P(UpdateReachTest, FindsCornersAndMiddleLines) {
  for (int level = 0; level < kBottom; ++level) {
    std::set<Stretch> inside, wanted;
    for (const TileKey& tile : plan_.split_tiles(level)) {
      for (const RootEdge& root : reach_.roots_inside(tile)) {
        inside.insert(name_of(root));
        EXPECT_TRUE(parent_of(lattice_, root) == tile);
      }
    }
    for (const RootEdge& root : plan_.root_edges(level + 1, lattice_)) wanted.insert(name_of(root));
    EXPECT_EQ(inside, wanted);
  }
  for (const TileKey& tile : plan_.tiles(kBottom)) {
    std::set<PieceKey> found, wanted;
    for (const PieceKey& key : reach_.corners_at(tile)) found.insert(key);
    const std::array<PieceKey, 9> own = pieces_of(tile);
    // A corner of a coarser tile that lies where this one has its own.
    for (int level = 0; level <= kBottom; ++level) {
      const std::uint32_t n = std::uint32_t{1} << (kBottom - level);
      for (const std::size_t c : {0u, 2u, 4u, 6u}) {
        std::uint32_t i = tile.x + (c == 2 || c == 4 ? 1 : 0), j = tile.y + (c >= 4 ? 1 : 0);
        if (i % n != 0 || j % n != 0) continue;
        const PieceKey key = PieceKey{PieceKind::kCorner, static_cast<std::uint8_t>(level), i / n, j / n}.canonical();
        wanted.insert(key);
        if (level == kBottom) {
          EXPECT_TRUE(key == own[c]);
        }
      }
    }
    EXPECT_EQ(found, wanted);
  }
}

INSTANTIATE_TEST_SUITE_P(Worlds, UpdateReachTest, ::testing::Values(0, 1, 2));

}  // namespace
}  // namespace tind
