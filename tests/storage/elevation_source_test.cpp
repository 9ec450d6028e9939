// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/elevation_source.hpp"

#include <cmath>
#include <filesystem>
#include <fstream>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/storage/test_raster.hpp"

namespace tind::test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class ElevationSourceTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-source-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }

  std::string degrees(const std::string& name = "degrees.tif", double west = 10, float height_m = 250) const {
    RasterPlan plan;
    plan.geotransform = {west, 0.001, 0, 45, 0, -0.001};
    plan.crs = "EPSG:4326";
    plan.nodata = -9999;
    plan.height = [=](double x, double y) {
      return std::abs(x - west - 0.0205) < 1e-6 && std::abs(y - 44.9845) < 1e-6 ? -9999 : height_m;
    };
    write_raster(path(name), plan);
    return path(name);
  }
  std::string metres() const {
    RasterPlan plan;
    plan.geotransform = {400000, 30, 0, 3800000, 0, -30};
    plan.crs = "EPSG:32611";
    plan.height = [](double, double) { return 250.0f; };
    write_raster(path("metres.tif"), plan);
    return path("metres.tif");
  }
  /// 20 x 20 points 1e-4 degrees apart and one of them twice, the second time higher.
  std::string points() const {
    std::ofstream out(path("points.csv"));
    out << "lon,lat,height\n";
    for (int row = 0; row < 20; ++row) {
      for (int column = 0; column < 20; ++column)
        out << fmt::format("{:.7f},{:.7f},250\n", 10 + column * 1e-4, 45 + row * 1e-4);
    }
    out << "10.0005,45.0005,300\n";
    return path("points.csv");
  }
  static Result<ElevationSource> open(std::vector<std::string> inputs) {
    SourceOptions options;
    options.inputs = std::move(inputs);
    return ElevationSource::open(options);
  }
  Result<void> load(ElevationSource& source) const {
    Lattice lattice;
    lattice.level = 16;
    lattice.height_exponent = 4;
    return source.load(lattice, -5, 10, folder_.string(), 2, [](double) {});
  }

  fs::path folder_;
};

TEST_F(ElevationSourceTest, PostsInDegreesAreTakenAsTheyAre) {
  auto source = open({degrees()});
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_FALSE(source->has_points());
  ASSERT_NE(source->raster(), nullptr);
  EXPECT_FALSE(source->own_spacing_m()) << "degrees only";
  EXPECT_NEAR(source->lon_spacing_deg(), 0.001, 1e-12);
  const auto [west, south, east, north] = source->bounds_deg();
  EXPECT_NEAR(west, 10.0005, 1e-9) << "a post is a cell's centre";
  EXPECT_NEAR(north, 44.9995, 1e-9);
  EXPECT_NEAR(east, 10.0395, 1e-9);
  EXPECT_NEAR(south, 44.9705, 1e-9);
  ASSERT_TRUE(load(*source));
  EXPECT_EQ(source->counts().source, 40u * 30 - 1);
  EXPECT_EQ(source->counts().filled, 1u);
  EXPECT_GT(source->counts().falloff, 40u * 10 * 2);
  EXPECT_EQ(source->counts().interpolated, 0u);
  EXPECT_EQ(source->field().base_height_m, -5);
  Manifest m;
  source->describe(m);
  EXPECT_EQ(m.source_kind, "raster");
  EXPECT_EQ(m.resampling, "none");
  EXPECT_EQ(m.n_source_posts, 40u * 30 - 1);
  EXPECT_EQ(m.n_filled_posts, 1u);
  EXPECT_EQ(m.n_falloff_posts, source->counts().falloff);
  ASSERT_EQ(m.sources.size(), 1u);
  EXPECT_EQ(m.sources[0].name, "degrees.tif");
  EXPECT_EQ(m.sources[0].n_cols, 40);
  EXPECT_EQ(m.sources[0].sha256.size(), 64u);
  EXPECT_EQ(m.sources[0].operation, "");
  EXPECT_EQ(m.bounds_deg, source->bounds_deg());
}

TEST_F(ElevationSourceTest, ProjectedRasterIsWarpedAndKeepsItsMetres) {
  auto source = open({metres()});
  ASSERT_TRUE(source) << source.error().message;
  ASSERT_TRUE(source->own_spacing_m());
  EXPECT_NEAR(*source->own_spacing_m(), 30, 0.1);
  EXPECT_LE(source->lat_spacing_deg() * 110'900, 30) << "no coarser than the cells";
  ASSERT_TRUE(load(*source));
  EXPECT_GT(source->counts().source, 900u);
  Manifest m;
  source->describe(m);
  EXPECT_EQ(m.source_kind, "warped");
  EXPECT_EQ(m.resampling, "bilinear");
  EXPECT_THAT(m.sources.at(0).crs, HasSubstr("32611"));
  EXPECT_THAT(m.sources.at(0).operation, HasSubstr("utm"));
}

TEST_F(ElevationSourceTest, PointsAreKeptAtTheirOwnPositions) {
  auto source = open({points()});
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_TRUE(source->has_points());
  EXPECT_EQ(source->raster(), nullptr);
  ASSERT_TRUE(source->own_spacing_m());
  EXPECT_GT(*source->own_spacing_m(), 6) << "1e-4 degrees are 11 m and 7.9 m";
  EXPECT_LT(*source->own_spacing_m(), 14);
  const auto [west, south, east, north] = source->bounds_deg();
  EXPECT_NEAR(west, 10, 1e-9);
  EXPECT_NEAR(north, 45.0019, 1e-9);
  ASSERT_TRUE(load(*source));
  EXPECT_EQ(source->counts().source, 400u);
  EXPECT_EQ(source->counts().duplicates, 1u);
  EXPECT_GT(source->counts().interpolated, 50u);
  EXPECT_FALSE(source->field().points.empty());
  Manifest m;
  source->describe(m);
  EXPECT_EQ(m.source_kind, "points");
  EXPECT_EQ(m.n_source_posts, 400u);
  EXPECT_EQ(m.sources.at(0).n_points, 401u);
  EXPECT_EQ(m.sources.at(0).n_cols, 0);
}

TEST_F(ElevationSourceTest, OverlapsAreMergedAndTheirDisagreementIsKnown) {
  auto source = open({degrees("a.tif"), degrees("b.tif", 10.02, 252)});
  ASSERT_TRUE(source) << source.error().message;
  ASSERT_TRUE(load(*source));
  EXPECT_EQ(source->counts().overlapping, 20u * 30 - 1);
  EXPECT_EQ(source->counts().disagreeing, 20u * 30 - 1);
  Manifest m;
  source->describe(m);
  EXPECT_EQ(m.disagreement_m, 1);
  EXPECT_EQ(m.sources.size(), 2u);
}

TEST_F(ElevationSourceTest, KindsDoNotMix) {
  for (const auto& inputs : {std::vector{degrees(), points()}, std::vector{points(), degrees()}}) {
    const auto source = open(inputs);
    ASSERT_FALSE(source);
    EXPECT_EQ(source.error().kind, ErrorKind::kInvalidInput);
    EXPECT_THAT(source.error().message, HasSubstr("points.csv"));
    EXPECT_THAT(source.error().message, HasSubstr("degrees.tif"));
  }
}

TEST_F(ElevationSourceTest, MissingInputsAreNamed) {
  for (const char* name : {"nowhere.tif", "nowhere.las", "nowhere.csv"}) {
    const auto source = open({path(name)});
    ASSERT_FALSE(source);
    EXPECT_THAT(source.error().message, HasSubstr(name));
  }
}

}  // namespace
}  // namespace tind::test
