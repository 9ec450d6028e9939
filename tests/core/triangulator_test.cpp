// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/triangulator.hpp"

#include <algorithm>
#include <cmath>
#include <functional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/test_field.hpp"
#include "tests/support/test_tile.hpp"

namespace tind::test {
namespace {

constexpr TileKey kTile{5, 20, 13};
constexpr int kLatticeLevel = 7;
constexpr double kSpacing = 2600.7;  // 100 posts a side
constexpr int kFiner = 3;            // border lines of so many levels

TestField field_over(const HeightAt& height, double spacing = kSpacing, int overlap = 3) {
  return TestField(place_over(kTile.level, kTile.x, kTile.y, kLatticeLevel, spacing, overlap), height);
}

std::string triangulate_and_check(const TestField& f, double tolerance_m, TestTile* out = nullptr) {
  const RefinementSpec spec = spec_from(kTile.level, tolerance_m, kFiner, f.field.lattice);
  TestTile tile = build_tile(f.field, spec, kTile);
  const Mesh mesh = mesh_of(tile);
  const Int128 side = f.field.lattice.tile_side(kTile.level);
  std::string wrong;
  if (doubled_area(mesh) != 2 * side * side) wrong += "areas do not sum to the tile's; ";
  const PostCheck posts = check_posts(f.field, kTile, mesh);
  if (posts.n_missed != 0) wrong += std::to_string(posts.n_missed) + " posts in no triangle; ";
  if (posts.worst_m > tolerance_m) wrong += "error " + std::to_string(posts.worst_m) + " m; ";
  if (posts.worst_base_m > tolerance_m) wrong += "error over the base " + std::to_string(posts.worst_base_m) + " m; ";
  // The guard: whatever finer borders lie beside it, tile by tile and side by side.
  for (const std::array<int, 4> gaps : {std::array{1, 1, 1, 1}, std::array{2, 2, 2, 2}, std::array{0, 1, 2, 1},
                                        std::array{2, 0, 1, 0}, std::array{1, 2, 0, 2}}) {
    std::array<int, 4> levels = gaps;
    for (int& level : levels) level += kTile.level;
    const Mesh finer = tessellate(tile, levels);
    if (doubled_area(finer) != 2 * side * side) wrong += "tessellated areas do not sum to the tile's; ";
    const PostCheck guarded = check_posts(f.field, kTile, finer);
    if (guarded.n_missed != 0) wrong += "posts in no tessellated triangle; ";
    if (std::max(guarded.worst_m, guarded.worst_base_m) > tolerance_m) {
      wrong += "error " + std::to_string(std::max(guarded.worst_m, guarded.worst_base_m)) + " m when tessellated; ";
    }
  }
  if (out != nullptr) *out = std::move(tile);
  return wrong;
}

TEST(Triangulator, KeepsThePromiseOnRoughTerrainAlsoWhenTessellated) {
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    const TestField f = field_over(rough_terrain(seed, 1000));
    EXPECT_EQ(triangulate_and_check(f, seed % 2 ? 40 : 120), "") << "seed " << seed;
  }
}

TEST(Triangulator, KeepsThePromiseAtCliffs) {
  for (const auto& [name, height] : std::vector<std::pair<std::string, HeightAt>>{
           {"one step", [](auto, auto c) { return c < 50 ? 0.0 : 3000.0; }},
           {"diagonal", [](auto r, auto c) { return r + c < 100 ? -400.0 : 800.0; }},
           {"spikes", [](auto r, auto c) { return noise(3, r, c) < 0.01 ? 2000.0 : 0.0; }},
           {"chess board", [](auto r, auto c) { return (r + c) % 2 ? 100.0 : 0.0; }}}) {
    EXPECT_EQ(triangulate_and_check(field_over(height), 30), "") << name;
  }
}

TEST(Triangulator, KeepsThePromiseAtPostsBesideABorder) {
  // A bottom tile, where posts are closest in lattice steps. The first row and column inside lie this far from the
  // border.
  for (const double steps : {0.0, 0.3, 0.49, 0.51, 1.0}) {
    GridPlace place = place_over(kTile.level, kTile.x, kTile.y, kTile.level, 310.7, 3);
    const double side = std::ldexp(1.0, 16);
    place.x0 = kTile.x * side - 3 * place.dx + steps;
    place.y0 = kTile.y * side - 3 * place.dy + steps;
    const TestField f(place, rough_terrain(7, 4000));
    EXPECT_EQ(triangulate_and_check(f, 100), "") << steps << " steps from the border";
  }
}

TEST(Triangulator, GivesAFlatTileTwoTriangles) {
  TestTile tile;
  EXPECT_EQ(triangulate_and_check(field_over([](auto, auto) { return 12.25; }), 5, &tile), "");
  EXPECT_EQ(tile.surface.triangles, (std::vector<Triangle>{{0, 1, 3}, {1, 2, 3}}));
  EXPECT_TRUE(tile.surface.interior.empty());
  EXPECT_EQ(tile.surface.stats.max_error_m, 0);
}

TEST(Triangulator, WorksInTilesSmallerThanTheSpacing) {
  const double side = std::ldexp(1.0, 16 + kLatticeLevel - kTile.level);
  for (const double spacing : {side * 0.9, side * 1.7, side * 3.1}) {
    const TestField f = field_over(rough_terrain(11, 5000), spacing, 4);
    EXPECT_EQ(triangulate_and_check(f, 10), "") << spacing / side << " sides";
  }
}

TEST(Triangulator, ChecksTheBaseOutsideTheGridOnItsOwnGrid) {
  // The data end inside the tile, in the middle and near a corner, with a cliff.
  for (const std::int64_t n : {std::int64_t{9}, std::int64_t{57}}) {
    GridPlace place = place_over(kTile.level, kTile.x, kTile.y, kLatticeLevel, kSpacing, 3);
    place.n_rows = place.n_cols = n;
    place.base_height_m = -90;
    const TestField f(place, rough_terrain(5, 700));
    EXPECT_EQ(triangulate_and_check(f, 35), "") << n << " posts a side";
  }
}

TEST(Triangulator, WorksAcrossLongitude180) {
  const int level = 4;
  for (const std::uint32_t x : {TileKey::count_x(level) - 1, 0u}) {
    const TileKey key{level, x, 5};
    GridPlace place = place_over(level, TileKey::count_x(level), 5, 6, 2900.3, 60);
    const TestField f(place, rough_terrain(2, 900));  // 60 posts on the western side of 180
    const RefinementSpec spec = spec_from(level, 30, 2, f.field.lattice);
    const TestTile tile = build_tile(f.field, spec, key);
    const PostCheck posts = check_posts(f.field, key, mesh_of(tile));
    EXPECT_GT(posts.n_posts, 50 * 90);
    EXPECT_EQ(posts.n_missed, 0);
    EXPECT_LE(std::max(posts.worst_m, posts.worst_base_m), 30);
    EXPECT_EQ(tile.surface.stats.n_posts, static_cast<std::uint64_t>(posts.n_own_source));
  }
}

TEST(Triangulator, MeasuresWhatBruteForceMeasures) {
  TestField f = field_over(rough_terrain(9, 800));
  for (std::size_t i = 0; i < f.origins.size(); i += 7) f.origins[i] = PostOrigin::kFilled;  // not to be measured
  const RefinementSpec spec = spec_from(kTile.level, 50, 1, f.field.lattice);
  const TestTile tile = build_tile(f.field, spec, kTile);
  const Mesh mesh = mesh_of(tile);
  const PostCheck posts = check_posts(f.field, kTile, mesh);
  const TileStats& stats = tile.surface.stats;
  EXPECT_EQ(stats.n_posts, static_cast<std::uint64_t>(posts.n_own_source));
  EXPECT_GE(stats.max_error_m, posts.own_worst_m * (1 - 1e-12));
  EXPECT_NEAR(stats.max_error_m, posts.own_worst_m, 1e-4);
  EXPECT_NEAR(stats.rmse_m, posts.own_rmse_m, 1e-4);
  const auto [low, high] = std::minmax_element(mesh.vertices.begin(), mesh.vertices.end(),
                                               [](const auto& a, const auto& b) { return a.z < b.z; });
  EXPECT_EQ(stats.min_z, low->z);
  EXPECT_EQ(stats.max_z, high->z);
}

TEST(Triangulator, KeepsBorderAndInitialVerticesAndLocalOrder) {
  const TestField f = field_over(rough_terrain(4, 700));
  const RefinementSpec spec = spec_from(kTile.level, 60, 2, f.field.lattice);
  TestTile tile = make_task(f.field, spec, kTile);
  const std::int64_t west = kTile.x * f.field.lattice.tile_side(5), south = kTile.y * f.field.lattice.tile_side(5);
  for (const auto& [x, y] : {std::pair{1000, 2000}, {1000, 2000}, {131072, 131072}, {1, 1}}) {
    tile.task.initial.push_back({x, y, f.field.lattice_height(west + x, south + y)});
  }
  tile.surface = triangulate(f.field, tile.task);
  const auto& interior = tile.surface.interior;
  EXPECT_EQ(interior.size(), 3 + tile.surface.n_inserted);
  for (const LocalVertex& v : tile.task.initial) EXPECT_THAT(interior, testing::Contains(v));
  for (std::size_t k = 1; k < interior.size(); ++k) {
    const auto code = [](const LocalVertex& v) {
      return morton_code(static_cast<std::uint32_t>(v.x), static_cast<std::uint32_t>(v.y));
    };
    EXPECT_LT(code(interior[k - 1]), code(interior[k]));
  }
  for (const LocalVertex& v : interior) EXPECT_EQ(v.z, f.field.lattice_height(west + v.x, south + v.y));
  // Every edge between ring neighbours is in exactly one triangle, and no border edge else.
  const auto& triangles = tile.surface.triangles;
  EXPECT_TRUE(std::is_sorted(triangles.begin(), triangles.end()));
  const Mesh mesh = mesh_of(tile);
  const std::int64_t side = f.field.lattice.tile_side(kTile.level);
  const auto n_ring = static_cast<std::uint32_t>(mesh.vertices.size() - interior.size());
  std::vector<int> seen(n_ring, 0);
  for (const Triangle& t : triangles) {
    EXPECT_LT(t[0], std::min(t[1], t[2]));
    for (std::size_t e = 0; e < 3; ++e) {
      const std::uint32_t a = t[e], b = t[(e + 1) % 3];
      const LocalVertex &p = mesh.vertices[a], &q = mesh.vertices[b];
      const bool on_side = (p.x == q.x && (p.x == 0 || p.x == side)) || (p.y == q.y && (p.y == 0 || p.y == side));
      if (!on_side) continue;
      ASSERT_LT(a, n_ring);
      EXPECT_EQ(b, (a + 1) % n_ring);
      ++seen[a];
    }
  }
  EXPECT_THAT(seen, testing::Each(1));
}

TEST(Triangulator, WithoutEnvelopesBreaksThePromiseWhenTessellated) {
  // So that the guard's test can fail: the same terrain, the envelopes flattened to B_L itself.
  double worst = 0;
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    const TestField f = field_over(rough_terrain(seed, 1000));
    const RefinementSpec spec = spec_from(kTile.level, 40, kFiner, f.field.lattice);
    TestTile tile = make_task(f.field, spec, kTile);
    for (auto& envelope : tile.task.envelopes) {
      for (EnvelopeKnot& knot : envelope) knot.high_m = knot.low_m = knot.own_m;
    }
    tile.surface = triangulate(f.field, tile.task);
    EXPECT_LE(check_posts(f.field, kTile, mesh_of(tile)).worst_m, 40);
    worst = std::max(worst, check_posts(f.field, kTile, tessellate(tile, {6, 6, 6, 6})).worst_m);
  }
  EXPECT_GT(worst, 41);
}

}  // namespace
}  // namespace tind::test
