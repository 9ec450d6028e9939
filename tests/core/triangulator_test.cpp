// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/triangulator.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>
#include <set>
#include <span>
#include <utility>

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

// Rounding moves edges, and posts beside them change sides: on steep ground that matters.
TEST(Triangulator, KeepsThePromiseWhenPositionsAreRounded) {
  constexpr int kFineLattice = 16;  // a rounded position is a lattice point but for 1/8192 of what rounding moves
  constexpr double kSteps = 32767;
  for (const std::uint64_t seed :
       {7u, 19u, 23u, 35u}) {  // off by up to 0.8 m more when faces are held to own posts only
    const TestField f(
        place_over(kTile.level, kTile.x, kTile.y, kFineLattice, std::ldexp(kSpacing, kFineLattice - kLatticeLevel), 3),
        rough_terrain(seed, 8000));
    const double tolerance_m = 60, side = static_cast<double>(f.field.lattice.tile_side(kTile.level));
    Mesh mesh = mesh_of(build_tile(f.field, spec_from(kTile.level, tolerance_m, kFiner, f.field.lattice), kTile));
    for (LocalVertex& v : mesh.vertices) {
      for (std::int64_t* at : {&v.x, &v.y}) {
        *at = std::llround(std::round(static_cast<double>(*at) / side * kSteps) / kSteps * side);
      }
    }
    ASSERT_EQ(doubled_area(mesh),
              2 * Int128{f.field.lattice.tile_side(kTile.level)} * f.field.lattice.tile_side(kTile.level))
        << "a triangle turned over: seed " << seed;
    EXPECT_LE(check_posts(f.field, kTile, mesh).worst_m, tolerance_m * (1 + 1e-4)) << "seed " << seed;
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

// Random lines over the tile, their ends on posts or anywhere.
void add_lines(const TestField& f, std::uint64_t seed, int n, TileTask& task) {
  const std::int64_t side = f.field.lattice.tile_side(kTile.level), west = side * kTile.x, south = side * kTile.y;
  const auto end_of_line = [&](int k, int which) {
    const auto at = [&](int axis) {
      const double u = noise(seed, 100 * k + 10 * which + axis, axis);
      if (which == 1 || k % 2) return 1 + static_cast<std::int64_t>(u * static_cast<double>(side - 2));
      // On a post: lines of posts pass close to other posts.
      const double origin =
          axis == 0 ? f.field.x0 - static_cast<double>(west) : f.field.y0 - static_cast<double>(south);
      return static_cast<std::int64_t>(std::llround(origin + kSpacing * std::floor(5 + 95 * u)));
    };
    const std::int64_t x = at(0), y = at(1);
    return LocalVertex{x, y, f.field.lattice_height(west + x, south + y)};
  };
  for (int k = 0; k < n; ++k) task.constraints.push_back({end_of_line(k, 0), end_of_line(k, 1 + k % 4)});
}

// Quantized-mesh's positions of a tile.
double served_step(const TestField& f) { return static_cast<double>(f.field.lattice.tile_side(kTile.level)) / 32767; }

// Lengths of pieces of a segment that are covered by edges of the mesh, as a share of the segment. `width`: how far
// beside it, in lattice steps, vertices count as on it.
double covered_share(const Mesh& mesh, const LocalVertex& a, const LocalVertex& b, double width) {
  const double dx = static_cast<double>(b.x - a.x), dy = static_cast<double>(b.y - a.y), length2 = dx * dx + dy * dy;
  // Position along the segment of a vertex on it, -1 elsewhere.
  const auto along = [&](const LocalVertex& v) {
    const double px = static_cast<double>(v.x - a.x), py = static_cast<double>(v.y - a.y);
    if (std::abs(dx * py - dy * px) > width * std::sqrt(length2)) return -1.0;
    const double t = (px * dx + py * dy) / length2;
    return t >= -1e-12 && t <= 1 + 1e-12 ? t : -1.0;
  };
  double covered = 0;
  for (const Triangle& t : mesh.triangles) {
    for (std::size_t e = 0; e < 3; ++e) {
      const double p = along(mesh.vertices[t[e]]), q = along(mesh.vertices[t[(e + 1) % 3]]);
      if (p >= 0 && q > p) covered += q - p;
    }
  }
  return covered;
}

TEST(Triangulator, FollowsLinesAndKeepsThePromiseBesideThem) {
  for (std::uint64_t seed = 1; seed <= 8; ++seed) {
    const double tolerance_m = seed % 2 ? 25 : 80;
    const TestField f = field_over(rough_terrain(seed, 1000));
    const RefinementSpec spec = spec_from(kTile.level, tolerance_m, kFiner, f.field.lattice);
    TestTile tile = make_task(f.field, spec, kTile);
    add_lines(f, seed, 30, tile.task);
    tile.surface = triangulate(f.field, tile.task);
    const Mesh mesh = mesh_of(tile);
    const PostCheck posts = check_posts(f.field, kTile, mesh);
    EXPECT_EQ(posts.n_missed, 0);
    EXPECT_LE(posts.worst_m, tolerance_m) << "seed " << seed;
    EXPECT_LE(check_posts(f.field, kTile, tessellate(tile, {6, 7, 5, 6})).worst_m, tolerance_m) << "seed " << seed;
    EXPECT_GT(tile.surface.n_left_out, 0u);  // they do cross
    EXPECT_GT(tile.surface.n_of_lines, 20u);
    // The most important is there from end to end, and so are most of those that cross none before them.
    const double width = 3 * served_step(f);  // constraints give way to what is so close that rounding may part them
    EXPECT_GT(covered_share(mesh, tile.task.constraints[0][0], tile.task.constraints[0][1], width), 0.999);
    std::size_t whole = 0;
    for (const auto& [a, b] : tile.task.constraints) whole += covered_share(mesh, a, b, width) > 0.999;
    EXPECT_GE(whole + tile.surface.n_left_out, tile.task.constraints.size()) << "seed " << seed;
    for (const auto& piece : tile.task.constraints) {
      for (const LocalVertex& v : piece) EXPECT_THAT(tile.surface.interior, testing::Contains(v));
    }
  }
}

// What the server would have to mend: the mesh as quantized-mesh rounds it.
Mesh rounded(const TestField& f, Mesh mesh) {
  const std::int64_t side = f.field.lattice.tile_side(kTile.level);
  for (LocalVertex& v : mesh.vertices) {
    for (std::int64_t* at : {&v.x, &v.y}) {  // in steps
      if (*at <= 0 || *at >= side) {
        *at = *at <= 0 ? 0 : 32767;
      } else {
        const auto steps = std::llround(static_cast<double>(*at) / served_step(f));
        *at = std::clamp<std::int64_t>(steps, 1, 32766);
      }
    }
  }
  return mesh;
}
std::size_t n_not_positive(const Mesh& mesh) {
  return static_cast<std::size_t>(std::count_if(mesh.triangles.begin(), mesh.triangles.end(), [&](const Triangle& t) {
    const LocalVertex &a = mesh.vertices[t[0]], &b = mesh.vertices[t[1]], &c = mesh.vertices[t[2]];
    return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x) <= 0;
  }));
}

TEST(Triangulator, LeavesNoTriangleBesideALineThatRoundingTurnsOver) {
  // Posts ten steps of quantized-mesh apart, and lines from post to post that pass others at a twentieth of a post.
  constexpr int kFineLattice = 12;
  const double spacing = std::ldexp(1.0, 16 + kFineLattice - kTile.level) / 3276.7 * 1.0007;
  std::size_t n_beside = 0;
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    GridPlace place = place_over(kTile.level, kTile.x, kTile.y, kFineLattice, spacing, 3);
    place.n_rows = std::min<std::int64_t>(place.n_rows, 300);
    place.n_cols = std::min<std::int64_t>(place.n_cols, 300);
    const TestField f(place, rough_terrain(seed, 1000));
    TestTile tile = make_task(f.field, spec_from(kTile.level, 60, kFiner, f.field.lattice), kTile);
    const std::int64_t side = f.field.lattice.tile_side(kTile.level), west = side * kTile.x, south = side * kTile.y;
    const auto post = [&](std::int64_t r, std::int64_t c) {
      const std::int64_t x = std::llround(f.field.post_x(c)), y = std::llround(f.field.post_y(r));
      return LocalVertex{x - west, y - south, f.field.lattice_height(x, y)};
    };
    for (std::int64_t k = 0; k < 12; ++k) {  // (8, 13) is half a post's area off the way by (11, 18)
      const std::int64_t r = 20 + 22 * k, c = 20 + static_cast<std::int64_t>(200 * noise(seed, k, 1));
      tile.task.constraints.push_back({post(r, c), post(r + 18, c + 11)});
      tile.task.initial.push_back(post(r + 13, c + 8));
      ++n_beside;
    }
    tile.surface = triangulate(f.field, tile.task);
    const Mesh mesh = mesh_of(tile);
    EXPECT_EQ(n_not_positive(rounded(f, mesh)), 0u) << "seed " << seed;
    EXPECT_LE(check_posts(f.field, kTile, mesh).worst_m, 60) << "seed " << seed;
  }
  EXPECT_EQ(n_beside, 48u);
}

