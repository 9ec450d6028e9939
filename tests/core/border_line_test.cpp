// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/border_line.hpp"

#include <pthread.h>

#include <algorithm>
#include <cmath>
#include <map>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/test_field.hpp"
#include "tests/support/test_tile.hpp"

namespace tind::test {
namespace {

constexpr int kLevel = 5;
constexpr int kLevels = 4;  // lines of levels 5..8
constexpr int kLatticeLevel = 8;
constexpr TileKey kTile{kLevel, 20, 13};
constexpr double kToleranceM = 60;

bool everywhere(int, std::int64_t) { return true; }

TestField rough_field(std::uint64_t seed = 1) {
  return TestField(place_over(kLevel, kTile.x, kTile.y, kLatticeLevel, 4100.3, 3), rough_terrain(seed, 1200));
}

RootEdge south_side(const HeightField& f) {
  const std::int64_t side = f.lattice.tile_side(kLevel);
  return {false, kLevel, side * kTile.y, side * kTile.x};
}
RootEdge west_side(const HeightField& f) {
  const std::int64_t side = f.lattice.tile_side(kLevel);
  return {true, kLevel, side * kTile.x, side * kTile.y};
}

/// Height of the polyline of the vertices with entry <= level, at t.
double height_of(const std::vector<LineVertex>& line, int level, double t, const Lattice& lattice) {
  const LineVertex* before = nullptr;
  for (const LineVertex& v : line) {
    if (v.entry > level) continue;
    if (static_cast<double>(v.t) >= t && before != nullptr) {
      const double w = (t - static_cast<double>(before->t)) / static_cast<double>(v.t - before->t);
      return (1 - w) * lattice.height_m(before->z) + w * lattice.height_m(v.z);
    }
    before = &v;
  }
  ADD_FAILURE() << "no vertex beyond " << t;
  return 0;
}

/// Largest distance of the level's polyline from the field, at the crossings with post rows or columns.
double worst_at_samples(const HeightField& f, const RootEdge& root, const std::vector<LineVertex>& line, int level) {
  double worst = 0;
  const std::int64_t n = root.vertical ? f.n_rows : f.n_cols;
  int n_samples = 0;
  for (std::int64_t k = 0; k < n; ++k) {
    for (const double turn : {-1.0, 0.0, 1.0}) {
      const double at = static_cast<double>(root.at);
      const double t = root.vertical ? f.post_y(k) : f.post_x(k) + turn * static_cast<double>(f.lattice.width());
      if (t < static_cast<double>(line.front().t) || t > static_cast<double>(line.back().t)) continue;
      if (root.vertical && turn != 0) continue;
      const double x = root.vertical ? at : t, y = root.vertical ? t : at;
      if (!f.covers(x, y)) continue;
      ++n_samples;
      worst = std::max(worst, std::abs(height_of(line, level, t, f.lattice) - f.sample_m(x, y)));
    }
  }
  EXPECT_GT(n_samples, 10);
  return worst;
}

TEST(BorderLine, IsWithinToleranceOfEverySampleAtEveryLevel) {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    const TestField f = rough_field(seed);
    const RefinementSpec spec = spec_from(kLevel, kToleranceM, kLevels, f.field.lattice);
    for (const RootEdge& root : {south_side(f.field), west_side(f.field)}) {
      const auto line = refine_root_edge(f.field, spec, root, {}, {}, everywhere);
      for (int level = kLevel; level < kLevel + kLevels; ++level) {
        EXPECT_LE(worst_at_samples(f.field, root, line, level), std::ldexp(kToleranceM, kLevel - level)) << level;
      }
    }
  }
}

TEST(BorderLine, IsNestedWithOneHeightPerPoint) {
  const TestField f = rough_field();
  const RefinementSpec spec = spec_from(kLevel, kToleranceM, kLevels, f.field.lattice);
  for (const RootEdge& root : {south_side(f.field), west_side(f.field)}) {
    const auto line = refine_root_edge(f.field, spec, root, {}, {}, everywhere);
    // The line of fewer levels is what entered by then: nothing that comes later moves or adds anything before.
    for (int n = 1; n < kLevels; ++n) {
      const auto shorter =
          refine_root_edge(f.field, spec_from(kLevel, kToleranceM, n, f.field.lattice), root, {}, {}, everywhere);
      std::vector<LineVertex> entered;
      std::copy_if(line.begin(), line.end(), std::back_inserter(entered),
                   [&](const LineVertex& v) { return v.entry < kLevel + n; });
      EXPECT_EQ(shorter, entered) << n << " levels";
      EXPECT_GT(line.size(), shorter.size());
    }
    for (std::size_t k = 0; k < line.size(); ++k) {
      if (k > 0) {
        EXPECT_LT(line[k - 1].t, line[k].t);
      }
      EXPECT_GE(line[k].entry, kLevel);
      EXPECT_EQ(line[k].z, root.vertical ? f.field.lattice_height(root.at, line[k].t)
                                         : f.field.lattice_height(line[k].t, root.at));
    }
  }
}

TEST(BorderLine, HasTheCornersOfALevelThatEnteredByThen) {
  const TestField f = rough_field();
  RefinementSpec spec = spec_from(kLevel, kToleranceM, kLevels, f.field.lattice);
  const RootEdge root = south_side(f.field);
  const auto line = refine_root_edge(f.field, spec, root, {}, {}, everywhere);
  for (int level = kLevel; level < kLevel + kLevels; ++level) {
    const std::int64_t side = f.field.lattice.tile_side(level);
    for (std::int64_t t = root.start; t < line.back().t; t += side) {
      const auto part = line_between(line, t, t + side);
      ASSERT_GE(part.size(), 2u);
      EXPECT_EQ(part.front().t, t);
      EXPECT_EQ(part.back().t, t + side);
      const EdgeChain edge = edge_of_level(part, level);
      EXPECT_LE(std::max(edge.start_entry, edge.end_entry), level);
      std::size_t n_entered = 0;
      for (const LineVertex& v : part.subspan(1, part.size() - 2)) n_entered += v.entry <= level;
      EXPECT_EQ(edge.inner.size(), n_entered);
      for (const EdgeVertex& v : edge.inner) {
        EXPECT_TRUE(v.t > 0 && v.t < side && v.entry <= level);
        EXPECT_THAT(line, testing::Contains(LineVertex{v.t + t, v.z, v.entry}));
      }
    }
  }
}

TEST(BorderLine, GoesDeeperOnlyWhereATileBesideItIsSplit) {
  const TestField f = rough_field();
  const RefinementSpec spec = spec_from(kLevel, kToleranceM, kLevels, f.field.lattice);
  const RootEdge root = south_side(f.field);
  const std::int64_t half = f.field.lattice.tile_side(kLevel + 1), middle = root.start + half;
  const auto whole = refine_root_edge(f.field, spec, root, {}, {}, everywhere);
  // Only the western half is split below level 6.
  const auto part = refine_root_edge(f.field, spec, root, {}, {},
                                     [&](int level, std::int64_t start) { return level == kLevel || start < middle; });
  const auto west_whole = line_between(whole, root.start, middle), west_part = line_between(part, root.start, middle);
  EXPECT_TRUE(std::equal(west_whole.begin(), west_whole.end(), west_part.begin(), west_part.end()));
  for (const LineVertex& v : line_between(part, middle, middle + half)) EXPECT_LE(v.entry, kLevel + 1);
}

TEST(BorderLine, TakesSeedsAndPinsInAtTheirLevel) {
  const TestField f = rough_field();
  RefinementSpec spec = spec_from(kLevel, 1e6, 3, f.field.lattice);  // nothing else enters
  spec.seed_segments = std::vector<int>{1, 1, 1, 1, 1, 4, 2, 2};
  const RootEdge root = west_side(f.field);
  const std::int64_t side = f.field.lattice.tile_side(kLevel);
  const std::vector<std::int64_t> pins = {root.start + 17, root.start + side / 2, root.start + side - 1};
  const auto line = refine_root_edge(f.field, spec, root, pins, {}, everywhere);
  std::map<std::int64_t, int> entries;
  for (const LineVertex& v : line) entries[v.t - root.start] = v.entry;
  std::map<std::int64_t, int> expected = {{17, 5}, {side - 1, 5}};
  for (int k = 0; k <= 4; ++k) expected[side / 4 * k] = 5;
  for (int k = 1; k < 8; k += 2) expected[side / 8 * k] = 7;  // level 6 seeds are there already
  EXPECT_EQ(entries, expected);
}

TEST(BorderLine, IsTheSameFromBothSidesOfLongitude180) {
  GridPlace place = place_over(kLevel, TileKey::count_x(kLevel), kTile.y, kLatticeLevel, 4100.3, 70);
  const TestField f(place, rough_terrain(3, 900));
  const RefinementSpec spec = spec_from(kLevel, kToleranceM, kLevels, f.field.lattice);
  const std::int64_t side = f.field.lattice.tile_side(kLevel), width = f.field.lattice.width();
  // The meridian itself, named 0 or the lattice's width.
  const auto line = refine_root_edge(f.field, spec, {true, kLevel, 0, side * kTile.y}, {}, {}, everywhere);
  EXPECT_EQ(line, refine_root_edge(f.field, spec, {true, kLevel, width, side * kTile.y}, {}, {}, everywhere));
  EXPECT_GT(line.size(), 20u);
  // Parallels on both sides see the posts that lie there.
  for (const std::int64_t start : {width - side, std::int64_t{0}}) {
    const RootEdge root{false, kLevel, side * kTile.y, start};
    const auto parallel = refine_root_edge(f.field, spec, root, {}, {}, everywhere);
    for (int level = kLevel; level < kLevel + kLevels; ++level) {
      EXPECT_LE(worst_at_samples(f.field, root, parallel, level), std::ldexp(kToleranceM, kLevel - level));
    }
  }
}

TEST(BorderLine, FollowsTheBaseOutsideTheGridToo) {
  GridPlace place = place_over(kLevel, kTile.x, kTile.y, kLatticeLevel, 4100.3, 3);
  place.n_cols = 61;  // ends inside the tile
  place.base_height_m = -500;
  const TestField f(place, [last = place.n_cols - 1](auto r, auto c) {
    return c == last ? -400 : 500 + 1000 * noise(1, r, c);  // not quite the base where the grid ends
  });
  const RefinementSpec spec = spec_from(kLevel, kToleranceM, kLevels, f.field.lattice);
  const RootEdge root = south_side(f.field);
  const auto line = refine_root_edge(f.field, spec, root, {}, {}, everywhere);
  for (int level = kLevel; level < kLevel + kLevels; ++level) {
    const double tolerance_m = std::ldexp(kToleranceM, kLevel - level);
    EXPECT_LE(worst_at_samples(f.field, root, line, level), tolerance_m);
    const std::int64_t step = f.field.lattice.tile_side(level) / 256;
    for (std::int64_t t = root.start; t <= line.back().t; t += step) {
      if (f.field.covers(static_cast<double>(t), static_cast<double>(root.at))) continue;
      EXPECT_NEAR(height_of(line, level, static_cast<double>(t), f.field.lattice), -500, tolerance_m)
          << level << ' ' << t;
    }
  }
}

TEST(BorderLine, NeedsNoStackThatGrowsWithItsSamples) {
  // A saw whose teeth shrink: the worst sample is always the one beside the last vertex.
  GridPlace place = place_over(kLevel, kTile.x, kTile.y, kLatticeLevel, 131.3, 3);
  place.n_cols = 70;
  const TestField f(
      place, [n = place.n_rows](auto r, auto) { return (r % 2 == 0 ? 0.5 : -0.5) * static_cast<double>(n - r); });
  struct Work {
    const HeightField& field;
    std::size_t n_vertices = 0;
  } work{f.field};
  pthread_attr_t attributes;
  ASSERT_EQ(pthread_attr_init(&attributes), 0);
  ASSERT_EQ(pthread_attr_setstacksize(&attributes, 256 << 10), 0);
  pthread_t thread{};
  const auto run = [](void* at) -> void* {
    Work& to = *static_cast<Work*>(at);
    RootEdge root = west_side(to.field);
    root.at += 4000;
    const RefinementSpec spec = spec_from(kLevel, 1, 1, to.field.lattice);
    to.n_vertices = refine_root_edge(to.field, spec, root, {}, {}, [](int, std::int64_t) { return false; }).size();
    return nullptr;
  };
  ASSERT_EQ(pthread_create(&thread, &attributes, run, &work), 0);
  ASSERT_EQ(pthread_join(thread, nullptr), 0);
  pthread_attr_destroy(&attributes);
  EXPECT_GT(work.n_vertices, 3500u);
}

TEST(Envelope, BoundsThePolylinesOfAllFinerLevelsTightly) {
  const TestField f = rough_field(2);
  const RefinementSpec spec = spec_from(kLevel, kToleranceM, kLevels, f.field.lattice);
  const auto line = refine_root_edge(f.field, spec, south_side(f.field), {}, {}, everywhere);
  for (int level = kLevel; level < kLevel + kLevels; ++level) {
    const auto knots = envelope_of(line, level, f.field.lattice);
    bool touched_high = false, touched_low = false;
    for (std::size_t k = 0; k + 1 < knots.size(); ++k) {
      for (const double w : {0.0, 0.3, 0.8}) {
        const double t = knots[k].t + w * (knots[k + 1].t - knots[k].t);
        const auto at = [&](double EnvelopeKnot::*m) { return (1 - w) * knots[k].*m + w * knots[k + 1].*m; };
        EXPECT_NEAR(at(&EnvelopeKnot::own_m), height_of(line, level, t, f.field.lattice), 1e-9);
        double highest = -1e9, lowest = 1e9;
        for (int g = level; g < kLevel + kLevels; ++g) {
          const double height = height_of(line, g, t, f.field.lattice);
          highest = std::max(highest, height);
          lowest = std::min(lowest, height);
        }
        EXPECT_GE(at(&EnvelopeKnot::high_m), highest - 1e-9);
        EXPECT_LE(at(&EnvelopeKnot::low_m), lowest + 1e-9);
        if (w == 0.0) {  // at a knot the bounds are reached
          EXPECT_NEAR(knots[k].high_m, highest, 1e-9);
          EXPECT_NEAR(knots[k].low_m, lowest, 1e-9);
        }
        touched_high = touched_high || highest > at(&EnvelopeKnot::own_m) + 1;
        touched_low = touched_low || lowest < at(&EnvelopeKnot::own_m) - 1;
      }
    }
    if (level < kLevel + kLevels - 1) {
      EXPECT_TRUE(touched_high && touched_low) << level;
    }
  }
}

}  // namespace
}  // namespace tind::test
