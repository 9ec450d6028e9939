// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/line_pyramid.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <map>
#include <numbers>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/memory_watch.hpp"
#include "tests/support/test_field.hpp"

namespace tind::test {
namespace {

constexpr int kBottom = 8;
constexpr int kLatticeLevel = 9;

Lattice test_lattice() {
  Lattice lattice;
  lattice.level = kLatticeLevel;
  lattice.height_exponent = 3;
  return lattice;
}

// Detail that doubles per coarser level.
std::vector<LineDetail> details(double plan_m = 150, double height_m = 20) {
  std::vector<LineDetail> detail;
  for (int level = 0; level <= kBottom; ++level) {
    detail.push_back({std::ldexp(plan_m, kBottom - level), std::ldexp(height_m, kBottom - level)});
  }
  return detail;
}

// A wandering line of n steps from (x, y), `step` lattice steps each, that falls.
BreakChain wander(std::uint64_t seed, std::int64_t x, std::int64_t y, int n, double step, double heading) {
  BreakChain chain;
  double fx = static_cast<double>(x), fy = static_cast<double>(y), z = 2000;
  for (int k = 0; k <= n; ++k) {
    chain.vertices.push_back({std::llround(fx), std::llround(fy), z});
    const double turn = heading + 0.9 * std::sin(k / 23.0) + 1.2 * (noise(seed, k, 1) - 0.5);  // never back
    fx += step * std::cos(turn);
    fy += step * std::sin(turn);
    z -= 10 * noise(seed, k, 2);
  }
  return chain;
}

std::vector<std::vector<LatticePoint>> polylines(const LinePyramid& lines, int level) {
  std::vector<std::vector<LatticePoint>> all;
  for (DrawnLine& line : lines.drawn(level)) all.push_back(std::move(line.vertices));
  return all;
}

using Point = std::pair<std::int64_t, std::int64_t>;

std::set<Point> vertices_of(const LinePyramid& lines, int level) {
  std::set<Point> set;
  for (const auto& line : polylines(lines, level)) {
    for (const LatticePoint& p : line) set.insert({p.x, p.y});
  }
  return set;
}

// Distance in metres and height difference of a point from a segment.
std::pair<double, double> off(const Lattice& lattice, const LatticePoint& a, const LatticePoint& b,
                              const BreakVertex& v) {
  const double metres = lattice.step_deg() * std::numbers::pi / 180 * lattice.ellipsoid.semi_major_m;
  const double shrink = std::cos(lattice.latitude_deg(v.y) * std::numbers::pi / 180);
  const double bx = static_cast<double>(b.x - a.x) * metres * shrink, by = static_cast<double>(b.y - a.y) * metres;
  const double x = static_cast<double>(v.x - a.x) * metres * shrink, y = static_cast<double>(v.y - a.y) * metres;
  const double length2 = bx * bx + by * by, w = length2 > 0 ? std::clamp((x * bx + y * by) / length2, 0.0, 1.0) : 0;
  return {std::hypot(x - w * bx, y - w * by),
          std::abs(lattice.height_m(a.z) + w * (lattice.height_m(b.z) - lattice.height_m(a.z)) - v.height_m)};
}

TEST(LinePyramid, KeepsTheDetailOfEachLevelAndNestsItsVertices) {
  const Lattice lattice = test_lattice();
  const BreakChain chain = wander(3, 40'000'123, 18'000'456, 3000, 900, 0.3);
  const LinePyramid lines(lattice, std::vector{chain}, details());
  std::set<Point> coarser;
  std::size_t before = 0;
  for (int level = 0; level <= kBottom; ++level) {
    const auto all = polylines(lines, level);
    ASSERT_EQ(all.size(), 1u) << level;
    const auto& line = all[0];
    EXPECT_GT(line.size(), before) << level;
    before = line.size();
    const std::set<Point> own = vertices_of(lines, level);
    EXPECT_TRUE(std::includes(own.begin(), own.end(), coarser.begin(), coarser.end())) << level;
    coarser = own;
    const LineDetail detail = details()[static_cast<std::size_t>(level)];
    for (const BreakVertex& v : chain.vertices) {
      // The vertex's own segment is one of the nearest: the line wanders.
      double plan = 1e300, height = 1e300;
      for (std::size_t k = 0; k + 1 < line.size(); ++k) {
        const auto [p, h] = off(lattice, line[k], line[k + 1], v);
        if (p <= detail.plan_m * 1.01) {
          plan = std::min(plan, p);
          height = std::min(height, h);
        }
      }
      EXPECT_LE(plan, detail.plan_m * 1.01) << level;
      EXPECT_LE(height, detail.height_m * 1.01 + 1) << level;
    }
  }
  EXPECT_GT(before, 300u);
  EXPECT_LT(before, 2500u);
}

TEST(LinePyramid, KeepsStreamsInTheirValleys) {
  const Lattice lattice = test_lattice();
  BreakChain chain = wander(3, 40'000'123, 18'000'456, 3000, 900, 0.3);
  std::vector<LineDetail> detail = details();
  for (LineDetail& d : detail) d.valley_m = 300;
  const LinePyramid shore(lattice, std::vector{chain}, detail);
  chain.in_valley = true;
  const LinePyramid stream(lattice, std::vector{chain}, detail);
  const auto size = [](const LinePyramid& lines, int level) {
    return static_cast<double>(lines.drawn(level)[0].vertices.size());
  };
  EXPECT_NEAR(size(shore, kBottom), size(stream, kBottom), 0.02 * size(shore, kBottom));
  EXPECT_GT(size(stream, 2), 5 * size(shore, 2));
  const std::vector<LatticePoint> line = stream.drawn(2)[0].vertices;
  for (const BreakVertex& v : chain.vertices) {
    double plan = 1e300;
    for (std::size_t k = 0; k + 1 < line.size(); ++k)
      plan = std::min(plan, off(lattice, line[k], line[k + 1], v).first);
    EXPECT_LE(plan, 303);
  }
}

TEST(LinePyramid, CutsLinesAtTheBorderLinesOfEachLevel) {
  const Lattice lattice = test_lattice();
  const LinePyramid lines(lattice, std::vector{wander(5, 50'000'000, 20'000'000, 2500, 1500, 1.0)}, details());
  std::set<Point> on_borders;
  for (const bool vertical : {true, false}) {
    const std::int64_t side = lattice.tile_side(kBottom);
    for (std::int64_t at = 0; at < lattice.width(); at += side) {
      for (const LineCrossing& c : lines.crossings(vertical, at, -1, lattice.width() + 1)) {
        EXPECT_EQ(c.vertical, vertical);
        EXPECT_EQ(c.at, at);
        on_borders.insert(vertical ? Point{at, c.t} : Point{c.t, at});
      }
    }
  }
  EXPECT_GT(on_borders.size(), 20u);
  for (int level = 0; level <= kBottom; ++level) {
    const std::int64_t side = lattice.tile_side(level);
    std::uint64_t n = 0;
    for (std::uint32_t x = 0; x < TileKey::count_x(level); ++x) {
      for (std::uint32_t y = 0; y < TileKey::count_y(level); ++y) {
        for (const LineSegment& s : lines.segments({static_cast<std::uint8_t>(level), x, y})) {
          ++n;
          for (const LatticePoint& p : {s.a, s.b}) {
            EXPECT_TRUE(p.x >= x * side && p.x <= (x + 1) * side && p.y >= y * side && p.y <= (y + 1) * side);
            if (p.x % side != 0 && p.y % side != 0) continue;
            // The border lines know the vertex, from this level on or a coarser one.
            for (const bool vertical : {true, false}) {
              const std::int64_t at = vertical ? p.x : p.y, t = vertical ? p.y : p.x;
              if (at % side != 0) continue;
              const auto found = lines.crossings(vertical, at % lattice.width(), t - 1, t + 1);
              ASSERT_EQ(found.size(), 1u);
              EXPECT_LE(found[0].entry, level);
              EXPECT_EQ(found[0].t, t);
            }
          }
        }
      }
    }
    EXPECT_EQ(n, lines.n_segments(level)) << level;
    EXPECT_GT(n, 0u);
  }
}

TEST(LinePyramid, GivesCrossingsTheHeightBetweenTheirNeighbours) {
  const Lattice lattice = test_lattice();
  const std::int64_t side = lattice.tile_side(kBottom), x = 300 * side, y = 200 * side + side / 2;
  const BreakChain chain{{{x - 600, y, 100}, {x + 200, y + 400, 60}}, 2, 0};
  const LinePyramid lines(lattice, std::vector{chain}, details());
  const auto found = lines.crossings(true, x, y, y + 1000);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].t, y + 300);
  const auto at =
      std::find_if(lines.vertices().begin(), lines.vertices().end(), [&](const LatticePoint& p) { return p.x == x; });
  ASSERT_NE(at, lines.vertices().end());
  EXPECT_EQ(at->z, lattice.height_from_m(70));
  EXPECT_TRUE(polylines(lines, 1).empty());
  EXPECT_EQ(polylines(lines, 2).size(), 1u);
}

