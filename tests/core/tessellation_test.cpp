// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/tessellation.hpp"

#include <algorithm>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/test_field.hpp"
#include "tests/support/test_tile.hpp"

namespace tind::test {
namespace {

using testing::ElementsAre;
using Entries = std::vector<std::uint8_t>;

TEST(Runs, CountWhatEnteredUpToEachFinerLevel) {
  EXPECT_THAT(encode_runs(Entries{6, 7, 6, 9, 8}, 5, 4), ElementsAre(2, 3, 4, 5));
  EXPECT_THAT(encode_runs(Entries{6, 7, 6, 9, 8}, 5, 2), ElementsAre(2, 3));
  EXPECT_THAT(encode_runs(Entries{}, 5, 3), ElementsAre(0, 0, 0));
  EXPECT_THAT(encode_runs(Entries{3, 5}, 5, 1), ElementsAre(0));  // not finer
}

TEST(CoarseRuns, EndAtVerticesThatTheCoarserLevelHas) {
  const CoarseRuns runs = coarse_runs(Entries{4, 7, 6, 5, 7, 4, 6}, 5);
  EXPECT_THAT(runs.runs, ElementsAre(2, 1, 0));
  EXPECT_FALSE(runs.starts_inside);
  EXPECT_TRUE(runs.ends_inside);
  EXPECT_THAT(coarse_runs(Entries{6, 7, 4}, 5).runs, ElementsAre(1));
  EXPECT_TRUE(coarse_runs(Entries{6, 7, 4}, 5).starts_inside);
  EXPECT_THAT(coarse_runs(Entries{4, 4}, 4).runs, ElementsAre(0));
}

/// Runs of the intervals of `level` on a line, the long way round: both ends of every interval known.
TEST(Runs, AgreeWithEntryLevelsWhereOneFinerLevelMeetsTheInterval) {
  const TileKey key{5, 20, 13};
  const TestField f(place_over(5, 20, 13, 7, 2600.7, 3), rough_terrain(8, 1500));
  const TestTile tile = make_task(f.field, spec_from(5, 90, 4, f.field.lattice), key);
  for (const auto& line : tile.lines) {
    for (int gap = 1; gap <= 3; ++gap) {
      // What the finer neighbour's border of level 5 + gap looks like to level 5.
      Entries finer;
      for (const LineVertex& v : line) {
        if (v.entry <= 5 + gap) finer.push_back(v.entry);
      }
      const CoarseRuns cut = coarse_runs(finer, 5);
      // And what the coarse tile's own code says.
      std::vector<std::uint32_t> coded;
      Entries inside;
      for (std::size_t k = 1; k < line.size(); ++k) {
        if (line[k].entry > 5) {
          inside.push_back(line[k].entry);
          continue;
        }
        coded.push_back(encode_runs(inside, 5, 3)[static_cast<std::size_t>(gap - 1)]);
        inside.clear();
      }
      EXPECT_EQ(cut.runs, coded);
      EXPECT_GT(*std::max_element(coded.begin(), coded.end()), 0u);
    }
  }
}

TEST(Fan, ReplacesATriangleByOnePerPieceOfItsBorderEdge) {
  std::vector<Triangle> out;
  fan(std::vector<std::uint32_t>{10, 11, 12, 13}, 5, out);
  EXPECT_THAT(out, ElementsAre(Triangle{10, 11, 5}, Triangle{11, 12, 5}, Triangle{12, 13, 5}));
}

// docs/format.md 6, worked by hand.
TEST(ZigZag, FollowsTheFormat) {
  std::vector<Triangle> out;
  zig_zag(0, std::vector<std::uint32_t>{1}, std::vector<std::uint32_t>{2}, out);
  EXPECT_THAT(out, ElementsAre(Triangle{0, 1, 2}));
  out.clear();
  // |R| = 3, |Q| = 2: (i+1)*2 <= (j+1)*3 holds at (0,0), not at (1,0), holds at (1,1).
  zig_zag(0, std::vector<std::uint32_t>{1, 2, 3}, std::vector<std::uint32_t>{8, 9}, out);
  EXPECT_THAT(out, ElementsAre(Triangle{0, 1, 8}, Triangle{1, 2, 8}, Triangle{2, 9, 8}, Triangle{2, 3, 9}));
  out.clear();
  // |R| = |Q| = 2: a tie goes to R.
  zig_zag(0, std::vector<std::uint32_t>{1, 2}, std::vector<std::uint32_t>{8, 9}, out);
  EXPECT_THAT(out, ElementsAre(Triangle{0, 1, 8}, Triangle{1, 2, 8}, Triangle{2, 9, 8}));
  out.clear();
  zig_zag(0, std::vector<std::uint32_t>{1, 2, 3}, std::vector<std::uint32_t>{8}, out);
  EXPECT_THAT(out, ElementsAre(Triangle{0, 1, 8}, Triangle{1, 2, 8}, Triangle{2, 3, 8}));
  out.clear();
  zig_zag(0, std::vector<std::uint32_t>{1}, std::vector<std::uint32_t>{8, 9}, out);
  EXPECT_THAT(out, ElementsAre(Triangle{0, 1, 8}, Triangle{1, 9, 8}));
}

TEST(ZigZag, FillsTheCornerWithPositiveTrianglesForAnyChains) {
  for (std::uint64_t seed = 0; seed < 300; ++seed) {
    // The SW corner: R eastwards, Q northwards, at uneven distances.
    Mesh mesh;
    mesh.vertices.push_back({0, 0, 0});
    std::array<std::vector<std::uint32_t>, 2> chains;
    std::array<std::int64_t, 2> ends{};
    for (int axis = 0; axis < 2; ++axis) {
      const int n = 1 + static_cast<int>(noise(seed, axis, 0) * 12);
      for (int k = 1; k <= n; ++k) {
        std::int64_t& end = ends[static_cast<std::size_t>(axis)];
        end += 1 + static_cast<std::int64_t>(noise(seed, axis, k) * noise(seed, axis, k + 99) * 5000);
        chains[static_cast<std::size_t>(axis)].push_back(static_cast<std::uint32_t>(mesh.vertices.size()));
        mesh.vertices.push_back(axis == 0 ? LocalVertex{end, 0, 0} : LocalVertex{0, end, 0});
      }
    }
    zig_zag(0, chains[0], chains[1], mesh.triangles);
    EXPECT_EQ(mesh.triangles.size(), chains[0].size() + chains[1].size() - 1);
    EXPECT_TRUE(doubled_area(mesh) == Int128{ends[0]} * ends[1]) << seed;  // all positive, no overlap, no gap
  }
}

TEST(VirtualTriangles, AreListedInRingOrderWithTheirBorderEdges) {
  // A square cut by its diagonal C1-C3: two corner triangles.
  EXPECT_THAT(find_virtual_triangles({{0, 1, 3}, {1, 2, 3}}, {0, 0, 0, 0}),
              ElementsAre(VirtualTriangle{0, 2, 0, 0, {}}, VirtualTriangle{1, 2, 2, 0, {}}));
  // The other diagonal C0-C2.
  EXPECT_THAT(find_virtual_triangles({{0, 1, 2}, {0, 2, 3}}, {0, 0, 0, 0}),
              ElementsAre(VirtualTriangle{0, 2, 1, 0, {}}, VirtualTriangle{1, 2, 3, 0, {}}));
  // One vertex in the middle: every border edge has its own triangle.
  EXPECT_THAT(find_virtual_triangles({{0, 1, 4}, {0, 4, 3}, {1, 2, 4}, {2, 3, 4}}, {0, 0, 0, 0}),
              ElementsAre(VirtualTriangle{0, 1, 0, 0, {}}, VirtualTriangle{2, 1, 1, 0, {}},
                          VirtualTriangle{3, 1, 2, 0, {}}, VirtualTriangle{1, 1, 3, 0, {}}));
  // A vertex (1) inside the south side: C1 is 2, C2 3, C3 4.
  EXPECT_THAT(
      find_virtual_triangles({{0, 1, 4}, {1, 2, 3}, {1, 3, 4}}, {1, 0, 0, 0}),
      ElementsAre(VirtualTriangle{0, 2, 0, 0, {}}, VirtualTriangle{1, 2, 1, 0, {}}, VirtualTriangle{2, 1, 2, 0, {}}));
}

}  // namespace
}  // namespace tind::test
