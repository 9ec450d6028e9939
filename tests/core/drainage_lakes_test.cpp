// SPDX-License-Identifier: GPL-3.0-or-later
// Lakes, the sea and their shores.
#include <algorithm>
#include <cmath>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/drainage/drainage.hpp"
#include "tests/core/drainage_world.hpp"

namespace tind {
namespace {

using test::drain;
using test::equator_field;
using test::expect_nodes_only;
using test::options;
using test::post_of;
using test::TestField;
using test::valley;

/// A level lake of 300 m over rows 20..40, columns 10..30 of a southward valley; all ground about it is higher but its
/// outflow in the south.
double lake_world(std::int64_t r, std::int64_t c) {
  const bool lake = r >= 20 && r <= 40 && c >= 10 && c <= 30;
  if (lake) return 300;
  const double side = 10 * static_cast<double>(std::max<std::int64_t>({10 - c, c - 30, 0}));
  if (r > 40) return 300 + 2 * static_cast<double>(r - 40) + side + 3 * static_cast<double>(std::abs(c - 20));
  if (r >= 20) return 300 + side;
  return 300 - 2 * static_cast<double>(20 - r) + 40 * static_cast<double>(std::abs(c - 20)) + (c == 20 ? 0 : 60);
}

TEST(DrainageLakes, StreamsEndAtTheShoreAndGoOnAtTheOutflow) {
  const TestField f = equator_field(60, 41, lake_world);
  const auto d = drain(f.field, options(60));
  ASSERT_TRUE(d);
  ASSERT_EQ(d->counts.lakes, 1);
  EXPECT_EQ(d->counts.lake_posts, 21 * 21);
  std::set<std::pair<std::int64_t, std::int64_t>> shore;
  std::size_t n_steps = 0;
  for (const BreakChain& chain : d->shores) {
    for (const BreakVertex& v : chain.vertices) {
      EXPECT_EQ(v.height_m, 300);
      shore.insert(post_of(f.field, v));
    }
    n_steps += chain.vertices.size() - 1;
    EXPECT_GE(chain.weight, kShoreWeight);
  }
  EXPECT_EQ(n_steps, 80u);
  EXPECT_EQ(shore.size(), 80u);
  int inflows = 0, outflows = 0;
  for (std::size_t k = 0; k < d->streams.size(); ++k) {
    const auto first = post_of(f.field, d->streams[k].vertices.front()),
               last = post_of(f.field, d->streams[k].vertices.back());
    if (shore.contains(last)) {
      ++inflows;
      ASSERT_GE(d->downstream[k], 0) << "it passes the lake";
      EXPECT_TRUE(shore.contains(post_of(f.field, d->streams[static_cast<std::size_t>(d->downstream[k])].vertices[0])));
    }
    if (shore.contains(first)) {
      ++outflows;
      EXPECT_GT(d->streams[k].weight, 2 * 441) << "what comes in, and the lake's own";
      EXPECT_LT(last.first, 20);
    }
  }
  EXPECT_GE(inflows, 1);
  EXPECT_EQ(outflows, 1);
  expect_nodes_only(*d);
}

TEST(DrainageLakes, AnIslandHasAShoreOfItsOwn) {
  const TestField f = equator_field(60, 41, [](std::int64_t r, std::int64_t c) {
    return r >= 28 && r <= 31 && c >= 18 && c <= 22 ? 310.0 : lake_world(r, c);
  });
  const auto d = drain(f.field, options(100000));  // no streams: whole rings
  ASSERT_TRUE(d);
  EXPECT_TRUE(d->streams.empty());
  ASSERT_EQ(d->shores.size(), 2u);
  for (const BreakChain& ring : d->shores) EXPECT_EQ(ring.vertices.front(), ring.vertices.back());
  EXPECT_EQ(d->shores[0].vertices.size(), 81u);
  // The island's shore runs over the lake's posts about it: 4 + 2 by 5 + 2 posts.
  EXPECT_EQ(d->shores[1].vertices.size(), 2u * (5 + 6) + 1);
  // The lake lies to the left: the outer ring runs counter-clockwise, the island's clockwise.
  const auto area = [](const BreakChain& ring) {
    double twice = 0;
    for (std::size_t k = 0; k + 1 < ring.vertices.size(); ++k) {
      const BreakVertex &a = ring.vertices[k], &b = ring.vertices[k + 1];
      twice +=
          static_cast<double>(a.x) * static_cast<double>(b.y) - static_cast<double>(b.x) * static_cast<double>(a.y);
    }
    return twice;
  };
  EXPECT_GT(area(d->shores[0]), 0);
  EXPECT_LT(area(d->shores[1]), 0);
}

TEST(DrainageLakes, SmallOnesAndPlainsAreNone) {
  DrainageOptions o = options(60);
  o.lake_area_m2 = 19 * 19 * 0.31e6;  // the core has 19 x 19 posts of 0.093 km2
  const TestField f = equator_field(60, 41, lake_world);
  EXPECT_EQ(drain(f.field, o)->counts.lakes, 0);
  // A plain in whole metres that falls off in the south: bands 20 posts wide, half of each rim lower.
  const TestField plain = equator_field(100, 41, [](std::int64_t r, std::int64_t) {
    return r < 10 ? static_cast<double>(5 * r - 50) : std::floor(static_cast<double>(r) / 20);
  });
  EXPECT_EQ(drain(plain.field, options(60))->counts.lakes, 0);
}

TEST(DrainageLakes, AreDrawnFromTheLevelThatTheirAreaFits) {
  const TestField f = equator_field(60, 41, lake_world);
  DrainageOptions o = options(60, 6);
  const double core_m2 = 19 * 19 * 0.3057e3 * 0.3037e3;
  for (const auto& [part, level] : {std::pair{0.9, 6}, {0.3, 6}, {0.24, 5}, {0.2 / 4, 5}}) {
    o.lake_area_m2 = core_m2 * part;
    const auto d = drain(f.field, o);
    ASSERT_TRUE(d);
    ASSERT_FALSE(d->shores.empty());
    // The last is held by the least number of posts: 64 cells, and 361 < 4 * 4 * 64.
    EXPECT_EQ(d->shores[0].first_level, level) << part;
  }
}

TEST(DrainageSea, NeedsALevelOrAnOcean) {
  // A low coast: everything below row 20 at -3 m or below.
  const TestField f = equator_field(60, 21, [](std::int64_t r, std::int64_t c) {
    return r < 20 ? -3 - 0.01 * static_cast<double>(20 - r) : valley(r, c, 10);
  });
  EXPECT_EQ(drain(f.field, options(20))->counts.sea_posts, 0) << "far below 100,000 km2";
  DrainageOptions o = options(20);
  o.sea_level_m = 0;
  const auto d = drain(f.field, o);
  ASSERT_TRUE(d);
  EXPECT_EQ(d->counts.sea_posts, 20 * 21);
  std::int64_t southernmost = 100;
  for (const BreakChain& chain : d->streams) {
    for (const BreakVertex& v : chain.vertices) southernmost = std::min(southernmost, post_of(f.field, v).first);
  }
  EXPECT_EQ(southernmost, 19) << "streams end with the first post of the sea";
}

TEST(DrainageSea, AnOceanIsFoundByItsArea) {
  test::GridPlace place;
  place.lattice_level = 2;
  place.n_rows = 40;
  place.n_cols = 40;
  place.x0 = 1000;
  place.y0 = 100000;
  place.dx = place.dy = 200;  // some 15 km
  const TestField f(place, [](std::int64_t r, std::int64_t c) { return r < 25 ? -100.0 : valley(r, c, 20); });
  EXPECT_EQ(drain(f.field, options(20))->counts.sea_posts, 25 * 40);
  const TestField hole(place, [](std::int64_t r, std::int64_t c) {
    return r >= 10 && r < 15 && c >= 10 && c < 15 ? -100.0 : valley(r, c, 20);
  });
  EXPECT_EQ(drain(hole.field, options(20))->counts.sea_posts, 0);
}

TEST(DrainageSea, FlatSeaHasItsShore) {
  const TestField f =
      equator_field(60, 41, [](std::int64_t r, std::int64_t c) { return r < 25 ? 0.0 : valley(r, c, 20); });
  for (const bool given : {false, true}) {
    DrainageOptions o = options(40);
    if (given) o.sea_level_m = 0;
    const auto d = drain(f.field, o);
    ASSERT_TRUE(d);
    EXPECT_EQ(d->counts.sea_posts, given ? 25 * 41 : 0);
    ASSERT_EQ(d->counts.lakes, 1);
    bool coast = false;
    for (const BreakChain& chain : d->shores) {
      for (const BreakVertex& v : chain.vertices)
        coast = coast || post_of(f.field, v) == std::pair(std::int64_t{24}, std::int64_t{20});
    }
    EXPECT_TRUE(coast);
    expect_nodes_only(*d);
  }
}

TEST(DrainageLakes, NeedSixtyFourPostsWhateverTheirArea) {
  DrainageOptions o = options(1000000);
  o.lake_area_m2 = 0;
  for (const auto& [side, lakes] : {std::pair<std::int64_t, std::int64_t>{9, 0}, {10, 1}}) {
    const TestField f = equator_field(40, 40, [&, n = side](std::int64_t r, std::int64_t c) {
      return r >= 10 && r < 10 + n && c >= 10 && c < 10 + n ? 50.0 : 100.0 + 0.37 * static_cast<double>(r + 3 * c);
    });
    EXPECT_EQ(drain(f.field, o)->counts.lakes, lakes) << side;
  }
}

TEST(DrainageLakes, IslandsThatTouchInACornerMeetInANode) {
  const TestField f = equator_field(60, 41, [](std::int64_t r, std::int64_t c) {
    return (r == 30 && c == 20) || (r == 32 && c == 18) ? 310.0 : lake_world(r, c);
  });
  const auto d = drain(f.field, options(100000));
  ASSERT_TRUE(d);
  ASSERT_EQ(d->shores.size(), 3u);
  int n = 0;
  for (const BreakChain& ring : d->shores) {
    if (ring.vertices.size() != 9) continue;
    ++n;
    EXPECT_EQ(ring.vertices.front(), ring.vertices.back());
    EXPECT_EQ(post_of(f.field, ring.vertices.front()), std::pair(std::int64_t{31}, std::int64_t{19}));
  }
  EXPECT_EQ(n, 2);
  expect_nodes_only(*d);
}

TEST(DrainageLakes, OneAcrossTheSeamIsOne) {
  test::GridPlace place;
  place.lattice_level = 0;
  place.n_rows = 31;
  place.n_cols = 64;
  place.dx = 131072.0 / 64;
  place.y0 = 20000;
  place.dy = 1500;
  TestField f(place, [](std::int64_t r, std::int64_t c) {
    const std::int64_t from_seam = std::min(c, 63 - c);
    return r >= 10 && r < 20 && from_seam < 8 ? 40.0
                                              : 100 + static_cast<double>(r) + 7 * static_cast<double>(from_seam);
  });
  f.field.wraps = true;
  const auto d = drain(f.field, options(1000000));
  ASSERT_TRUE(d);
  EXPECT_EQ(d->counts.lakes, 1);
  EXPECT_EQ(d->counts.lake_posts, 160);
  ASSERT_EQ(d->shores.size(), 1u);
  const auto& ring = d->shores[0].vertices;
  EXPECT_EQ(ring.size(), 2u * (15 + 9) + 1);
  EXPECT_EQ(ring.front(), ring.back());
  for (std::size_t k = 1; k < ring.size(); ++k) EXPECT_LE(std::abs(ring[k].x - ring[k - 1].x), 2048);
}

}  // namespace
}  // namespace tind