TEST(LinePyramid, DrawsATributaryFromItsLevelOnAndJoinsTheStemAbove) {
  const Lattice lattice = test_lattice();
  const std::int64_t x = 40'001'000, y = 30'001'000;
  // The stem is straight; its node is a vertex only where the tributary is drawn.
  const std::vector<BreakChain> chains = {{{{x, y, 300}, {x + 1000, y, 200}}, 3, 8},
                                          {{{x + 1000, y, 200}, {x + 2000, y, 100}}, 3, 9},
                                          {{{x + 700, y + 900, 400}, {x + 1000, y, 200}}, 6, 1}};
  const LinePyramid lines(lattice, chains, details());
  EXPECT_TRUE(polylines(lines, 2).empty());
  ASSERT_EQ(polylines(lines, 5).size(), 1u);
  EXPECT_EQ(polylines(lines, 5)[0].size(), 2u);
  EXPECT_EQ(lines.drawn(5)[0].chain, 1u);  // the heavier
  EXPECT_EQ(polylines(lines, 6).size(), 3u);
}

TEST(LinePyramid, KeepsStreamsThatEndInOnePostApart) {
  const Lattice lattice = test_lattice();
  const std::int64_t x = 40'001'000, y = 30'001'000;
  const std::vector<BreakChain> chains = {{{{x, y, 300}, {x + 1000, y, 200}}, 0, 8, true},
                                          {{{x + 2000, y, 250}, {x + 1000, y, 200}}, 0, 9, true}};
  const LinePyramid lines(lattice, chains, details());
  ASSERT_EQ(polylines(lines, kBottom).size(), 2u);
  for (const auto& line : polylines(lines, kBottom)) EXPECT_EQ(line.back().x, x + 1000);
}

