// SPDX-License-Identifier: GPL-3.0-or-later
// The arithmetic that the checks rest on.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <set>

#include "tests/client/cut_planner.hpp"
#include "tests/client/globe_mesh.hpp"
#include "tests/client/post_scan.hpp"
#include "tests/client/terrain_decode.hpp"
#include "tests/client/tessellate.hpp"
#include "tests/client/tile_faults.hpp"
#include "tests/client_checks/memory_pyramid.hpp"

namespace tind::client {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;

TEST(TwiceArea, IsExactAtTheLargestCoordinates) {
  const std::int64_t far = std::int64_t{1} << 45;
  EXPECT_TRUE(twice_area(0, 0, far, far, far + 1, far + 1) == 0);
  EXPECT_TRUE(twice_area(0, 0, far, far - 1, far + 1, far) == 1) << "far from what doubles can tell";
  EXPECT_TRUE(twice_area(0, 0, far, far, far + 1, far) == -far);
}

TEST(MortonOrder, ComparesTheHighestDifferingBitYFirst) {
  // All points of an 8 x 8 grid against interleaved numbers.
  const auto code = [](unsigned x, unsigned y) {
    unsigned value = 0;
    for (unsigned bit = 0; bit < 3; ++bit) value |= ((x >> bit) & 1) << (2 * bit) | ((y >> bit) & 1) << (2 * bit + 1);
    return value;
  };
  for (unsigned a = 0; a < 64; ++a) {
    for (unsigned b = 0; b < 64; ++b) {
      EXPECT_EQ(before_in_morton_order(a % 8, a / 8, b % 8, b / 8), code(a % 8, a / 8) < code(b % 8, b / 8));
    }
  }
}

TEST(FirstLevelOfLine, IsWhereTheLineIsFirstATileSide) {
  EXPECT_EQ(first_level_of_line({3, 0, 5}, 3), 0) << "longitude 180";
  EXPECT_EQ(first_level_of_line({3, 15, 5}, 1), 0) << "longitude 180 from the west";
  EXPECT_EQ(first_level_of_line({3, 8, 5}, 3), 0) << "longitude 0";
  EXPECT_EQ(first_level_of_line({3, 4, 5}, 3), 1);
  EXPECT_EQ(first_level_of_line({3, 5, 5}, 3), 3);
  EXPECT_EQ(first_level_of_line({3, 5, 4}, 0), 1) << "the equator";
  EXPECT_EQ(first_level_of_line({3, 5, 0}, 0), 0) << "the pole";
}

/// A square tile of side 16 with one inner vertex on its east border and one in the middle.
Tile small_tile(int level) {
  Tile tile;
  tile.id = {level, 0, 0};
  tile.n_side = {0, 1, 0, 0};
  tile.vertices = {{0, 0, 0}, {16, 0, 0}, {16, 8, 5}, {16, 16, 0}, {0, 16, 0}, {6, 8, 9}};
  tile.entries = {{{0, 0}, {0, 0, 0}, {0, 0}, {0, 0}}};
  tile.triangles = {{0, 1, 5}, {0, 5, 4}, {1, 2, 5}, {2, 3, 5}, {3, 4, 5}};
  tile.vts = {{0, 1, 0, 0, 0}, {2, 1, 1, 0, 0}, {3, 1, 1, 1, 0}, {4, 1, 2, 0, 0}, {1, 1, 3, 0, 0}};
  return tile;
}

/// A lattice on which tiles of the level have 16 steps a side.
LatticeFrame frame_of_16(int level) { return {level - 12, 0}; }

TEST(TileFaults, GoodTileHasNone) {
  const Tile tile = small_tile(12);
  EXPECT_THAT(find_outline_faults(tile, frame_of_16(12)), IsEmpty());
  EXPECT_THAT(find_interior_faults(tile, frame_of_16(12)), IsEmpty());
  EXPECT_THAT(find_triangle_faults(tile, frame_of_16(12)), IsEmpty());
  EXPECT_THAT(find_vt_faults(tile), IsEmpty());
}

TEST(TileFaults, CornerTrianglesHaveTwoBorderEdges) {
  Tile tile;
  tile.id = {12, 0, 0};
  tile.vertices = {{0, 0, 0}, {16, 0, 0}, {16, 16, 0}, {0, 16, 0}};
  tile.entries = {{{0, 0}, {0, 0}, {0, 0}, {0, 0}}};
  tile.triangles = {{0, 1, 3}, {1, 2, 3}};
  // The one at C0 is listed first, its ring starts in the middle of it; the other holds C2.
  tile.vts = {{0, 2, 0, 0, 0}, {1, 2, 2, 0, 0}};
  EXPECT_THAT(find_vt_faults(tile), IsEmpty());
  tile.vts[1].border = 1;
  EXPECT_THAT(find_vt_faults(tile), Not(IsEmpty()));
}

TEST(DecodeByEntryLevels, AppendsYoungVerticesAndEndsAtOldOnes) {
  const Tile tile = small_tile(12);
  const auto side =
      decode_by_entry_levels(tile, 1, {{0, 0, 0}, {3, 1, 13}, {8, 5, 0}, {9, 6, 13}, {12, 7, 14}, {16, 0, 0}});
  ASSERT_TRUE(side.has_value()) << side.error();
  EXPECT_EQ(side->inserted[0], (std::vector<SideVertex>{{3, 1, 13}}));
  EXPECT_EQ(side->inserted[1], (std::vector<SideVertex>{{9, 6, 13}, {12, 7, 14}}));
}

TEST(DecodeByEntryLevels, WestAndNorthRunBackwards) {
  const Tile tile = small_tile(12);
  const auto side = decode_by_entry_levels(tile, 3, {{0, 0, 0}, {3, 1, 13}, {5, 2, 13}, {16, 0, 0}});
  ASSERT_TRUE(side.has_value()) << side.error();
  EXPECT_EQ(side->inserted[0], (std::vector<SideVertex>{{5, 2, 13}, {3, 1, 13}}));
}

TEST(DecodeByEntryLevels, RefusesLinesThatDoNotFit) {
  const Tile tile = small_tile(12);
  EXPECT_FALSE(decode_by_entry_levels(tile, 1, {})) << "no line";
  EXPECT_FALSE(decode_by_entry_levels(tile, 1, {{0, 0, 0}, {16, 0, 0}})) << "a vertex of the tile is missing";
  EXPECT_FALSE(decode_by_entry_levels(tile, 1, {{0, 0, 0}, {8, 6, 0}, {16, 0, 0}})) << "another height";
  EXPECT_FALSE(decode_by_entry_levels(tile, 1, {{0, 0, 0}, {8, 5, 0}, {9, 5, 12}, {16, 0, 0}}))
      << "an old vertex the tile lacks";
  EXPECT_FALSE(decode_by_entry_levels(tile, 1, {{0, 0, 0}, {8, 5, 0}})) << "ends early";
  EXPECT_FALSE(decode_by_entry_levels(tile, 1, {{1, 0, 0}, {8, 5, 0}, {16, 0, 0}})) << "starts elsewhere";
}

Int128 area_of(const TessellatedTile& mesh) {
  Int128 sum = 0;
  for (const Corners& t : mesh.triangles) {
    const Vertex &a = mesh.vertices[t[0]], &b = mesh.vertices[t[1]], &c = mesh.vertices[t[2]];
    const Int128 area = twice_area(a.x, a.y, b.x, b.y, c.x, c.y);
    EXPECT_TRUE(area > 0);
    sum += area;
  }
  return sum;
}

TEST(Tessellate, FansOneBorderEdge) {
  const Tile tile = small_tile(12);
  std::array<std::optional<SideInserts>, 4> sides;
  sides[1] = decode_by_entry_levels(tile, 1, {{0, 0, 0}, {3, 1, 13}, {4, 1, 13}, {8, 5, 0}, {16, 0, 0}}).value();
  const auto mesh = tessellate(tile, sides);
  ASSERT_TRUE(mesh.has_value()) << mesh.error();
  EXPECT_EQ(mesh->changed_vts, 1u);
  EXPECT_EQ(mesh->triangles.size(), 7u);
  const std::vector<Corners> fan(mesh->triangles.begin() + static_cast<std::ptrdiff_t>(mesh->first_changed),
                                 mesh->triangles.end());
  EXPECT_EQ(fan, (std::vector<Corners>{{1, 6, 5}, {6, 7, 5}, {7, 2, 5}}));
  EXPECT_TRUE(area_of(*mesh) == 2 * 16 * 16);
}

TEST(Tessellate, ZigZagsTwoBorderEdgesAsTheFormatSays) {
  Tile tile;
  tile.id = {12, 0, 0};
  tile.vertices = {{0, 0, 0}, {16, 0, 0}, {16, 16, 0}, {0, 16, 0}};
  tile.entries = {{{0, 0}, {0, 0}, {0, 0}, {0, 0}}};
  tile.triangles = {{0, 1, 3}, {1, 2, 3}};
  tile.vts = {{0, 2, 0, 0, 0}, {1, 2, 2, 0, 0}};
  std::array<std::optional<SideInserts>, 4> sides;
  sides[0] = decode_by_entry_levels(tile, 0, {{0, 0, 0}, {2, 0, 13}, {5, 0, 13}, {9, 0, 13}, {16, 0, 0}}).value();
  sides[3] = decode_by_entry_levels(tile, 3, {{0, 0, 0}, {7, 0, 13}, {16, 0, 0}}).value();
  const auto mesh = tessellate(tile, sides);
  ASSERT_TRUE(mesh.has_value()) << mesh.error();
  // R = 4, 5, 6, 1 along the south, Q = 7, 3 up the west. By hand from docs/format.md 6.
  const std::vector<Corners> zig_zag(mesh->triangles.begin() + static_cast<std::ptrdiff_t>(mesh->first_changed),
                                     mesh->triangles.end());
  EXPECT_EQ(zig_zag, (std::vector<Corners>{{0, 4, 7}, {4, 5, 7}, {5, 6, 7}, {6, 3, 7}, {6, 1, 3}}));
  EXPECT_TRUE(area_of(*mesh) == 2 * 16 * 16);
}

TEST(Tessellate, RefusesAVtListThatDoesNotFit) {
  Tile tile = small_tile(12);
  std::swap(tile.vts[1].triangle, tile.vts[2].triangle);
  std::array<std::optional<SideInserts>, 4> sides;
  sides[1] = decode_by_entry_levels(tile, 1, {{0, 0, 0}, {3, 1, 13}, {8, 5, 0}, {16, 0, 0}}).value();
  EXPECT_FALSE(tessellate(tile, sides).has_value());
}

/// The two root squares as four triangles. Their sides span half the globe: the case that needs care.
void add_roots(GlobeMesh& mesh, const LatticeFrame& frame, int east_height) {
  const std::int64_t s = frame.side(0);
  const std::vector<Corners> triangles = {{0, 1, 2}, {0, 2, 3}};
  mesh.add({0, 0, 0}, std::vector<Vertex>{{0, 0, 1}, {s, 0, 1}, {s, s, 2}, {0, s, 2}}, triangles);
  mesh.add({0, 1, 0}, std::vector<Vertex>{{0, 0, 1}, {s, 0, 1}, {s, s, east_height}, {0, s, 2}}, triangles);
}

TEST(GlobeMesh, RootsCloseAroundTheGlobe) {
  const LatticeFrame frame{0, 0};
  GlobeMesh mesh(frame);
  add_roots(mesh, frame, 2);
  EXPECT_THAT(mesh.find_faults(), IsEmpty());
}

TEST(GlobeMesh, SeesTwoHeightsAcrossLongitude180) {
  const LatticeFrame frame{0, 0};
  GlobeMesh mesh(frame);
  add_roots(mesh, frame, 3);
  const auto faults = mesh.find_faults();
  ASSERT_FALSE(faults.empty());
  EXPECT_THAT(faults[0], HasSubstr("another height"));
}

TEST(GlobeMesh, SeesTJunctionsHolesAndOverlaps) {
  const LatticeFrame frame{0, 0};
  const std::int64_t s = frame.side(0);
  const std::vector<Vertex> square = {{0, 0, 0}, {s, 0, 0}, {s, s, 0}, {0, s, 0}, {s, s / 2, 0}};
  const std::vector<Corners> plain = {{0, 1, 2}, {0, 2, 3}}, divided = {{0, 1, 4}, {0, 4, 2}, {0, 2, 3}};
  GlobeMesh mesh(frame);
  mesh.add({0, 0, 0}, square, divided);
  mesh.add({0, 1, 0}, square, plain);
  EXPECT_THAT(mesh.find_faults(), testing::Contains(HasSubstr("crack or overlap"))) << "a T-junction";
  mesh.clear();
  mesh.add({0, 0, 0}, square, plain);
  EXPECT_THAT(mesh.find_faults(), testing::Contains(HasSubstr("plan areas sum to 0.5"))) << "a hole";
  mesh.clear();
  mesh.add({0, 0, 0}, square, plain);
  mesh.add({0, 1, 0}, square, plain);
  mesh.add({0, 1, 0}, square, plain);
  EXPECT_THAT(mesh.find_faults(), testing::Contains(HasSubstr("is used 2 time(s) one way"))) << "an overlap";
}

TEST(Cuts, AreCutsAndAreTheSameForTheSameSeed) {
  test::MemoryPyramid source(test::small_world().tind);
  const auto manifest = read_manifest(source.body_of("meta.json"));
  ASSERT_TRUE(manifest.has_value()) << manifest.error();
  const Pyramid pyramid(*manifest, 1, 1);
  const int bottom = manifest->bottom_level;
  const double globe = 2 * std::pow(4.0, bottom);
  std::set<std::size_t> sizes;
  for (int index = 0; index < 60; ++index) {
    const Cut cut = plan_cut(pyramid, 5, index);
    EXPECT_EQ(cut.leaves, plan_cut(pyramid, 5, index).leaves);
    double covered = 0;
    for (const auto leaf : cut.leaves) {
      const int level = pyramid.node(leaf).id.level;
      covered += std::pow(4.0, bottom - level);
      EXPECT_EQ(cut.split[static_cast<std::size_t>(leaf)], 0);
      for (auto up = pyramid.node(leaf).parent; up >= 0; up = pyramid.node(up).parent) {
        EXPECT_EQ(cut.split[static_cast<std::size_t>(up)], 1);
      }
    }
    EXPECT_EQ(covered, globe) << "leaves tile the globe once";
    sizes.insert(cut.leaves.size());
  }
  EXPECT_GT(sizes.size(), 12u) << "strongly mixed";
  EXPECT_TRUE(sizes.contains(2)) << "the roots alone";
}

TEST(ScanTriangle, FindsThePostsThatAPlainTestFinds) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> at(-20, 120), height(-500, 3000);
  PostWindow w;
  w.n_rows = 40;
  w.n_columns = 50;
  w.x = 0.37;
  w.y = 1.21;
  w.dx = 2.03;
  w.dy = 2.51;
  w.nudge = 1e-9;
  std::uint64_t n_inside = 0;
  for (int round = 0; round < 300; ++round) {
    std::array<SurfacePoint, 3> p;
    for (auto& corner : p) corner = {at(random), at(random), height(random)};
    const double area = (p[1].x - p[0].x) * (p[2].y - p[0].y) - (p[1].y - p[0].y) * (p[2].x - p[0].x);
    std::set<std::pair<std::int64_t, std::int64_t>> seen;
    scan_triangle(p, w, [&](std::int64_t r, std::int64_t c, double z) {
      EXPECT_TRUE(seen.emplace(r, c).second);
      const double x = w.post_x(c), y = w.post_y(r);
      const double l1 = ((x - p[0].x) * (p[2].y - p[0].y) - (y - p[0].y) * (p[2].x - p[0].x)) / area;
      const double l2 = ((p[1].x - p[0].x) * (y - p[0].y) - (p[1].y - p[0].y) * (x - p[0].x)) / area;
      EXPECT_NEAR(z, p[0].z_m + l1 * (p[1].z_m - p[0].z_m) + l2 * (p[2].z_m - p[0].z_m), 1e-4);
    });
    std::size_t plain = 0;
    for (std::int64_t r = 0; r < w.n_rows; ++r) {
      for (std::int64_t c = 0; c < w.n_columns; ++c) {
        bool inside = true;
        for (std::size_t k = 0; k < 3; ++k) {
          const SurfacePoint &a = p[k], &b = p[(k + 1) % 3];
          const double side = (b.x - a.x) * (w.post_y(r) - a.y) - (b.y - a.y) * (w.post_x(c) - a.x);
          inside = inside && side * area >= 0;
        }
        plain += inside ? 1 : 0;
      }
    }
    EXPECT_EQ(seen.size(), plain);
    n_inside += plain;
  }
  EXPECT_GT(n_inside, 10000u);
}