TEST(Triangulator, KeepsVerticesOffTheSidesWhenRounded) {
  // A column and a row of posts less than half a step of quantized-mesh beside the tile's sides.
  constexpr int kFineLattice = 12;
  constexpr double kTolerance = 60;
  const double side = std::ldexp(1.0, 16 + kFineLattice - kTile.level);
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    GridPlace place = place_over(kTile.level, kTile.x, kTile.y, kFineLattice, side / 1000.003, 3);
    place.n_rows = place.n_cols = 200;
    place.x0 = kTile.x * side - 3 * place.dx + side / 32767 * 0.1;
    place.y0 = kTile.y * side - 3 * place.dy + side / 32767 * 0.1;
    const HeightAt rough = rough_terrain(seed, 20000);
    const TestField f(place, [&](auto r, auto c) {  // down to the base height at the far rims: no cliffs there
      return rough(r, c) * std::min(1.0, static_cast<double>(199 - std::max(r, c)) / 30);
    });
    TestTile tile = make_task(f.field, spec_from(kTile.level, kTolerance, kFiner, f.field.lattice), kTile);
    const std::int64_t west = f.field.lattice.tile_side(kTile.level) * kTile.x;
    const std::int64_t south = f.field.lattice.tile_side(kTile.level) * kTile.y;
    for (std::int64_t k = 4; k < 200; k += 3) {  // as the parent may have them
      for (const auto& [r, c] : {std::pair{k, std::int64_t{3}}, std::pair{std::int64_t{3}, k}}) {
        const std::int64_t x = std::llround(f.field.post_x(c)), y = std::llround(f.field.post_y(r));
        tile.task.initial.push_back({x - west, y - south, f.field.lattice_height(x, y)});
      }
    }
    tile.surface = triangulate(f.field, tile.task);
    Mesh mesh = mesh_of(tile);
    const Mesh steps = rounded(f, mesh);
    EXPECT_EQ(n_not_positive(steps), 0u);
    for (std::size_t k = 0; k < mesh.vertices.size(); ++k) {
      mesh.vertices[k].x = std::llround(static_cast<double>(steps.vertices[k].x) * served_step(f));
      mesh.vertices[k].y = std::llround(static_cast<double>(steps.vertices[k].y) * served_step(f));
    }
    EXPECT_LE(check_posts(f.field, kTile, mesh).worst_m, kTolerance * (1 + 1e-3)) << "seed " << seed;
  }
}