TEST(LinePyramid, CrossesLongitude180) {
  const Lattice lattice = test_lattice();
  const std::int64_t width = lattice.width(), side = lattice.tile_side(4), y = 5 * side + 1000;
  const BreakChain chain{{{width - 900, y, 10}, {width + 900, y + 600, 4}}, 0, 0};
  const LinePyramid lines(lattice, std::vector{chain}, details());
  const std::uint32_t last = TileKey::count_x(4) - 1;
  const auto west = lines.segments({4, last, 5}), east = lines.segments({4, 0, 5});
  ASSERT_EQ(west.size(), 1u);
  ASSERT_EQ(east.size(), 1u);
  EXPECT_EQ(west[0].b.x, width);
  EXPECT_EQ(west[0].b.y, y + 300);
  EXPECT_EQ(west[0].b.z, lattice.height_from_m(7));
  EXPECT_EQ(east[0].a.x, 0);
  EXPECT_EQ(east[0].b.x, 900);
  EXPECT_EQ(lines.crossings(true, 0, y, y + 1000).size(), 1u);
}

TEST(LinePyramid, KeepsThreeCornersOfARingAndDrawsNothingOnAPole) {
  const Lattice lattice = test_lattice();
  BreakChain ring;
  for (int k = 0; k <= 40; ++k) {
    const double a = 2 * std::numbers::pi * (k % 40) / 40;
    ring.vertices.push_back(
        {30'000'000 + std::llround(3000 * std::cos(a)), 30'000'000 + std::llround(3000 * std::sin(a)), 512});
  }
  const BreakChain to_pole{{{1000, lattice.height() - 500, 5}, {1000, lattice.height(), 5}}, 0, 0};
  const LinePyramid lines(lattice, std::vector{ring, to_pole}, details());
  EXPECT_TRUE(polylines(lines, 0).empty());  // smaller than the detail
  ASSERT_EQ(polylines(lines, kBottom).size(), 1u);
  EXPECT_GT(polylines(lines, kBottom)[0].size(), 8u);
  for (int level = 0; level <= kBottom; ++level) {
    for (const auto& line : polylines(lines, level)) {
      EXPECT_GE(line.size(), 4u);
      EXPECT_EQ(line.front().x, line.back().x);
    }
  }
  for (const LatticePoint& p : lines.vertices()) EXPECT_LT(p.y, lattice.height());
}

