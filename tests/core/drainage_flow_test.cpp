// SPDX-License-Identifier: GPL-3.0-or-later
// Filling, directions and accumulation: hand-made grids, then invariants on rough terrain.
#include "core/drainage/flow.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <set>
#include <thread>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/drainage/block_schedule.hpp"
#include "core/drainage/compare.hpp"
#include "tests/core/drainage_world.hpp"

namespace tind {
namespace {

using test::FlowWorld;
using test::kNone;
using ::testing::Each;

/// Rough terrain in whole metres (many flats and pits), with holes.
std::vector<std::vector<float>> rough_map(std::uint64_t seed, std::int64_t n_rows, std::int64_t n_cols, double metres,
                                          double holes = 0) {
  const auto height = test::rough_terrain(seed, metres);
  std::vector<std::vector<float>> map(static_cast<std::size_t>(n_rows));
  for (std::int64_t r = 0; r < n_rows; ++r) {
    for (std::int64_t c = 0; c < n_cols; ++c) {
      const bool hole = test::noise(seed + 99, r / 3, c / 3) < holes;
      map[static_cast<std::size_t>(r)].push_back(hole ? kNone : static_cast<float>(std::floor(height(r, c))));
    }
  }
  return map;
}

/// The definition itself, repeated until nothing changes.
std::vector<float> brute_fill(const FlowGrid& g) {
  const float top = std::numeric_limits<float>::infinity();
  std::vector<float> w(static_cast<std::size_t>(g.size()), -top);
  for (std::int64_t i = 0; i < g.size(); ++i) {
    if (g.marks[i] & kInside) w[static_cast<std::size_t>(i)] = g.marks[i] & kOutlet ? g.heights_m[i] : top;
  }
  for (bool changed = true; changed;) {
    changed = false;
    for (std::int64_t i = 0; i < g.size(); ++i) {
      if (!(g.marks[i] & kInside)) continue;
      for (int d = 0; d < 8; ++d) {
        const std::int64_t n = g.neighbour(i / g.n_cols, i % g.n_cols, d);
        if (n < 0 || !(g.marks[n] & kInside)) continue;
        const float level = std::max(g.heights_m[i], w[static_cast<std::size_t>(n)]);
        if (level < w[static_cast<std::size_t>(i)]) {
          w[static_cast<std::size_t>(i)] = level;
          changed = true;
        }
      }
    }
  }
  return w;
}

TEST(BlockSchedule, SettlesRowsOfBlocksBeforeTheNext) {
  BlockSchedule schedule(64, 256, false, 8);
  std::vector<std::int64_t> rows;  // of blocks, in pairs
  const auto visit = [&](int, BlockSchedule::Visit& v) {
    rows.push_back(v.row_begin / 16);
    if (v.first && v.col_begin > 0) v.hand_over(v.row_begin, v.col_begin - 1);
  };
  ASSERT_TRUE(schedule.run({}, visit, [] {}));
  EXPECT_GT(rows.size(), 300u);  // 256 blocks, half of them again
  EXPECT_TRUE(std::is_sorted(rows.begin(), rows.end()));
}

TEST(DrainageFill, RaisesAPitToItsSpill) {
  FlowWorld w({{9, 9, 9, 9, 9}, {9, 2, 3, 9, 9}, {9, 3, 1, 6, 5}, {9, 9, 9, 9, 9}});
  w.run();
  for (const auto& [r, c] : {std::pair{1, 1}, {1, 2}, {2, 1}, {2, 2}}) EXPECT_EQ(w.filled_m[w.at(r, c)], 6) << r << c;
  EXPECT_EQ(w.filled_m[w.at(2, 4)], 5);
  EXPECT_EQ(w.filled_m[w.at(1, 3)], 9);
}

TEST(DrainageFill, NestedPitsShareTheOuterSpill) {
  // Two pits (1 and 2) behind sills of 4; the hollow around them spills at 7.
  FlowWorld w({{9, 9, 9, 9, 9, 9, 9}, {9, 1, 4, 2, 5, 5, 9}, {9, 9, 9, 9, 9, 7, 9}, {9, 9, 9, 9, 9, 6, 9}});
  w.run();
  for (int c = 1; c <= 5; ++c) EXPECT_EQ(w.filled_m[w.at(1, c)], 7) << c;
  EXPECT_EQ(w.filled_m[w.at(2, 5)], 7);
}

TEST(DrainageFill, WaterLeavesIntoAHole) {
  FlowWorld w({{9, 9, 9, 9, 9}, {9, 4, 9, 9, 9}, {9, 9, 6, kNone, 9}, {9, 9, 9, 9, 9}});
  w.run();
  EXPECT_EQ(w.filled_m[w.at(1, 1)], 6);
  EXPECT_EQ(w.directions[w.at(2, 2)], kLeaves);
  EXPECT_EQ(w.directions[w.at(2, 3)], kNoFlow);
  EXPECT_EQ(w.filled_m[w.at(2, 3)], -std::numeric_limits<float>::infinity());
}

TEST(DrainageFill, EqualsItsDefinitionForAnyBlockSize) {
  for (const std::uint64_t seed : {1, 2, 3, 4, 5, 6}) {
    FlowWorld w(rough_map(seed, 47, 61, 12, seed % 2 ? 0.02 : 0));
    mark_outlets(w.grid);
    const std::vector<float> expected = brute_fill(w.grid);
    for (const std::int64_t side : {1, 2, 7, 16, 64, 32768}) {
      std::vector<float> filled(expected.size());
      fill_depressions(w.grid, side, filled.data());
      ASSERT_EQ(filled, expected) << "seed " << seed << " side " << side;
    }
  }
}

TEST(DrainageFill, GlobeWithoutAnOutletDrainsToItsLowestPost) {
  FlowWorld w({{5, 6, 7, 8}, {5, 3, 7, 4}, {5, 6, 7, 8}});
  w.grid.wraps = true;
  w.grid.closed_south = w.grid.closed_north = true;
  w.run();
  EXPECT_EQ(w.directions[w.at(1, 1)], kLeaves);
  EXPECT_EQ(std::count(w.directions.begin(), w.directions.end(), kLeaves), 1);
  EXPECT_EQ(w.accumulation[w.at(1, 1)], 12 * kCell);
  EXPECT_EQ(w.filled_m[w.at(1, 3)], 5) << "over the seam";
}

TEST(DrainageDirections, TakeTheSteepestDescentInMetres) {
  const std::vector<std::vector<float>> map = {{9, 9, 9}, {9, 8, 5}, {9, 5, 9}};
  FlowWorld square(map);
  square.run();
  EXPECT_EQ(square.directions[square.at(1, 1)], 0) << "of two equal descents, E before S";
  FlowWorld wide(map, 2, 1);
  wide.run();
  EXPECT_EQ(wide.directions[wide.at(1, 1)], 6);
  // Diagonally 4 down over 1.41 is less than 3 down over 1.
  FlowWorld diagonal({{9, 9, 9}, {9, 8, 5}, {9, 9, 4}});
  diagonal.run();
  EXPECT_EQ(diagonal.directions[diagonal.at(1, 1)], 0);
  FlowWorld steeper({{9, 9, 9}, {9, 8, 5}, {9, 9, 3}});
  steeper.run();
  EXPECT_EQ(steeper.directions[steeper.at(1, 1)], 7);
}

TEST(DrainageDirections, APeakSendsItsWaterEast) {
  FlowWorld w({{1, 1, 1}, {1, 9, 1}, {1, 1, 1}});
  w.run();
  EXPECT_EQ(w.directions[w.at(1, 1)], 0);
}

TEST(DrainageDirections, FlatDrainsToItsNearerOutlet) {
  FlowWorld w({{9, 9, 9, 9, 9, 9, 9, 9}, {4, 5, 5, 5, 5, 5, 5, 4}, {9, 9, 9, 9, 9, 9, 9, 9}});
  w.run();
  for (const int c : {1, 2, 3}) EXPECT_EQ(w.directions[w.at(1, c)], 4) << c;
  for (const int c : {4, 5, 6}) EXPECT_EQ(w.directions[w.at(1, c)], 0) << c;
  // The posts at both ends of the flat have a lower neighbour.
  EXPECT_FALSE(w.marks[w.at(1, 1)] & kInFlat);
  EXPECT_TRUE(w.marks[w.at(1, 2)] & kInFlat);
}

TEST(DrainageDirections, FlatKeepsToItsMiddleAwayFromHigherGround) {
  // A wide level valley between walls: its water gathers half way between them (Barnes 2014, two gradients).
  std::vector<std::vector<float>> map(9, std::vector<float>(15, 5));
  for (auto& row : map) row[0] = 9;
  map.front().assign(15, 9);
  map.back().assign(15, 9);
  map[4][14] = 4;
  for (const int r : {1, 2, 3, 5, 6, 7}) map[static_cast<std::size_t>(r)][14] = 9;
  FlowWorld w(map);
  w.run();
  EXPECT_GT(w.accumulation[w.at(4, 10)], 25 * kCell);
  EXPECT_EQ(w.directions[w.at(1, 6)], 7) << "from the northern wall to the south-east";
  EXPECT_EQ(w.directions[w.at(7, 6)], 1);
}

TEST(DrainageDirections, SaddlePartsItsWaters) {
  FlowWorld w({{9, 9, 9, 9, 9}, {9, 9, 8, 9, 9}, {2, 3, 5, 4, 3}, {9, 9, 8, 9, 9}, {9, 9, 9, 9, 9}});
  w.run();
  EXPECT_EQ(w.directions[w.at(2, 2)], 4);
  EXPECT_EQ(w.directions[w.at(2, 3)], 0);
  EXPECT_EQ(w.directions[w.at(1, 2)], 5) << "5 down over 1.41";
}

TEST(DrainageDirections, WaterCrossesTheSeamOfAGlobe) {
  // A valley from column 1 westward over the seam to the last column, then out through the south.
  FlowWorld w({{9, 9, 9, 9, 9}, {5, 6, 9, 9, 4}, {9, 9, 9, 9, 3}});
  w.grid.wraps = true;
  w.grid.closed_north = true;
  w.run();
  EXPECT_EQ(w.downstream(static_cast<std::int64_t>(w.at(1, 0))), static_cast<std::int64_t>(w.at(2, 4)));
  EXPECT_EQ(w.directions[w.at(2, 4)], kLeaves);
  EXPECT_GE(w.accumulation[w.at(2, 4)], 5 * kCell);
}

class DrainageOnRoughTerrain : public ::testing::TestWithParam<int> {};

TEST_P(DrainageOnRoughTerrain, EveryPostDrainsDownhillAndSumsAreRight) {
  const auto seed = static_cast<std::uint64_t>(GetParam());
  FlowWorld w(rough_map(seed, 83, 90, seed % 2 ? 300 : 9, 0.01), 1, 1.3);
  w.run();
  std::vector<std::uint64_t> inflow(w.heights_m.size(), 0);
  std::uint64_t left = 0, rained = 0;
  for (std::int64_t i = 0; i < w.grid.size(); ++i) {
    const auto k = static_cast<std::size_t>(i);
    if (!(w.marks[k] & kInside)) {
      ASSERT_EQ(w.directions[k], kNoFlow);
      ASSERT_EQ(w.accumulation[k], 0u);
      continue;
    }
    ASSERT_GE(w.filled_m[k], w.heights_m[k]);
    rained += kCell;
    const std::int64_t n = w.downstream(i);
    if (n < 0) {
      ASSERT_TRUE(w.marks[k] & kOutlet) << i;
      left += w.accumulation[k];
      continue;
    }
    ASSERT_TRUE(w.marks[static_cast<std::size_t>(n)] & kInside);
    ASSERT_LE(w.filled_m[static_cast<std::size_t>(n)], w.filled_m[k]);
    inflow[static_cast<std::size_t>(n)] += w.accumulation[k];
    std::int64_t at = i;
    std::int64_t n_steps = 0;
    while (at >= 0 && n_steps <= w.grid.size()) {
      at = w.downstream(at);
      ++n_steps;
    }
    ASSERT_LT(at, 0) << "a cycle below " << i;
  }
  EXPECT_EQ(left, rained);
  for (std::size_t k = 0; k < inflow.size(); ++k) {
    if (w.marks[k] & kInside) {
      ASSERT_EQ(w.accumulation[k], inflow[k] + kCell) << k;
    }
  }
}

TEST_P(DrainageOnRoughTerrain, NoTwoFlowsCross) {
  const auto seed = static_cast<std::uint64_t>(GetParam());
  FlowWorld w(rough_map(seed, 120, 120, seed % 2 ? 300 : 7), 1, seed % 3 ? 1 : 0.6);
  w.run();
  const auto diagonal = [&](std::int64_t r, std::int64_t c, int out, int back, int far_r, int far_c) {
    const std::int64_t a = r * w.n_cols + c, b = (r + far_r) * w.n_cols + c + far_c;
    return w.directions[static_cast<std::size_t>(a)] == out || w.directions[static_cast<std::size_t>(b)] == back;
  };
  std::int64_t n_diagonal = 0;
  for (std::int64_t r = 0; r + 1 < w.n_rows; ++r) {
    for (std::int64_t c = 0; c + 1 < w.n_cols; ++c) {
      const bool rising = diagonal(r, c, 1, 5, 1, 1), falling = diagonal(r, c + 1, 3, 7, 1, -1);
      n_diagonal += rising + falling;
      ASSERT_FALSE(rising && falling) << r << " " << c;
    }
  }
  EXPECT_GT(n_diagonal, 1000);
}

TEST_P(DrainageOnRoughTerrain, BlockSizeAndThreadsChangeNothing) {
  const auto seed = static_cast<std::uint64_t>(GetParam());
  const auto map = rough_map(seed, 150, 131, seed % 2 ? 300 : 6, 0.005);
  FlowWorld whole(map);
  whole.grid.wraps = seed % 2 == 0;
  whole.run(32768);
  for (const auto& [side, threads] : {std::pair{1, 3}, {2, 1}, {3, 1}, {7, 4}, {16, 3}, {43, 3}, {64, 2}}) {
    FlowWorld blocks(map);
    blocks.grid.wraps = whole.grid.wraps;
    blocks.run(side, threads);
    EXPECT_EQ(blocks.filled_m, whole.filled_m) << side;
    EXPECT_EQ(blocks.directions, whole.directions) << side;
    EXPECT_EQ(blocks.accumulation, whole.accumulation) << side;
    EXPECT_EQ(blocks.marks, whole.marks) << side;
  }
}

TEST(DrainageDirections, AWideFlatDrainsThoughItsFarPostsAreAllAsFarFromHigherGround) {
  // Higher ground at the western end, the way out at the eastern one, no water over the other sides.
  const std::int64_t n = 3 * std::int64_t{FlatSteps::kFarAway};
  std::vector<std::vector<float>> map(3, std::vector<float>(static_cast<std::size_t>(n), 5));
  for (auto& row : map) row[0] = 9;
  FlowWorld w(map);
  w.grid.closed_south = w.grid.closed_north = true;
  w.run(64, 2);
  for (std::int64_t r = 0; r < 3; ++r) {
    for (std::int64_t c = 0; c + 1 < n; ++c) ASSERT_EQ(w.directions[w.at(r, c)], 0) << r << " " << c;
    EXPECT_EQ(w.accumulation[w.at(r, n - 1)] / kCell, static_cast<std::uint64_t>(n));
  }
}

TEST(DrainageSchedule, BlocksThatTouchAreNeverVisitedTogether) {
  for (const bool wraps : {false, true}) {
    for (const std::int64_t n_cols : {1, 7, 9, 12, 15, 20}) {
      // What a visit may change: its block and the ring around it.
      std::vector<std::atomic<int>> users(static_cast<std::size_t>(14 * n_cols));
      std::atomic<int> n_clashes{0}, n_visits{0};
      BlockSchedule schedule(14, n_cols, wraps, 3);
      const auto touch = [&](const BlockSchedule::Visit& v, int change) {
        for (std::int64_t r = std::max<std::int64_t>(v.row_begin - 1, 0); r < std::min<std::int64_t>(v.row_end + 1, 14);
             ++r) {
          std::set<std::int64_t> cols;
          for (std::int64_t c = v.col_begin - 1; c <= v.col_end; ++c) {
            if (wraps || (c >= 0 && c < n_cols)) cols.insert((c + n_cols) % n_cols);
          }
          for (const std::int64_t c : cols) {
            const int others = users[static_cast<std::size_t>(r * n_cols + c)].fetch_add(change);
            if (change > 0 && others > 0) ++n_clashes;
          }
        }
      };
      EXPECT_TRUE(schedule.run(
          {8, nullptr, {}},
          [&](int, BlockSchedule::Visit& v) {
            touch(v, 1);
            std::this_thread::yield();
            ++n_visits;
            if (v.first && v.row_end < 14) v.hand_over(v.row_end, v.col_begin);
            touch(v, -1);
          },
          [] {}));
      EXPECT_EQ(n_clashes, 0) << wraps << " " << n_cols;
      EXPECT_GT(n_visits, schedule.n_blocks());
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Seeds, DrainageOnRoughTerrain, ::testing::Range(1, 7));

TEST(DrainageGrid, CellsCountAreaOnTheGlobe) {
  // Posts from 20 to 60 degrees north: cos(20) / cos(40) and cos(60) / cos(40) of the area in the middle, but for the
  // ellipsoid.
  test::GridPlace place;
  place.lattice_level = 4;
  place.n_rows = 41;
  place.n_cols = 3;
  place.dx = place.dy = static_cast<double>(std::int64_t{1} << 20) / 180;
  place.y0 = 110 * place.dy;
  const test::TestField field(place, [](std::int64_t, std::int64_t) { return 1.0; });
  std::vector<std::uint8_t> marks(field.heights_m.size());
  const FlowGrid g = make_flow_grid(field.field, marks.data());
  const auto cells = [&](std::size_t row) { return static_cast<double>(g.share[row]) / double{kCell}; };
  EXPECT_NEAR(cells(20), 1, 0.001);
  EXPECT_NEAR(cells(0), std::cos(20 * M_PI / 180) / std::cos(40 * M_PI / 180), 0.01);
  EXPECT_NEAR(cells(40), std::cos(60 * M_PI / 180) / std::cos(40 * M_PI / 180), 0.01);
  EXPECT_NEAR(g.east_m[20], 111320 * std::cos(40 * M_PI / 180), 150);
  EXPECT_NEAR(g.north_m[20], 111040, 50);
  EXPECT_NEAR(g.cell_area_m2, g.east_m[20] * g.north_m[20], 1e-3 * g.cell_area_m2);
}

TEST(DrainageGrid, NoWaterCrossesAPole) {
  test::GridPlace place;
  place.lattice_level = 0;
  place.n_rows = 5;
  place.n_cols = 8;
  place.dx = 16384;
  place.dy = 8192;
  place.y0 = 65536 - 4 * place.dy;
  // Lowest on the pole, then at the southern end: water must turn round.
  test::TestField field(place, [](std::int64_t r, std::int64_t) { return r == 4 ? -50.0 : static_cast<double>(r); });
  field.field.wraps = true;
  field.field.continues_north = true;
  std::vector<std::uint8_t> marks(40), directions(40);
  std::vector<float> filled(40);
  std::vector<FlatSteps> steps(40);
  const FlowGrid g = make_flow_grid(field.field, marks.data());
  mark_outlets(g);
  EXPECT_THAT(std::vector<std::uint8_t>(marks.begin() + 32, marks.end()), Each(kClosed));
  EXPECT_THAT(std::vector<std::uint8_t>(marks.begin() + 24, marks.begin() + 32), Each(kInside));
  fill_depressions(g, 16, filled.data());
  direct_flow(g, 16, filled.data(), steps.data(), directions.data());
  EXPECT_THAT(std::vector<std::uint8_t>(directions.begin() + 8, directions.begin() + 32), Each(6));
  EXPECT_THAT(std::vector<std::uint8_t>(directions.begin() + 32, directions.end()), Each(kNoFlow));
}

TEST(DrainageFlow, OfAPlainRasterHasMasks) {
  const FlowWorld w({{9, 9, 9, 9}, {9, 2, 7, 9}, {9, 9, 6, 5}, {9, 9, 9, 9}});
  const Flow flow = flow_of(w.heights_m.data(), w.n_rows, w.n_cols, 1, 1);
  EXPECT_EQ(flow.raised[w.at(1, 1)], 1);
  EXPECT_EQ(flow.raised[w.at(1, 2)], 0);
  EXPECT_EQ(flow.cells[w.at(2, 3)], 15) << "all but the south-western corner, which has no lower neighbour";
  EXPECT_EQ(flow.directions[w.at(1, 1)], 7);
  const auto mask = channel_mask(flow, 2);
  EXPECT_EQ(mask[w.at(2, 2)], 1);
  EXPECT_EQ(mask[w.at(0, 0)], 0);
  const auto posts = stream_posts(flow, 2);
  ASSERT_GE(posts.size(), 2u);
}

}  // namespace
}  // namespace tind