TEST(Triangulator, LeadsALineThroughAPostThatItNearlyMeets) {
  // A sharp peak whose vertex lies half a step beside a long line through the plain.
  TestField f = field_over([](auto r, auto c) { return r == 50 && c == 50 ? 900.0 : 0.0; });
  const std::int64_t side = f.field.lattice.tile_side(kTile.level);
  const double px = f.field.post_x(50) - static_cast<double>(side * kTile.x);
  const double py = f.field.post_y(50) - static_cast<double>(side * kTile.y);
  const std::int64_t x = std::llround(px), y = std::llround(py);
  const RefinementSpec spec = spec_from(kTile.level, 20, kFiner, f.field.lattice);
  for (const int way : {-1, 1}) {
    for (const bool known_before : {false, true}) {
      TestTile tile = make_task(f.field, spec, kTile);
      // The line passes the vertex at 1/2 step, on either side.
      tile.task.constraints = {{LocalVertex{x - 20000, y - 10000, 0}, LocalVertex{x + 20000, y + 10000 + way, 0}}};
      if (known_before) tile.task.initial = {{x, y, f.field.lattice.height_from_m(900)}};
      tile.surface = triangulate(f.field, tile.task);
      EXPECT_LE(check_posts(f.field, kTile, mesh_of(tile)).worst_m, 20) << way << known_before;
    }
  }
}

