// SPDX-License-Identifier: GPL-3.0-or-later
// Streams of small worlds.
#include "core/drainage/drainage.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <map>
#include <tuple>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/core/drainage_world.hpp"
#include "tests/support/memory_watch.hpp"

namespace tind {
namespace {

using test::drain;
using test::equator_field;
using test::expect_nodes_only;
using test::options;
using test::post_of;
using test::TestField;
using test::valley;
using ::testing::HasSubstr;

/// Everything in one comparable value.
auto all_of(const Drainage& d) {
  std::vector<std::tuple<std::vector<BreakVertex>, int, double>> lines;
  for (const auto* chains : {&d.streams, &d.shores}) {
    for (const BreakChain& c : *chains) lines.emplace_back(c.vertices, c.first_level, c.weight);
  }
  return std::tuple(lines, d.strahler, d.area_km2, d.downstream, d.counts.clamped, d.counts.uphill_steps);
}

TEST(DrainageStreams, RunDownAValleyAndGrowIntoCoarserLevels) {
  const TestField f = equator_field(60, 21, [](auto r, auto c) { return valley(r, c, 10); });
  const auto d = drain(f.field, options(20));
  ASSERT_TRUE(d) << d.error().message;
  // 20, 80, 320 cells: levels 4, 3, 2. Each post of the valley drains a row of 21 posts more (the rim's corners leave).
  ASSERT_EQ(d->streams.size(), 3u);
  std::map<int, const BreakChain*> by_level;
  for (const BreakChain& chain : d->streams) by_level[chain.first_level] = &chain;
  ASSERT_TRUE(by_level.contains(4) && by_level.contains(3) && by_level.contains(2));
  EXPECT_EQ(by_level[4]->vertices.back(), by_level[3]->vertices.front());
  EXPECT_EQ(by_level[3]->vertices.back(), by_level[2]->vertices.front());
  EXPECT_EQ(post_of(f.field, by_level[2]->vertices.back()), std::pair(std::int64_t{0}, std::int64_t{10}));
  EXPECT_GE(by_level[2]->weight, 320);
  for (std::size_t k = 0; k < d->streams.size(); ++k) {
    EXPECT_EQ(d->strahler[k], 1);
    EXPECT_NEAR(d->area_km2[k] / d->streams[k].weight, 0.3057 * 0.3037, 1e-3);
    for (const BreakVertex& v : d->streams[k].vertices) {
      const auto [r, c] = post_of(f.field, v);
      EXPECT_EQ(c, 10);
      EXPECT_EQ(v.height_m, f.field.height_at(r, c));
    }
  }
  EXPECT_EQ(d->counts.posts, 60 * 21);
  EXPECT_EQ(d->counts.uphill_steps, 0);
  expect_nodes_only(*d);
}

TEST(DrainageStreams, WithoutGrowthEveryLevelDrawsAll) {
  const TestField f = equator_field(60, 21, [](auto r, auto c) { return valley(r, c, 10); });
  DrainageOptions o = options(20);
  o.growth = 1;
  const auto d = drain(f.field, o);
  ASSERT_TRUE(d);
  ASSERT_EQ(d->streams.size(), 1u);
  EXPECT_EQ(d->streams[0].first_level, 0);
}

TEST(DrainageStreams, StrahlerOrderGrowsWhereEqualsMeet) {
  // Two valleys join at row 20; a third comes in at row 10.
  const TestField f = equator_field(60, 41, [](std::int64_t r, std::int64_t c) {
    if (r <= 20)
      return std::min(valley(r, c, 20), r > 10 ? 1e9 : 1 + 0.5 * std::abs(c - 20) + static_cast<double>(r) + 100);
    return std::min(valley(r, c, 20 - (r - 20) / 3), valley(r, c, 20 + (r - 20) / 3));
  });
  const auto d = drain(f.field, options(40));
  ASSERT_TRUE(d);
  ASSERT_FALSE(d->streams.empty());
  int second = 0;
  for (std::size_t k = 0; k < d->streams.size(); ++k) {
    if (d->downstream[k] < 0) continue;
    const auto next = static_cast<std::size_t>(d->downstream[k]);
    EXPECT_EQ(d->streams[k].vertices.back(), d->streams[next].vertices.front());
    EXPECT_GE(d->strahler[next], d->strahler[k]);
    EXPECT_GT(d->area_km2[next], d->area_km2[k]);
    EXPECT_LE(d->streams[next].first_level, d->streams[k].first_level);
    if (d->strahler[next] == 2 && d->strahler[k] == 1) ++second;
  }
  EXPECT_GE(second, 2);
  expect_nodes_only(*d);
}

TEST(DrainageStreams, HeightsRunDownhillHalfWayBetweenPitAndSill) {
  // A pit of 6 m at row 30 and a sill of 4 m at row 20 in the bed.
  const auto height = [](std::int64_t r, std::int64_t c) {
    return valley(r, c, 10) - (r == 30 && c == 10 ? 6 : 0) + (r == 20 && c == 10 ? 4 : 0);
  };
  const TestField f = equator_field(60, 21, height);
  DrainageOptions o = options(20);
  o.deviation_limits_m = {1, 2.4, 100};
  const auto d = drain(f.field, o);
  ASSERT_TRUE(d);
  double last = 1e9;
  std::map<std::int64_t, double> by_row;
  for (const BreakChain& chain : d->streams) {
    for (const BreakVertex& v : chain.vertices) by_row[-post_of(f.field, v).first] = v.height_m;
  }
  for (const auto& [row, z] : by_row) {
    EXPECT_LE(z, last);
    last = z;
  }
  // Pit at 124, the bed below it at 129..125: half of the 5 m.
  EXPECT_DOUBLE_EQ(by_row[-30], (124 + 129) / 2.0);
  EXPECT_DOUBLE_EQ(by_row[-29], (124 + 129) / 2.0);
  EXPECT_DOUBLE_EQ(by_row[-25], (124 + 125) / 2.0);
  EXPECT_DOUBLE_EQ(by_row[-24], 124);
  EXPECT_EQ(d->counts.clamped, 0);
  EXPECT_EQ(d->counts.uphill_steps, 0);
  EXPECT_EQ(d->counts.deviations_above[2], 0);
  EXPECT_GT(d->counts.deviations_above[0], d->counts.deviations_above[1]);
  EXPECT_GT(d->counts.deviations_above[1], 0);
  EXPECT_DOUBLE_EQ(d->counts.largest_deviation_m, 2.5);
}

TEST(DrainageStreams, ADeepPitKeepsItsHeightAndIsCounted) {
  const TestField f = equator_field(
      60, 21, [](std::int64_t r, std::int64_t c) { return valley(r, c, 10) - (r == 30 && c == 10 ? 50 : 0); });
  const auto d = drain(f.field, options(20));
  ASSERT_TRUE(d);
  EXPECT_EQ(d->counts.deep_posts, 1);
  EXPECT_EQ(d->counts.uphill_steps, 1);
  EXPECT_NEAR(d->counts.largest_uphill_m, 49, 1e-9);
  EXPECT_EQ(d->counts.clamped, 0);
  // The pit moves nothing downstream.
  for (const BreakChain& chain : d->streams) {
    for (const BreakVertex& v : chain.vertices) {
      const auto [r, c] = post_of(f.field, v);
      EXPECT_EQ(v.height_m, f.field.height_at(r, c));
    }
  }
}

TEST(DrainageStreams, StopAtABasinAndGoOnBeyond) {
  // A hole of 15 x 15 posts, 200 m deep, in the valley's bed.
  const TestField f = equator_field(60, 41, [](std::int64_t r, std::int64_t c) {
    return valley(r, c, 20) - (r >= 20 && r < 35 && c >= 13 && c < 28 ? 400 : 0);
  });
  const auto d = drain(f.field, options(20));
  ASSERT_TRUE(d);
  EXPECT_EQ(d->counts.basin_posts, 225);
  int above = 0, below = 0;
  for (const BreakChain& chain : d->streams) {
    for (const BreakVertex& v : chain.vertices) {
      const auto [r, c] = post_of(f.field, v);
      EXPECT_FALSE(r >= 20 && r < 35 && c >= 13 && c < 28) << r << " " << c;
      above += r >= 35;
      below += r < 20;
    }
  }
  EXPECT_GT(above, 5);
  EXPECT_GT(below, 5);
}

TEST(DrainageStreams, ASmallDeepPitIsNoBasin) {
  // 7 x 7 posts are fewer than 64: streams run through, at the posts' own heights.
  const TestField f = equator_field(60, 41, [](std::int64_t r, std::int64_t c) {
    return valley(r, c, 20) - (r >= 20 && r < 27 && c >= 17 && c < 24 ? 400 : 0);
  });
  DrainageOptions o = options(20);
  o.lake_area_m2 = 0;
  const auto d = drain(f.field, o);
  ASSERT_TRUE(d);
  EXPECT_EQ(d->counts.basin_posts, 0);
  EXPECT_GE(d->counts.deep_posts, 7);
}

TEST(DrainageStreams, PassVoidsWithoutBeingDrawn) {
  TestField f = equator_field(60, 21, [](auto r, auto c) { return valley(r, c, 10); });
  for (std::int64_t r = 28; r < 32; ++r) {
    for (std::int64_t c = 8; c < 13; ++c) f.origins[static_cast<std::size_t>(r * 21 + c)] = PostOrigin::kFilled;
  }
  const auto d = drain(f.field, options(20));
  ASSERT_TRUE(d);
  double most = 0;
  for (std::size_t k = 0; k < d->streams.size(); ++k) {
    for (const BreakVertex& v : d->streams[k].vertices) {
      const std::int64_t r = post_of(f.field, v).first;
      EXPECT_TRUE(r < 28 || r >= 32);
    }
    most = std::max(most, d->streams[k].weight);
    if (post_of(f.field, d->streams[k].vertices.back()).first == 32) {
      ASSERT_GE(d->downstream[k], 0);
      const BreakChain& next = d->streams[static_cast<std::size_t>(d->downstream[k])];
      EXPECT_EQ(post_of(f.field, next.vertices.front()).first, 27);
    }
  }
  EXPECT_GT(most, 1000) << "the water of the upper valley arrives";
}

TEST(DrainageStreams, FalloffIsOutside) {
  TestField f = equator_field(60, 21, [](auto r, auto c) { return valley(r, c, 10); });
  for (std::size_t i = 0; i < 30 * 21; ++i) f.origins[i] = PostOrigin::kFalloff;
  const auto d = drain(f.field, options(20));
  ASSERT_TRUE(d);
  EXPECT_EQ(d->counts.posts, 30 * 21);
  for (const BreakChain& chain : d->streams) {
    for (const BreakVertex& v : chain.vertices) EXPECT_GE(post_of(f.field, v).first, 30);
  }
}

TEST(DrainageGlobe, StreamsAcrossTheSeamGoOnPastTheWidth) {
  // A whole belt of the globe whose water runs along row 10 over the seam to column 8, eastward and westward.
  test::GridPlace place;
  place.lattice_level = 0;
  place.n_rows = 21;
  place.n_cols = 64;
  place.dx = 131072.0 / 64;
  place.x0 = 700;
  place.y0 = 20000;
  place.dy = 1500;
  for (const bool east : {true, false}) {
    TestField f(place, [&](std::int64_t r, std::int64_t c) {
      const std::int64_t along = east ? (c - 9 + 64) % 64 : (55 - c + 64) % 64;
      return 100 + 1000.0 * static_cast<double>(std::abs(r - 10)) + 10 * static_cast<double>(63 - along) +
             (along == 0 ? 50000 : 0);
    });
    f.field.wraps = true;
    DrainageOptions o = options(20);
    o.growth = 1;  // one long chain
    o.max_change_m = 1e6;
    const auto d = drain(f.field, o);
    ASSERT_TRUE(d);
    bool crossed = false;
    for (const BreakChain& chain : d->streams) {
      std::int64_t least = std::numeric_limits<std::int64_t>::max();
      for (std::size_t k = 0; k < chain.vertices.size(); ++k) {
        const BreakVertex& v = chain.vertices[k];
        least = std::min(least, v.x);
        crossed = crossed || v.x >= f.field.lattice.width();
        if (k > 0) {
          EXPECT_LE(std::abs(v.x - chain.vertices[k - 1].x), 2049);
        }
      }
      EXPECT_GE(least, 0);
      EXPECT_LT(least, f.field.lattice.width());
    }
    EXPECT_TRUE(crossed) << east;
  }
}

TEST(DrainageStreams, KeepNoVerticesOnTheHeap) {
  const std::int64_t n_rows = 1000;
  const TestField f = equator_field(n_rows, 210, [](auto r, auto c) { return valley(r, c % 21, 10); });
  test::UncountedMemory scratch, kept;
  DrainageOptions o = options(20);
  o.growth = 1;
  o.kept = [&](std::size_t n_bytes) { return kept.take(n_bytes); };
  const std::size_t held_before = test::held_bytes();
  const auto d = derive_drainage(f.field, o, [&](std::size_t n_bytes) { return scratch.take(n_bytes); });
  const std::size_t held = test::held_bytes() - held_before;
  ASSERT_TRUE(d) << d.error().message;
  std::size_t n_vertices = 0;
  for (const BreakChain& chain : d->streams) {
    EXPECT_TRUE(chain.vertices.empty());
    n_vertices += chain.points().size();
  }
  ASSERT_GE(n_vertices, 9 * static_cast<std::size_t>(n_rows));
  EXPECT_GE(kept.n_bytes(), n_vertices * sizeof(BreakVertex));
  EXPECT_LT(held, 4000 + 300 * d->streams.size());  // vertices have 24 bytes each
}

TEST(DrainageOfRoughTerrain, KeepsItsPromises) {
  for (const std::uint64_t seed : {1, 2, 3}) {
    const auto rough = test::rough_terrain(seed, 120);
    const TestField f = equator_field(200, 180, [&](std::int64_t r, std::int64_t c) {
      const double z = rough(r, c);
      return z < 25 ? 25.0 : std::floor(z);
    });
    DrainageOptions o = options(30, 8);
    o.lake_area_m2 = 1;
    o.max_change_m = 6;
    const auto d = drain(f.field, o);
    ASSERT_TRUE(d);
    EXPECT_EQ(d->counts.clamped, 0) << "no pit that is conditioned is deeper than 2 max_change_m";
    EXPECT_LE(d->counts.largest_deviation_m, 6);
    EXPECT_GT(d->streams.size(), 20u);
    expect_nodes_only(*d);
    for (std::size_t k = 0; k < d->streams.size(); ++k) {
      for (const BreakVertex& v : d->streams[k].vertices) {
        const auto [r, c] = post_of(f.field, v);
        ASSERT_LE(std::abs(v.height_m - f.field.height_at(r, c)), 6);
      }
    }
    for (const std::int64_t side : {16, 64}) {
      o.block_side = side;
      o.run.threads = side == 16 ? 3 : 1;
      const auto blocks = drain(f.field, o);
      ASSERT_TRUE(blocks);
      EXPECT_EQ(all_of(*blocks), all_of(*d)) << side;
    }
  }
}

TEST(DrainageOptions, OutOfRangeAreRefused) {
  const TestField f = equator_field(8, 8, [](auto r, auto) { return static_cast<double>(r); });
  const auto message = [&](auto change) {
    DrainageOptions o = options(20);
    change(o);
    const auto d = drain(f.field, o);
    return d ? std::string() : d.error().message;
  };
  EXPECT_EQ(message([](DrainageOptions&) {}), "");
  EXPECT_THAT(message([](DrainageOptions& o) { o.cells = 0; }), HasSubstr("at least 1 cell"));
  EXPECT_THAT(message([](DrainageOptions& o) { o.growth = 0.5; }), HasSubstr("growth"));
  EXPECT_THAT(message([](DrainageOptions& o) { o.growth = NAN; }), HasSubstr("growth"));
  EXPECT_THAT(message([](DrainageOptions& o) { o.lake_area_m2 = -1; }), HasSubstr("lake"));
  EXPECT_THAT(message([](DrainageOptions& o) { o.max_change_m = -1; }), HasSubstr("change"));
  EXPECT_THAT(message([](DrainageOptions& o) { o.sea_level_m = INFINITY; }), HasSubstr("sea level"));
  EXPECT_THAT(message([](DrainageOptions& o) { o.bottom_level = 29; }), HasSubstr("bottom level"));
  EXPECT_THAT(message([](DrainageOptions& o) { o.block_side = 0; }), HasSubstr("blocks"));
  EXPECT_THAT(message([](DrainageOptions& o) { o.run.threads = 0; }), HasSubstr("thread"));
  const auto none = derive_drainage(f.field, options(20), [](std::size_t) -> void* { return nullptr; });
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().kind, ErrorKind::kIo);
}

TEST(DrainageRun, TellsHowFarItIsAndStopsWhenAsked) {
  const TestField f = equator_field(300, 300, [](auto r, auto c) { return valley(r, c, 150); });
  std::vector<double> shares;
  DrainageOptions o = options(20);
  o.block_side = 32;
  o.run.progress = [&](double share) { shares.push_back(share); };
  const auto whole = drain(f.field, o);
  ASSERT_TRUE(whole);
  EXPECT_GT(shares.size(), 20u);
  EXPECT_TRUE(std::is_sorted(shares.begin(), shares.end()));
  EXPECT_GE(shares.front(), 0);
  EXPECT_EQ(shares.back(), 1);
  // Wherever it is: nothing more is told after a few steps, and no drainage comes.
  for (std::size_t stop_at = 0; stop_at + 1 < shares.size(); stop_at += 3) {
    std::atomic<bool> cancel{false};
    std::size_t n = 0;
    o.run.cancel = &cancel;
    o.run.progress = [&](double) {
      if (n++ == stop_at) cancel = true;
    };
    const auto stopped = drain(f.field, o);
    ASSERT_FALSE(stopped) << stop_at;
    EXPECT_EQ(stopped.error().kind, ErrorKind::kInterrupted);
    EXPECT_LE(n, stop_at + 8);
  }
}

TEST(DrainageRun, ScratchThatEndsBeforeTheStreamsIsTold) {
  const TestField f = equator_field(40, 40, [](auto r, auto c) { return valley(r, c, 20); });
  std::vector<std::vector<double>> memory;
  const auto d = derive_drainage(f.field, options(20), [&](std::size_t n_bytes) -> void* {
    if (memory.size() == 5) return nullptr;
    memory.emplace_back(n_bytes / sizeof(double) + 1);
    return memory.back().data();
  });
  ASSERT_FALSE(d);
  EXPECT_EQ(d.error().kind, ErrorKind::kIo);
  EXPECT_THAT(d.error().message, HasSubstr("streams"));
}

}  // namespace
}  // namespace tind