TEST(PostWindows, MeetATileOnBothSidesOfLongitude180) {
  SourcePosts posts;
  posts.west_deg = 178;
  posts.south_deg = 10;
  posts.lon_spacing_deg = posts.lat_spacing_deg = 0.5;
  posts.n_cols = 9;  // 178 .. 182
  posts.n_rows = 3;
  const LatticeFrame frame{4, 0};
  const auto eastern = post_windows(posts, frame, {0, 1, 0}), western = post_windows(posts, frame, {0, 0, 0});
  ASSERT_EQ(eastern.size(), 1u);
  ASSERT_EQ(western.size(), 1u);
  EXPECT_EQ(eastern[0].n_columns, 5) << "178 .. 180, the last on the line itself";
  EXPECT_EQ(western[0].column0, 4);
  EXPECT_EQ(western[0].n_columns, 5);
  EXPECT_NEAR(western[0].x, 0, 1e-6);
  EXPECT_THAT(post_windows(posts, frame, {1, 1, 1}), IsEmpty());
}

TEST(Normals, DecodeToUnitVectors) {
  const auto up = decode_normal({128, 128});
  EXPECT_NEAR(up[2], 1, 1e-4);
  const auto down = decode_normal({255, 255});
  EXPECT_NEAR(down[2], -1, 1e-4);
}

}  // namespace
}  // namespace tind::client