TEST(Triangulator, ComesToAnEndWhereALineAndAVertexAreStepsApart) {
  // Of these three each lies beside the way between the two others: nothing is gained by leading the line around.
  const TestField f = field_over([](auto, auto) { return 50.0; });
  const std::int64_t x = f.field.lattice.tile_side(kTile.level) / 2 + 700;
  TestTile tile = make_task(f.field, spec_from(kTile.level, 20, kFiner, f.field.lattice), kTile);
  const std::int32_t z = f.field.lattice.height_from_m(50);
  const LocalVertex a{x, x, z}, b{x + 2, x + 1, z}, beside{x + 1, x + 2, z};
  tile.task.initial = {beside};
  tile.task.constraints = {{a, b}};
  tile.surface = triangulate(f.field, tile.task);
  EXPECT_EQ(tile.surface.interior, (std::vector<LocalVertex>{a, b, beside}));
  EXPECT_EQ(tile.surface.n_left_out, 0u);
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

TEST(Triangulator, GivesTheSameWithAndWithoutBlocksOfPosts) {
  const std::vector<std::pair<std::string, HeightAt>> terrains = {
      {"rough", rough_terrain(21, 900)},
      {"whole metres, so that errors are equal",
       [](auto r, auto c) { return std::floor(noise(3, r / 9, c / 7) * 9) * 40; }},
      {"one peak", [](auto r, auto c) { return r == 31 && c == 64 ? 500.0 : 0.0; }},
      {"a slope", [](auto r, auto c) { return 7.0 * static_cast<double>(r) - 3.0 * static_cast<double>(c); }}};
  for (const auto& [name, height] : terrains) {
    for (const bool gaps : {false, true}) {
      TestField f = field_over(height);
      for (std::size_t i = 0; gaps && i < f.origins.size(); i += 1 + i % 97) f.origins[i] = PostOrigin::kFilled;
      const TestTile plain = build_tile(f.field, spec_from(kTile.level, 60, kFiner, f.field.lattice), kTile);
      std::vector<std::uint64_t> memory(PostBlocks::n_bytes(f.field.n_rows, f.field.n_cols) / 8 + 1);
      const PostBlocks blocks = PostBlocks::build(f.field, std::as_writable_bytes(std::span(memory)), 1);
      f.field.blocks = &blocks;
      const TestTile tile = build_tile(f.field, spec_from(kTile.level, 60, kFiner, f.field.lattice), kTile);
      EXPECT_EQ(tile.surface.interior, plain.surface.interior) << name;
      EXPECT_EQ(tile.surface.triangles, plain.surface.triangles) << name;
      EXPECT_EQ(tile.surface.stats.n_posts, plain.surface.stats.n_posts) << name;
      EXPECT_EQ(tile.surface.stats.max_error_m, plain.surface.stats.max_error_m) << name;
      EXPECT_NEAR(tile.surface.stats.rmse_m, plain.surface.stats.rmse_m, 1e-4) << name;
      EXPECT_LE(check_posts(f.field, kTile, mesh_of(tile)).worst_m, 60) << name;
    }
  }
}

TEST(Triangulator, GivesTheSameForAnyNumberOfThreads) {
  TestField f = field_over(rough_terrain(33, 900));
  for (std::size_t i = 0; i < f.origins.size(); i += 1 + i % 89) f.origins[i] = PostOrigin::kFilled;
  const TestTile one = build_tile(f.field, spec_from(kTile.level, 20, kFiner, f.field.lattice), kTile);
  ASSERT_GT(one.surface.triangles.size(), 2000u);  // enough for several jobs
  for (const int threads : {2, 3, 8}) {
    const TileSurface many = triangulate(f.field, one.task, threads);
    EXPECT_EQ(many.interior, one.surface.interior) << threads;
    EXPECT_EQ(many.triangles, one.surface.triangles) << threads;
    EXPECT_EQ(many.stats.max_error_m, one.surface.stats.max_error_m) << threads;
    EXPECT_EQ(many.stats.rmse_m, one.surface.stats.rmse_m) << threads;
    EXPECT_EQ(many.stats.n_posts, one.surface.stats.n_posts) << threads;
  }
}

TEST(Triangulator, MeasuresEachCellOnceWhateverThreadsAndBlocksThereAre) {
  TestField f = field_over(rough_terrain(9, 800));
  for (std::size_t i = 0; i < f.origins.size(); i += 1 + i % 97) f.origins[i] = PostOrigin::kFilled;
  TestTile tile = make_task(f.field, spec_from(kTile.level, 50, kFiner, f.field.lattice), kTile);
  const TileSurface whole = triangulate(f.field, tile.task);
  ASSERT_EQ(whole.cells.size(), 1u);
  EXPECT_EQ(whole.cells[0].n_posts, whole.stats.n_posts);
  for (const int n_levels : {1, 3, kMostCellLevels}) {
    tile.task.n_cell_levels = n_levels;
    const TileSurface surface = triangulate(f.field, tile.task);
    ASSERT_EQ(surface.cells.size(), std::size_t{1} << (2 * n_levels));
    EXPECT_EQ(surface.triangles, whole.triangles);
    EXPECT_EQ(surface.stats.n_posts, whole.stats.n_posts);
    EXPECT_EQ(surface.stats.max_error_m, whole.stats.max_error_m);
    EXPECT_NEAR(surface.stats.rmse_m, whole.stats.rmse_m, 1e-5);
    EXPECT_EQ(triangulate(f.field, tile.task, 3).cells, surface.cells);
    std::uint64_t n_posts = 0;
    float largest_m = 0;
    for (const CellErrors& cell : surface.cells) {
      n_posts += cell.n_posts;
      largest_m = std::max(largest_m, cell.largest_m);
      EXPECT_LE(cell.sum_m2, static_cast<double>(cell.n_posts) * std::pow(cell.largest_m, 2) * (1 + 1e-6));
    }
    EXPECT_EQ(n_posts, surface.stats.n_posts);
    EXPECT_EQ(std::nextafter(largest_m, 1e30f), surface.stats.max_error_m);
  }
}

TEST(Triangulator, GivesTheSameWithBlocksOnDemandOnAnyNumberOfThreads) {
  TestField f = field_over(rough_terrain(9, 800));
  for (std::size_t i = 0; i < f.origins.size(); i += 1 + i % 997) f.origins[i] = PostOrigin::kFilled;
  const std::uint64_t n = PostBlocks::n_bytes(f.field.n_rows, f.field.n_cols) / 8 + 1;
  std::vector<std::uint64_t> memory(n);
  const PostBlocks blocks = PostBlocks::build(f.field, std::as_writable_bytes(std::span(memory)), 1);
  f.field.blocks = &blocks;
  // Meshes of large triangles, so that whole blocks lie in them.
  for (const double tolerance_m : {300.0, 2000.0}) {
    TestTile tile = make_task(f.field, spec_from(kTile.level, tolerance_m, kFiner, f.field.lattice), kTile);
    for (const int n_levels : {0, 2, kMostCellLevels}) {
      tile.task.n_cell_levels = n_levels;
      const TileSurface surface = triangulate(f.field, tile.task);
      for (const int threads : {1, 4}) {
        std::vector<std::uint64_t> other_memory(n);
        HeightField field = f.field;
        const PostBlocks on_demand = PostBlocks::on_demand(field, std::as_writable_bytes(std::span(other_memory)), 2);
        field.blocks = &on_demand;
        const TileSurface other = triangulate(field, tile.task, threads);
        EXPECT_EQ(other.interior, surface.interior) << threads;
        EXPECT_EQ(other.triangles, surface.triangles) << threads;
        EXPECT_EQ(other.stats, surface.stats) << threads;
        EXPECT_EQ(other.cells, surface.cells) << threads;
        EXPECT_EQ(other.vertex_posts.served_step_m, surface.vertex_posts.served_step_m) << threads;
      }
    }
  }
}

// A tile with cells, and the run that repeats it over few posts after the heights under tile `changed` were changed.
class Repeated : public ::testing::Test {
 protected:
  void make(const HeightAt& height, double tolerance_m, std::int64_t n_posts = 0) {
    GridPlace place = place_over(kTile.level, kTile.x, kTile.y, kLatticeLevel, kSpacing, 3);
    if (n_posts > 0) place.n_rows = place.n_cols = n_posts;
    f_.emplace(place, height);
    tile_ = make_task(f_->field, spec_from(kTile.level, tolerance_m, kFiner, f_->field.lattice), kTile);
    tile_.task.n_cell_levels = 3;
    tile_.surface = triangulate(f_->field, tile_.task);
  }
  float& post(std::int64_t r, std::int64_t c) {
    return f_->heights_m[static_cast<std::size_t>(r * f_->field.n_cols + c)];
  }
  // Descendants three levels down around a post.
  std::vector<TileKey> around(std::int64_t r, std::int64_t c) const {
    const double side = static_cast<double>(f_->field.lattice.tile_side(kTile.level + 3));
    std::set<std::pair<std::uint32_t, std::uint32_t>> found;
    for (const double dx : {-1.0, 1.0}) {
      for (const double dy : {-1.0, 1.0}) {
        found.emplace(static_cast<std::uint32_t>((f_->field.post_x(c) + dx) / side),
                      static_cast<std::uint32_t>((f_->field.post_y(r) + dy) / side));
      }
    }
    std::vector<TileKey> keys;
    for (const auto& [x, y] : found) keys.push_back({kTile.level + 3, x, y});
    return keys;
  }
  std::optional<TileSurface> repeat(const std::vector<TileKey>& changed, int threads = 1) const {
    const TileSurface& s = tile_.surface;
    const EarlierTile earlier{s.interior, s.triangles, s.cells, changed, [&](const VertexPosts& now) {
                                return now.served_step_m == s.vertex_posts.served_step_m &&
                                       now.heights_m == s.vertex_posts.heights_m;
                              }};
    return repeat_triangulation(f_->field, tile_.task, earlier, threads);
  }
  static void expect_same(const TileSurface& a, const TileSurface& b) {
    EXPECT_EQ(a.interior, b.interior);
    EXPECT_EQ(a.triangles, b.triangles);
    EXPECT_EQ(a.stats, b.stats);
    EXPECT_EQ(a.cells, b.cells);
    EXPECT_EQ(a.n_inserted, b.n_inserted);
    EXPECT_EQ(a.vertex_posts.heights_m, b.vertex_posts.heights_m);
  }

  std::optional<TestField> f_;
  TestTile tile_;
};

TEST_F(Repeated, GivesTheSameOutOfThePostsOfItsVertices) {
  for (const auto& [n_posts, tolerance_m] : {std::pair{0, 40.0}, {0, 400.0}, {57, 35.0}, {9, 35.0}}) {
    make(rough_terrain(6, 900), tolerance_m, n_posts);
    ASSERT_FALSE(tile_.surface.vertex_posts.heights_m.empty());
    const auto again = repeat({}, 2);
    ASSERT_TRUE(again) << n_posts;
    expect_same(*again, tile_.surface);
  }
}

TEST_F(Repeated, IsWhatTheWholeRunMakesOfChangedPostsOrNothing) {
  make(rough_terrain(6, 900), 60);
  int n_repeated = 0, n_whole = 0;
  for (std::int64_t k = 0; k < 400; ++k) {
    const auto r = static_cast<std::int64_t>(5 + noise(1, k, 0) * 95),
               c = static_cast<std::int64_t>(5 + noise(1, k, 1) * 95);
    const float before = post(r, c);
    post(r, c) += static_cast<float>(std::exp(noise(1, k, 2) * 8 - 2) * (k % 2 ? 1 : -1));
    const TileSurface whole = triangulate(f_->field, tile_.task);
    if (const auto again = repeat(around(r, c))) {
      expect_same(*again, whole);
      ++n_repeated;
    } else {
      ++n_whole;
    }
    post(r, c) = before;
  }
  EXPECT_GT(n_repeated, 100);
  EXPECT_GT(n_whole, 100);
}

TEST_F(Repeated, SeesThatAVertexHasChanged) {
  make(rough_terrain(6, 900), 60);
  // The post of an inner vertex.
  const LocalVertex& v = tile_.surface.interior[tile_.surface.interior.size() / 2];
  const double side = static_cast<double>(f_->field.lattice.tile_side(kTile.level));
  const auto c = std::llround((side * kTile.x + static_cast<double>(v.x) - f_->field.x0) / f_->field.dx);
  const auto r = std::llround((side * kTile.y + static_cast<double>(v.y) - f_->field.y0) / f_->field.dy);
  post(r, c) += 0.001f;
  EXPECT_FALSE(repeat(around(r, c)));
  post(r, c) -= 0.001f;
  // Nor are errors taken over of cells that are not there, nor posts of most of the tile looked at.
  EXPECT_TRUE(repeat(around(r, c)));
  EXPECT_FALSE(repeat({kTile}));
  tile_.surface.cells.pop_back();
  EXPECT_FALSE(repeat(around(r, c)));
}

// The mesh's own vertices must tell what is missing: not each change may go unnoticed.
TEST_F(Repeated, NoticesAPostThatIsToBecomeAVertex) {
  make([](auto r, auto c) { return 3.0 * static_cast<double>(r) + static_cast<double>(c); }, 30);
  for (const auto& [r, c] : {std::pair{20, 20}, {50, 51}, {77, 13}}) {
    post(r, c) += 31;
    EXPECT_FALSE(repeat(around(r, c)));
    EXPECT_TRUE(repeat({})) << "not told of it";
    post(r, c) -= 2;
    EXPECT_TRUE(repeat(around(r, c)));
    post(r, c) -= 29;
  }
}

// Errors far from the tolerance are squared with a finer or a coarser quantum.
TEST(Triangulator, MeasuresErrorsFarFromTheTolerance) {
  const auto slight = [](auto r, auto c) { return noise(5, r, c) * 1e-3; };
  for (const double tolerance_m : {0.5, 5000.0}) {
    const TestField f = field_over(slight);
    const TestTile tile = build_tile(f.field, spec_from(kTile.level, tolerance_m, 1, f.field.lattice), kTile);
    const PostCheck posts = check_posts(f.field, kTile, mesh_of(tile));
    ASSERT_GT(posts.own_rmse_m, 1e-5);
    EXPECT_NEAR(tile.surface.stats.rmse_m, posts.own_rmse_m, 1e-5 * posts.own_rmse_m) << tolerance_m;
  }
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