// Sign of an area.
int turn(const LatticePoint& a, const LatticePoint& b, const LatticePoint& c) {
  const auto area = static_cast<long double>(b.x - a.x) * static_cast<long double>(c.y - a.y) -
                    static_cast<long double>(b.y - a.y) * static_cast<long double>(c.x - a.x);
  return area > 0 ? 1 : area < 0 ? -1 : 0;
}

TEST(LinePyramid, DrawsNoTwoLinesAcrossEachOther) {
  const Lattice lattice = test_lattice();
  // Streams side by side, closer than the detail, and one line that truly crosses them.
  std::vector<BreakChain> chains;
  for (int k = 0; k < 40; ++k) {
    BreakChain chain;
    for (int i = 0; i < 400; ++i) {
      const double bend = 9000 * std::sin(i / 37.0) + 4000 * std::sin(i / 11.0) + 700 * noise(4, i, 0);
      chain.vertices.push_back({30'000'000 + 700 * i, 30'000'000 + std::llround(bend) + 80 * k, 1000.0 - i});
    }
    chain.weight = k;
    chains.push_back(chain);
  }
  chains.push_back({{{30'100'000, 29'900'001, 1500}, {30'103'000, 30'100'000, 1400}}, 0, 1000});
  const LinePyramid lines(lattice, chains, details(2000, 500));
  for (int level = 0; level <= kBottom; ++level) {
    std::vector<LineSegment> all;
    for (const auto& line : polylines(lines, level)) {
      for (std::size_t k = 0; k + 1 < line.size(); ++k) all.push_back({line[k], line[k + 1]});
    }
    std::size_t n_crossing = 0;
    for (std::size_t i = 0; i < all.size(); ++i) {
      for (std::size_t j = i + 1; j < all.size(); ++j) {
        const auto& [a, b] = all[i];
        const auto& [c, d] = all[j];
        n_crossing += turn(a, b, c) * turn(a, b, d) < 0 && turn(c, d, a) * turn(c, d, b) < 0;
      }
    }
    EXPECT_EQ(n_crossing, 0u) << level;
    EXPECT_GT(lines.n_dropped(level), 0u) << level;  // the line across is heavier than what it crosses
    EXPECT_LE(lines.n_dropped(level), 40u) << level;
    EXPECT_TRUE(vertices_of(lines, level).contains({30'100'000, 29'900'001}));
  }
}

TEST(LinePyramid, StaysWithinATileWhereItTurnsFromOneBorderLineIntoAnother) {
  // Along a parallel over six tiles, then a little way up a meridian: less than the detail, so the corner alone holds
  // it. No coarser level has pinned anything.
  const Lattice lattice = test_lattice();
  const std::int64_t side = lattice.tile_side(4), x = 21 * side, y = 9 * side;
  const BreakChain chain{{{x - 6 * side, y, 100}, {x, y, 100}, {x, y + 40, 100}, {x + 30, y + 60, 100}}, 5, 0};
  const LinePyramid lines(lattice, std::vector{chain}, details());
  for (int level = 0; level <= kBottom; ++level) {
    const std::int64_t tile = lattice.tile_side(level);
    for (const auto& line : polylines(lines, level)) {
      for (std::size_t k = 0; k + 1 < line.size(); ++k) {
        const auto [west, east] = std::minmax({line[k].x, line[k + 1].x});
        const auto [south, north] = std::minmax({line[k].y, line[k + 1].y});
        const bool on_border = (west == east && west % tile == 0) || (south == north && south % tile == 0);
        const bool in_tile = east <= (west / tile + 1) * tile && north <= (south / tile + 1) * tile;
        EXPECT_TRUE(on_border || in_tile) << level << ": " << west << ' ' << south << " to " << east << ' ' << north;
      }
    }
  }
}

