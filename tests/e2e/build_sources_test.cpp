// SPDX-License-Identifier: GPL-3.0-or-later
// tind-build and every kind of source: projected rasters, points, vertical datums; what it refuses, in one line.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>

#include "tests/client_checks/las_bytes.hpp"
#include "tests/client_checks/projected_raster.hpp"
#include "tests/client_checks/test_raster.hpp"
#include "tests/e2e/build_program.hpp"

namespace tind::test {
namespace {

using testing::HasSubstr;

constexpr unsigned kPoints = 120 * 120;
constexpr const char* kEgm96 = "/usr/share/proj/egm96_15.gtx";
constexpr const char* kProjDatabase = "/usr/share/proj/proj.db";

double hills(double x, double y) { return 900 + 160 * std::sin(x / 310) * std::cos(y / 270) + 0.03 * (y - 3.8e6); }

class BuildSources : public BuildProgram {
 protected:
  /// 30 m cells of UTM zone 11: more than one tile of the bottom level.
  std::string utm_raster() const {
    ProjectedPlan plan;
    plan.n_columns = 320;
    plan.n_rows = 300;
    plan.height = hills;
    std::string path = folder.file("utm.tif");
    write_projected(path, plan);
    return path;
  }
  /// Points of class 2 in UTM zone 11, 8 m apart but for some centimetres; each seventh is of class 5 and 20 m higher.
  static LasPlan points() {
    LasPlan plan;
    plan.x_offset = 400000;
    plan.y_offset = 3800000;
    plan.records = {shorts_record({1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32611})};
    for (unsigned k = 0; k < kPoints; ++k) {
      const unsigned row = k / 120, column = k % 120;
      const double x = 400000 + 8.0 * column + 0.07 * (k % 13), y = 3800000 + 8.0 * row + 0.05 * (k % 17);
      const bool canopy = k % 7 == 3;
      plan.points.push_back({x, y, hills(x, y) / 10 + (canopy ? 20 : 0), std::uint8_t(canopy ? 5 : 2), false});
    }
    return plan;
  }
  std::string las(const LasPlan& plan, const std::string& name = "ground.las") const {
    write_las(folder.file(name), plan);
    return folder.file(name);
  }
};

TEST_F(BuildSources, ProjectedRasterHoldsWithTheToleranceOfItsOwnMetres) {
  const std::string input = utm_raster();
  expect_build({input});
  const Manifest m = manifest();
  EXPECT_EQ(m.source_kind, "warped");
  EXPECT_EQ(m.resampling, "bilinear");
  EXPECT_NEAR(m.levels.back().tolerance_m, 24, 0.1) << "4/5 of 30 m";
  expect_verified({input});
  expect_build({input}, {"--force", "--resampling", "cubic"});
  EXPECT_EQ(manifest().resampling, "cubic");
  expect_verified({input});
}

TEST_F(BuildSources, ProjectedRasterOfVoidsOnly) {
  ProjectedPlan plan;
  plan.nodata = -7;
  plan.height = [](double, double) { return -7; };
  write_projected(folder.file("voids.tif"), plan);
  expect_refusal(build({folder.file("voids.tif"), "-o", output}), "every post is a void");
}

TEST_F(BuildSources, MetresWithoutACrs) {
  std::string text = "ncols 4\nnrows 4\nxllcorner 400000\nyllcorner 3800000\ncellsize 30\n";
  for (int r = 0; r < 4; ++r) text += "1 2 3 4\n";
  write_file(folder.file("metres.asc"), text);
  expect_refusal(build({folder.file("metres.asc"), "-o", output}), "gdal_translate -a_srs");
}

TEST_F(BuildSources, RastersAndPointsDoNotMix) {
  const Finished finished = build({las(points()), utm_raster(), "-o", output});
  expect_refusal(finished, "one kind");
  EXPECT_THAT(finished.err, HasSubstr("ground.las"));
  EXPECT_THAT(finished.err, HasSubstr("utm.tif"));
}

TEST_F(BuildSources, PointsHoldAtEveryKeptPoint) {
  const std::string input = las(points());
  expect_build({input}, {"--finest", "2"});
  const Manifest m = manifest();
  EXPECT_EQ(m.source_kind, "points");
  ASSERT_EQ(m.sources.size(), 1u);
  EXPECT_EQ(m.n_source_posts, kPoints - kPoints / 7);
  EXPECT_EQ(m.sources[0].n_points, kPoints);
  expect_verified({input});
  expect_build({input}, {"--force", "--class", "2,5", "--finest", "2"});
  EXPECT_EQ(manifest().n_source_posts, kPoints);
  expect_verified({input}, {"--class", "2,5"});
}

TEST_F(BuildSources, TextOfPointsInDegreesHolds) {
  std::string text = "lon,lat,height\n";
  for (int k = 0; k < 100 * 100; ++k) {
    const int r = k / 100, c = k % 100;
    text += std::to_string(11 + 1e-4 * c + 1e-6 * (k % 7)) + "," + std::to_string(46 + 1e-4 * r) + "," +
            std::to_string(700 + 30 * std::sin(c / 4.0) * std::cos(r / 5.0)) + "\n";
  }
  write_file(folder.file("points.csv"), text);
  expect_build({folder.file("points.csv")}, {"--finest", "2"});
  EXPECT_EQ(manifest().n_source_posts, 10000u);
  expect_verified({folder.file("points.csv")});
}

TEST_F(BuildSources, ClassThatIsNoNumberIsWrongUsage) {
  const std::string input = las(points());
  for (const char* classes : {"ground", "2,", "256", "-1", "2;9"}) {
    expect_refusal(build({input, "-o", output, "--class", classes}), "--class", 2);
  }
}

TEST_F(BuildSources, ClassThatNoPointHas) {
  const Finished finished = build({las(points()), "-o", output, "--class", "9"});
  expect_refusal(finished, "there are classes 2");
  EXPECT_THAT(finished.err, HasSubstr("5"));
  EXPECT_THAT(finished.err, HasSubstr("--class"));
}

TEST_F(BuildSources, TruncatedLas) {
  const std::string path = las(points());
  for (const std::uintmax_t size : {std::filesystem::file_size(path) - 1, std::uintmax_t{300}, std::uintmax_t{100},
                                    std::uintmax_t{3}, std::uintmax_t{0}}) {
    std::filesystem::resize_file(path, size);
    expect_refusal(build({path, "-o", output}), "ground.las");
  }
}

TEST_F(BuildSources, LazSaysHowToConvert) {
  auto bytes = las_bytes(points());
  constexpr std::size_t kPointFormatAt = 104;
  bytes[kPointFormatAt] |= 0x80;
  write_file(folder.file("ground.laz"), std::string(bytes.begin(), bytes.end()));
  expect_refusal(build({folder.file("ground.laz"), "-o", output}), "pdal translate");
}

TEST_F(BuildSources, PointsWithoutACrsNeedOneOfTheUser) {
  LasPlan plan = points();
  plan.records.clear();
  const std::string input = las(plan);
  expect_refusal(build({input, "-o", output}), "--source-crs");
  expect_refusal(build({input, "-o", output, "--source-crs", "EPSG:1"}), "EPSG:1");
  expect_build({input}, {"--source-crs", "EPSG:32611", "--finest", "2"});
  expect_verified({input}, {"--source-crs", "EPSG:32611"});
}

TEST_F(BuildSources, OrthometricHeightsBecomeEllipsoidal) {
  if (!std::filesystem::exists(kEgm96)) GTEST_SKIP() << kEgm96 << " is not on this machine: no datum was tried";
  RasterPlan plan;
  plan.west_deg = -118;
  plan.north_deg = 36;
  write_raster(folder.file("srtm.tif"), plan);
  expect_build({folder.file("srtm.tif")}, {"--vertical-datum", "EPSG:5773", "--finest", "200"});
  Manifest m = manifest();
  EXPECT_EQ(m.heights, "ellipsoidal");
  EXPECT_THAT(m.vertical_operation, HasSubstr("egm96_15"));
  expect_verified({folder.file("srtm.tif")}, {"--vertical-datum", "EPSG:5773"});
  // Without the datum the same heights are some 30 m off: the check can tell.
  const Daemon daemon({output});
  const Finished plain = run_program(
      "tind-verify", {daemon.url() + "/out", "--cuts", "1", "--quiet", "--source", folder.file("srtm.tif")});
  EXPECT_NE(plain.status, 0) << plain.out;

  expect_build({folder.file("srtm.tif")}, {"--force", "--geoid", kEgm96, "--finest", "200"});
  m = manifest();
  EXPECT_EQ(m.heights, "ellipsoidal");
  expect_verified({folder.file("srtm.tif")}, {"--geoid", kEgm96});
}

TEST_F(BuildSources, DatumWhoseGridIsNotInstalled) {
  if (!std::filesystem::exists(kProjDatabase)) GTEST_SKIP() << kProjDatabase << " is not on this machine";
  const std::string proj = folder.file("proj");
  std::filesystem::create_directory(proj);
  std::filesystem::create_symlink(kProjDatabase, proj + "/proj.db");
  const auto no_grids = [&] {
    setenv("PROJ_DATA", proj.c_str(), 1);
    setenv("PROJ_LIB", proj.c_str(), 1);
    setenv("PROJ_NETWORK", "OFF", 1);
  };
  const std::string input = utm_raster();
  const Finished finished = build({input, "-o", output, "--vertical-datum", "EPSG:5773"}, no_grids);
  expect_refusal(finished, "projsync");
  EXPECT_THAT(finished.err, HasSubstr("EPSG:5773"));
  EXPECT_THAT(finished.err, HasSubstr("--geoid"));
  EXPECT_EQ(build({input, "-o", output}, no_grids).status, 0) << "the rest of PROJ is there";
}

TEST_F(BuildSources, DatumThatIsNone) {
  const std::string input = utm_raster();
  expect_refusal(build({input, "-o", output, "--vertical-datum", "EPSG:4326x"}), "EPSG:5773");
  expect_refusal(build({input, "-o", output, "--vertical-datum", "EPSG:32611"}), "says nothing of heights");
}

TEST_F(BuildSources, GeoidFileThatIsNotThereOrNoGrid) {
  const std::string input = utm_raster();
  expect_refusal(build({input, "-o", output, "--geoid", folder.file("nowhere.gtx")}), "nowhere.gtx");
  write_file(folder.file("text.gtx"), "this is no grid\n");
  expect_refusal(build({input, "-o", output, "--geoid", folder.file("text.gtx")}), "text.gtx");
  EXPECT_EQ(build({input, "-o", output, "--geoid", folder.file("text.gtx"), "--vertical-datum", "EPSG:5773"}).status, 2)
      << "one of them";
}

}  // namespace
}  // namespace tind::test
