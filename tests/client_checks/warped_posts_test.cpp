// SPDX-License-Identifier: GPL-3.0-or-later
// Posts that the client warps itself: surfaces with a formula in projected coordinates must come back at every post.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/client/source_warp.hpp"
#include "tests/client_checks/projected_raster.hpp"

namespace tind::client {
namespace {

using test::project;
using test::ProjectedPlan;
using test::write_projected;
using testing::HasSubstr;

GridClaim claim_of(double per_degree_east, double per_degree_north, bool cubic = false) {
  GridClaim claim;
  claim.spacing_deg = {1 / per_degree_east, 1 / per_degree_north};
  claim.cubic = cubic;
  return claim;
}

Outcome<SourcePosts> warp(const ProjectedPlan& plan, const GridClaim& claim, const SourceOptions& options = {}) {
  static int number = 0;
  const std::string path = "/vsimem/warped_" + std::to_string(number++) + ".tif";
  write_projected(path, plan);
  return read_source_posts({path}, options, claim);
}

/// Compares every post that is half a cell or more inside the raster with the plan's formula, and sees that posts are
/// exactly where the raster is. Returns how many were compared.
int compare_with_formula(const ProjectedPlan& plan, const SourcePosts& posts, double unit_m, double tolerance_m) {
  const auto& t = plan.transform;
  int compared = 0, wrong = 0;
  for (std::size_t k = 0; k < posts.heights_m.size(); ++k) {
    const auto at = static_cast<std::int64_t>(k);
    if (posts.is_uncertain(at)) continue;
    const auto p = project(plan.crs, posts.longitude_of(at), posts.latitude_of(at));
    const double column = (p[0] - t[0]) / t[1], row = (p[1] - t[3]) / t[5];
    const bool inside = column >= 0 && row >= 0 && column < plan.n_columns && row < plan.n_rows;
    if (inside != posts.has(at)) ++wrong;
    if (column < 0.5 || row < 0.5 || column > plan.n_columns - 0.5 || row > plan.n_rows - 0.5 || !posts.has(at))
      continue;
    ++compared;
    if (std::abs(static_cast<double>(posts.heights_m[k]) - plan.height(p[0], p[1]) * unit_m) > tolerance_m) ++wrong;
  }
  EXPECT_EQ(wrong, 0) << "of " << compared;
  return compared;
}

TEST(WarpedPosts, APlaneInUtmComesBackAtEveryPost) {
  const ProjectedPlan plan;
  const auto posts = warp(plan, claim_of(3100, 3700));
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_EQ(posts->kind, SourceKind::kWarped);
  EXPECT_NEAR(posts->longitude_of(0) * 3100, std::round(posts->longitude_of(0) * 3100), 1e-6)
      << "multiples of the spacing";
  EXPECT_GT(compare_with_formula(plan, *posts, 1, 1e-3), 2500);
  // 30 m against the length of a degree at 34.3 degrees north.
  EXPECT_NEAR(posts->native[0].cells_per_degree, 111320 * std::cos(34.33 * std::acos(-1.0) / 180) / 30, 8);
  EXPECT_NEAR(posts->native[1].cells_per_degree, 110930.0 / 30, 5);
}

TEST(WarpedPosts, NonSquareMirroredAndRotatedCellsInAnyOrderOfRows) {
  ProjectedPlan plan;
  plan.transform = {400000, 45, 0, 3798000, 0, 20};
  const auto mirrored = warp(plan, claim_of(2300, 5600));
  ASSERT_TRUE(mirrored.has_value()) << mirrored.error();
  EXPECT_GT(compare_with_formula(plan, *mirrored, 1, 1e-3), 2500);

  const double c = 30 * std::cos(0.3), s = 30 * std::sin(0.3);
  plan.transform = {400000, c, s, 3800000, s, -c};
  const auto rotated = warp(plan, claim_of(3100, 3700));
  ASSERT_TRUE(rotated.has_value()) << rotated.error();
  std::size_t n = 0;
  for (std::size_t k = 0; k < rotated->heights_m.size(); ++k) {
    const auto at = static_cast<std::int64_t>(k);
    if (!rotated->has(at)) continue;
    const auto p = project(plan.crs, rotated->longitude_of(at), rotated->latitude_of(at));
    // Within half a cell of the rim the plane is only known from one side.
    ASSERT_NEAR(rotated->heights_m[k], plan.height(p[0], p[1]), 0.5);
    ++n;
  }
  EXPECT_NEAR(static_cast<double>(n), 3000 * (3100 / 3058.) * (3700 / 3698.), 150) << "as many posts as the area has";
}

TEST(WarpedPosts, PixelIsPointMovesNothing) {
  ProjectedPlan plan;
  plan.pixel_is_point = true;
  const auto posts = warp(plan, claim_of(3100, 3700));
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_GT(compare_with_formula(plan, *posts, 1, 1e-3), 2500);
}

TEST(WarpedPosts, FeetAcrossAndFeetUpBecomeMetres) {
  ProjectedPlan plan;
  plan.crs = "EPSG:2992";  // Oregon, Lambert, international feet
  plan.transform = {650000, 100, 0, 860000, 0, -100};
  plan.unit = "ft";
  plan.height = [](double x, double y) { return 1000 + 0.02 * (x - 650000) + 0.01 * (y - 860000); };
  const auto posts = warp(plan, claim_of(2700, 3700));
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_GT(compare_with_formula(plan, *posts, 0.3048, 1e-3), 2500);
}

TEST(WarpedPosts, APolarRasterHasAllLongitudesAndItsPole) {
  ProjectedPlan plan;
  plan.crs = "EPSG:3413";
  plan.transform = {-500000, 10000, 0, 500000, 0, -10000};
  plan.n_columns = plan.n_rows = 100;
  plan.height = [](double x, double y) { return 100 + 1e-4 * x - 2e-4 * y; };
  const auto posts = warp(plan, claim_of(2, 12));
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_EQ(posts->n_cols, 720);
  EXPECT_NEAR(posts->latitude_of(posts->n_cols * (posts->n_rows - 1)), 90, 1e-9);
  EXPECT_NEAR(posts->heights_m.back(), 100, 1e-2) << "the pole";
  EXPECT_GT(compare_with_formula(plan, *posts, 1, 1e-2), 20000);
}

TEST(WarpedPosts, ARasterAcrossLongitude180IsOnePiece) {
  ProjectedPlan plan;
  plan.crs = "EPSG:32601";  // central meridian -177; -180 lies at about 265 km of easting
  plan.transform = {235000, 1000, 0, 5040000, 0, -1000};
  plan.height = [](double x, double y) { return 100 + 1e-3 * (x - 235000) + 1e-3 * (y - 5040000); };
  const auto posts = warp(plan, claim_of(110, 112));
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_LT(posts->n_cols, 300);
  EXPECT_GT(compare_with_formula(plan, *posts, 1, 1e-3), 2000);
  EXPECT_LT(posts->longitude_of(0), 180);
  EXPECT_GT(posts->longitude_of(posts->n_cols - 1), 180);
}

TEST(WarpedPosts, AMercatorMapAcrossItsOwnSeamIsOnePiece) {
  ProjectedPlan plan;
  plan.crs = "EPSG:3857";
  const double turn = 2 * std::acos(-1.0) * 6378137;
  plan.transform = {turn / 2 - 60000, 2000, 0, 5000000, 0, -2000};  // x runs past half the turn
  plan.height = [&](double x, double y) {
    if (x < 0) x += turn;
    return 100 + 1e-3 * (x - turn / 2) + 1e-3 * (y - 5000000);
  };
  const auto posts = warp(plan, claim_of(60, 80));
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_LT(posts->n_cols, 100);
  int wrong = 0, west = 0, east = 0;
  for (std::size_t k = 0; k < posts->heights_m.size(); ++k) {
    const auto at = static_cast<std::int64_t>(k);
    if (!posts->has(at) || posts->is_uncertain(at)) continue;
    const auto p = project(plan.crs, posts->longitude_of(at), posts->latitude_of(at));
    wrong += std::abs(static_cast<double>(posts->heights_m[k]) - plan.height(p[0], p[1])) > 1.5 ? 1 : 0;
    ++(posts->longitude_of(at) < 180 ? west : east);
  }
  EXPECT_EQ(wrong, 0);
  EXPECT_GT(west, 1000);
  EXPECT_GT(east, 1000);
}

TEST(WarpedPosts, GeographicRastersOffTheCommonGridAreWarpedTogether) {
  ProjectedPlan a;
  a.crs = "EPSG:4326";
  a.transform = {10, 0.01, 0, 46, 0, -0.01};
  a.height = [](double x, double y) { return 100 + x + 2 * y; };
  ProjectedPlan b = a;
  b.transform = {10.3043, 0.02, 0, 46.0031, 0, -0.02};
  write_projected("/vsimem/grid_a.tif", a);
  write_projected("/vsimem/grid_b.tif", b);
  const auto posts = read_source_posts({"/vsimem/grid_a.tif", "/vsimem/grid_b.tif"}, {}, claim_of(100, 100));
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_EQ(posts->kind, SourceKind::kWarped);
  EXPECT_NEAR(posts->native[0].cells_per_degree, 100, 0.01) << "the finest source sets the scale";
  EXPECT_FALSE(posts->other_values.empty());
  EXPECT_LT(posts->disagreement_m, 0.05) << "both show one plane; only rims differ";
}

TEST(WarpedPosts, WithoutAGridInTheManifestNothingIsGuessed) {
  const auto posts = warp({}, {});
  ASSERT_FALSE(posts.has_value());
  EXPECT_THAT(posts.error(), HasSubstr("spacing"));
}

TEST(WarpedPosts, ACrsMustBeKnown) {
  ProjectedPlan plan;
  plan.crs = "LOCAL_CS[\"somewhere\",UNIT[\"metre\",1]]";
  const auto unknown = warp(plan, claim_of(100, 100));
  ASSERT_FALSE(unknown.has_value());
  SourceOptions options;
  options.source_crs = "EPSG:32611";
  plan.height = ProjectedPlan{}.height;
  const auto told = warp(plan, claim_of(3100, 3700), options);
  ASSERT_TRUE(told.has_value()) << told.error();
  plan.crs = "EPSG:32611";
  EXPECT_GT(compare_with_formula(plan, *told, 1, 1e-3), 2500);
}

TEST(WarpedPosts, VoidsOfARasterAreHolesOfTheirOwnCells) {
  ProjectedPlan plan;
  plan.height = [](double x, double y) { return x > 400600 && x < 400900 && y < 3799500 && y > 3799000 ? NAN : 7.0; };
  const auto posts = warp(plan, claim_of(3100, 3700));
  ASSERT_TRUE(posts.has_value()) << posts.error();
  int holes = 0;
  for (std::size_t k = 0; k < posts->heights_m.size(); ++k) {
    const auto at = static_cast<std::int64_t>(k);
    const auto p = project(plan.crs, posts->longitude_of(at), posts->latitude_of(at));
    const bool in_hole = p[0] > 400600 && p[0] < 400900 && p[1] < 3799490 && p[1] > 3799010;
    holes += in_hole && !posts->has(at) ? 1 : 0;
    if (posts->has(at)) {
      ASSERT_EQ(posts->heights_m[k], 7.0f) << "weights of voids are dropped, the rest scaled";
    }
  }
  EXPECT_GT(holes, 100);
}

CellWindow window_of(std::int64_t n_columns, const std::vector<double>& heights) {
  CellWindow w;
  w.n_columns = n_columns;
  w.n_rows = static_cast<std::int64_t>(heights.size()) / n_columns;
  w.heights_m = heights;
  return w;
}

TEST(InterpolateCells, BilinearWithTheWeightsOfVoidsDropped) {
  const CellWindow w = window_of(2, {10, 20, NAN, 40});
  bool uncertain = false;
  EXPECT_DOUBLE_EQ(interpolate_cells(w, 0.5, 0.5, false, uncertain), 10);
  EXPECT_DOUBLE_EQ(interpolate_cells(w, 0.75, 0.5, false, uncertain), 12.5);
  // In the cell of 10, a quarter of the way to 20 and to the void: weights 9, 3, 3 (dropped), 1 sixteenths.
  EXPECT_DOUBLE_EQ(interpolate_cells(w, 0.75, 0.75, false, uncertain), (9 * 10 + 3 * 20 + 1 * 40) / 13.0);
  EXPECT_DOUBLE_EQ(interpolate_cells(w, 0.25, 0.25, false, uncertain), 10) << "outside is void";
  EXPECT_TRUE(std::isnan(interpolate_cells(w, 0.5, 1.5, false, uncertain))) << "the cell itself is void";
  EXPECT_TRUE(std::isnan(interpolate_cells(w, 2.5, 0.5, false, uncertain))) << "outside";
  EXPECT_FALSE(uncertain);
}

TEST(InterpolateCells, WhatTheLastBitDecidesIsUncertain) {
  const CellWindow w = window_of(2, {10, 20, NAN, 40});
  bool uncertain = false;
  interpolate_cells(w, 0.5, 1 - 1e-8, false, uncertain);
  EXPECT_TRUE(uncertain) << "a void begins below";
  uncertain = false;
  EXPECT_FALSE(std::isnan(interpolate_cells(w, 0.5, 1 + 1e-8, false, uncertain))) << "it may have a value";
  EXPECT_TRUE(uncertain);
  uncertain = false;
  interpolate_cells(w, 1 - 1e-8, 0.5, false, uncertain);
  EXPECT_FALSE(uncertain) << "both cells have heights";
  interpolate_cells(w, 1e-8, 0.5, false, uncertain);
  EXPECT_TRUE(uncertain) << "the raster's own rim";
}

TEST(InterpolateCells, CubicKeepsQuadraticsAndFallsBackBesideVoids) {
  // Keys' kernel with a = -0.5 reproduces polynomials of second degree.
  const auto f = [](double x, double y) { return 3 + x - 0.5 * x * x + 0.25 * x * y + y * y; };
  std::vector<double> heights;
  for (int r = 0; r < 6; ++r) {
    for (int c = 0; c < 6; ++c) heights.push_back(f(c + 0.5, r + 0.5));
  }
  bool uncertain = false;
  CellWindow w = window_of(6, heights);
  EXPECT_NEAR(interpolate_cells(w, 3.2, 2.9, true, uncertain), f(3.2, 2.9), 1e-12);
  EXPECT_NEAR(interpolate_cells(w, 1.2, 2.9, true, uncertain), interpolate_cells(w, 1.2, 2.9, false, uncertain), 1e-12)
      << "one of sixteen is outside";
  EXPECT_FALSE(uncertain);
  EXPECT_GT(std::abs(interpolate_cells(w, 3.2, 2.9, false, uncertain) - f(3.2, 2.9)), 1e-3);
  w.heights_m[7] = NAN;
  EXPECT_NEAR(interpolate_cells(w, 2.9, 2.9, true, uncertain), interpolate_cells(w, 2.9, 2.9, false, uncertain), 1e-12);
  EXPECT_FALSE(uncertain);
  interpolate_cells(w, 3.5 - 1e-9, 2.9, true, uncertain);
  EXPECT_TRUE(uncertain) << "which sixteen hangs on the last bit";
}

TEST(FirstLongitude, IsBehindTheWidestGap) {
  double gap = 0;
  EXPECT_EQ(first_longitude({10, 12, 11.5}, &gap), 10);
  EXPECT_NEAR(gap, 358, 0.2);
  EXPECT_EQ(first_longitude({-179, 178, 179.5, -178}, &gap), 178);
  EXPECT_NEAR(gap, 356, 0.2);
  EXPECT_EQ(first_longitude({190, 200}, &gap), -170);
}

}  // namespace
}  // namespace tind::client