TEST(LinePyramid, FindsCrossingsOfLongLinesInLittleMemory) {
  const Lattice lattice = test_lattice();
  const std::vector<LineDetail> fine(kBottom + 1, {1, 1});
  std::vector<BreakChain> chains;
  for (int k = 0; k < 60; ++k) {
    BreakChain chain;
    for (int end = 0; end < 2; ++end) {
      chain.vertices.push_back({40'000'000 + static_cast<std::int64_t>(20'000 * noise(8, k, end)),
                                20'000'000 + static_cast<std::int64_t>(20'000 * noise(9, k, end)), 100});
    }
    chain.weight = k;
    chains.push_back(chain);
  }
  reset_largest_request();
  const LinePyramid lines(lattice, chains, fine);
  EXPECT_LT(largest_request(), 32u << 20);  // 60 lines through 2500 x 2500 cells
  EXPECT_GT(lines.n_dropped(kBottom), 20u);
  std::vector<LineSegment> all;
  for (const auto& line : polylines(lines, kBottom)) {
    for (std::size_t k = 0; k + 1 < line.size(); ++k) all.push_back({line[k], line[k + 1]});
  }
  EXPECT_GT(all.size(), 5u);
  for (std::size_t i = 0; i < all.size(); ++i) {
    for (std::size_t j = i + 1; j < all.size(); ++j) {
      const auto& [a, b] = all[i];
      const auto& [c, d] = all[j];
      EXPECT_FALSE(turn(a, b, c) * turn(a, b, d) < 0 && turn(c, d, a) * turn(c, d, b) < 0) << i << ' ' << j;
    }
  }
}

TEST(LinePyramid, HoldsLittleOnTheHeapBesideItsScratch) {
  std::vector<BreakVertex> vertices;
  std::vector<std::pair<std::size_t, std::size_t>> stretches;
  for (int k = 0; k < 1000; ++k) {
    const BreakChain chain = wander(static_cast<std::uint64_t>(k), 30'000'000 + 200'000 * (k % 50),
                                    14'000'000 + 100'000 * (k / 50), 150, 1100, 0.7 * k);
    stretches.emplace_back(vertices.size(), chain.vertices.size());
    vertices.insert(vertices.end(), chain.vertices.begin(), chain.vertices.end());
  }
  std::vector<BreakChain> chains;
  for (const auto& [first, n] : stretches) {
    chains.push_back({{}, 0, 1, true, std::span<const BreakVertex>(vertices).subspan(first, n)});
  }
  const std::vector<LineDetail> fine(kBottom + 1, {100, 10});
  UncountedMemory kept, working;
  reset_most_held_bytes();
  const std::size_t held_before = held_bytes();
  const LinePyramid lines(
      test_lattice(), chains, fine, [&](std::size_t n) { return kept.take(n); },
      [&](std::size_t n) { return working.take(n); });
  const std::size_t n = lines.vertices().size();
  ASSERT_GT(n, vertices.size() * 9 / 10);
  ASSERT_GT(lines.n_segments(kBottom), n / 3);
  // Segments with their bands and tiles, a bit for each vertex, and what is independent of their number.
  EXPECT_LT(most_held_bytes() - held_before, 24 * lines.n_segments(kBottom) + (1u << 20));
  EXPECT_LT(held_bytes() - held_before, 2 * n + (1u << 20));  // the filter of vertices
  EXPECT_LT(working.n_bytes(), 10 * n);
}

TEST(LinePyramid, TakesTimeByTheLengthOfItsSegmentsNotByTheDetail) {
  // Many short lines, no detail to speak of: pairs of all with all would take minutes.
  std::vector<BreakChain> chains;
  for (int k = 0; k < 40'000; ++k) {
    const std::int64_t x = 40'000'000 + 400 * (k % 200), y = 20'000'000 + 400 * (k / 200);
    chains.push_back({{{x, y, 100}, {x + 300, y + 90, 90}}, 0, 0});
  }
  const auto start = std::chrono::steady_clock::now();
  const LinePyramid lines(test_lattice(), chains, details(1e5, 1e5));
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(10));
  EXPECT_GE(lines.n_segments(kBottom), chains.size());
}

TEST(LinePyramid, IsTheSameEveryTime) {
  std::vector<BreakChain> chains;
  for (int k = 0; k < 30; ++k) {
    chains.push_back(
        wander(static_cast<std::uint64_t>(k), 30'000'000 + 20'000 * (k % 6), 14'000'000 + 9000 * k, 300, 800, k));
  }
  const LinePyramid a(test_lattice(), chains, details()), b(test_lattice(), chains, details());
  for (int level = 0; level <= kBottom; ++level) {
    const auto p = polylines(a, level), q = polylines(b, level);
    ASSERT_EQ(p.size(), q.size());
    for (std::size_t k = 0; k < p.size(); ++k) {
      EXPECT_TRUE(std::equal(p[k].begin(), p[k].end(), q[k].begin(), q[k].end(),
                             [](const auto& u, const auto& v) { return u.x == v.x && u.y == v.y && u.z == v.z; }));
    }
  }
}

}  // namespace
}  // namespace tind::test
