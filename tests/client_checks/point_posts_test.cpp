// SPDX-License-Identifier: GPL-3.0-or-later
// Points as the client reads and keeps them, and heights that a geoid lifts.
#include <gdal_priv.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <ogr_spatialref.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>

#include "tests/client/post_scan.hpp"
#include "tests/client/source_posts.hpp"
#include "tests/client/xyz_points.hpp"
#include "tests/client_checks/las_bytes.hpp"
#include "tests/client_checks/projected_raster.hpp"

namespace tind::client {
namespace {

using test::LasPlan;
using testing::ElementsAre;
using testing::HasSubstr;

TEST(XyzPoints, ColumnsAreKnownByTheirNamesOrTheirOrder) {
  for (const char* text : {"1 2 3\n4 5 6\n", "1\t2\t3\r\n\r\n  4   5 6", "x,y,z\n1,2,3\n4,5,6\n",
                           "# a remark\nid;Elevation;Northing;Easting\n9;3;2;1\n9;6;5;4\n",
                           "\xef\xbb\xbf\"lat\",\"lon\",\"h\"\n2,1,3\n5,4,6", "+1,2.0e0,3,extra\n4,5,6,7\n"}) {
    const auto points = read_xyz(text);
    ASSERT_TRUE(points.has_value()) << text << points.error();
    EXPECT_THAT(points->x, ElementsAre(1, 4)) << text;
    EXPECT_THAT(points->y, ElementsAre(2, 5)) << text;
    EXPECT_THAT(points->z, ElementsAre(3, 6)) << text;
  }
}

TEST(XyzPoints, RefusesNamingTheLine) {
  EXPECT_THAT(read_xyz("1 2 3\n4 5\n").error(), HasSubstr("line 2: column 3"));
  EXPECT_THAT(read_xyz("1,2,3\n\n4,five,6\n").error(), HasSubstr("line 3: column 2"));
  EXPECT_THAT(read_xyz("a,b,c\n1,2,3\n").error(), HasSubstr("line 1"));
  EXPECT_THAT(read_xyz("1 2 3x\n").error(), HasSubstr("line 1: column 3"));
  EXPECT_TRUE(read_xyz("")->x.empty());
}

class PointFiles : public testing::Test {
 protected:
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("tind-client-points-" + std::to_string(getpid()));
  GridClaim claim;

  void SetUp() override {
    std::filesystem::create_directories(folder);
    claim.frame = {10, 4};  // one step is 180 / 2^26 degrees
  }
  void TearDown() override { std::filesystem::remove_all(folder); }
  std::string text_file(const std::string& name, const std::string& text) {
    std::ofstream(folder / name) << text;
    return (folder / name).string();
  }
  std::string las_file(const std::string& name, const LasPlan& plan) {
    test::write_las((folder / name).string(), plan);
    return (folder / name).string();
  }
  /// A file with one point of class 2 near (400000, 3800000).
  static LasPlan one_point() {
    LasPlan plan;
    plan.x_offset = 400000;
    plan.y_offset = 3800000;
    plan.points = {{400100, 3800200, 50, 2, false}};
    return plan;
  }
};

TEST_F(PointFiles, TheLowestOfThoseThatRoundToOnePositionIsKept) {
  const double step = claim.frame.step_deg();
  std::string text = "lon,lat,z\n";
  const auto add = [&](double x, double y, double z) {
    char line[120];
    std::snprintf(line, sizeof line, "%.17g,%.17g,%g\n", -180 + x * step, -90 + y * step, z);
    text += line;
  };
  add(40000000.2, 30000000.1, 7);
  add(40000000.4, 29999999.9, 5);
  add(39999999.7, 30000000.3, 6);
  add(40000001.2, 30000000.1, 9);  // the next position
  const auto posts = read_source_posts({text_file("dup.csv", text)}, {}, claim);
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_EQ(posts->kind, SourceKind::kPoints);
  EXPECT_EQ(posts->n_posts, 2u);
  EXPECT_THAT(posts->heights_m, testing::UnorderedElementsAre(5, 9));
  const std::size_t lowest = posts->heights_m[0] == 5 ? 0 : 1;
  EXPECT_NEAR((posts->longitudes_deg[lowest] + 180) / step, 40000000.4, 1e-6)
      << "at its real place, not the rounded one";
  EXPECT_TRUE(posts->either.empty());
  ASSERT_EQ(posts->notes.size(), 1u);
  EXPECT_THAT(posts->notes[0], HasSubstr("4 points 2"));
}

TEST_F(PointFiles, WhatTheLastBitDecidesIsUncertain) {
  const double step = claim.frame.step_deg();
  std::string text;
  char line[120];
  for (const double x : {40000000.1, 40000000.5 + 1e-6}) {
    std::snprintf(line, sizeof line, "%.17g %.17g 1\n", -180 + x * step, -90 + 30000000 * step);
    text += line;
  }
  const auto posts = read_source_posts({text_file("edge.xyz", text)}, {}, claim);
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_EQ(posts->heights_m.size(), 2u);
  EXPECT_EQ(posts->either.size(), 2u) << "one step less, and they would be one";
}

TEST_F(PointFiles, LasInFeetWithKeysOrWktLandsWhereProjSays) {
  LasPlan plan = one_point();
  plan.x_offset = 650000;
  plan.y_offset = 860000;
  plan.points = {{650123.5, 860456.25, 1000, 2, false}, {650223.5, 860456.25, 1000, 1, false}};
  OGRSpatialReference oregon;
  ASSERT_EQ(oregon.importFromEPSG(2992), OGRERR_NONE);
  char* wkt = nullptr;
  oregon.exportToWkt(&wkt);
  const std::string text = wkt;
  CPLFree(wkt);
  const auto expected = [&](const SourcePosts& posts, double unit_m) {
    ASSERT_EQ(posts.n_posts, 1u);
    const auto back = test::project("EPSG:2992", posts.longitude_of(0), posts.latitude_of(0));
    EXPECT_NEAR(back[0], 650123.5, 1e-4);
    EXPECT_NEAR(back[1], 860456.25, 1e-4);
    EXPECT_NEAR(posts.heights_m[0], 1000 * unit_m, 1e-3);
  };
  plan.records = {test::text_record(2112, text)};
  const auto by_wkt = read_source_posts({las_file("wkt.las", plan)}, {}, claim);
  ASSERT_TRUE(by_wkt.has_value()) << by_wkt.error();
  expected(*by_wkt, 0.3048);
  plan.records = {test::shorts_record({1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 2992})};
  const auto by_keys = read_source_posts({las_file("keys.las", plan)}, {}, claim);
  ASSERT_TRUE(by_keys.has_value()) << by_keys.error();
  expected(*by_keys, 0.3048);
  plan.records = {test::shorts_record({1, 1, 0, 3, 1024, 0, 1, 1, 3072, 0, 1, 2992, 4099, 0, 1, 9001})};
  const auto metres_up = read_source_posts({las_file("metres.las", plan)}, {}, claim);
  ASSERT_TRUE(metres_up.has_value()) << metres_up.error();
  expected(*metres_up, 1);
  plan.records = {test::shorts_record({1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 2992}), test::text_record(2112, text)};
  test::poke(plan.records[0].data, 22, std::uint16_t{32611});
  const auto both = read_source_posts({las_file("both.las", plan)}, {}, claim);
  ASSERT_TRUE(both.has_value()) << both.error();
  expected(*both, 0.3048);
  SourceOptions options;
  options.metres_per_unit = 2;
  const auto told = read_source_posts({las_file("told.las", plan)}, options, claim);
  ASSERT_TRUE(told.has_value());
  expected(*told, 2);
}

TEST_F(PointFiles, RefusalsNameTheFileAndWhatToDo) {
  EXPECT_THAT(read_source_posts({las_file("nocrs.las", one_point())}, {}, claim).error(),
              HasSubstr("nocrs.las: names no coordinate system"));
  SourceOptions options;
  options.source_crs = "EPSG:32611";
  options.classes = std::vector<int>{9};
  EXPECT_THAT(read_source_posts({las_file("noclass.las", one_point())}, options, claim).error(),
              HasSubstr("classes found: 2 (1)"));
  EXPECT_THAT(read_source_posts({text_file("far.xyz", "500000 4000000 3\n")}, {}, claim).error(),
              HasSubstr("--source-crs"));
  EXPECT_THAT(read_source_posts({(folder / "absent.las").string()}, {}, claim).error(), HasSubstr("absent.las"));
  EXPECT_THAT(read_source_posts({text_file("a.csv", "1,1,1\n"), "b.tif"}, {}, claim).error(), HasSubstr("one kind"));
  options.classes.reset();
  const auto all = read_source_posts({las_file("all.las", one_point())}, options, claim);
  ASSERT_TRUE(all.has_value()) << all.error();
  EXPECT_EQ(all->n_posts, 1u);
}

TEST_F(PointFiles, ScansFindThePointsThatAPlainTestFinds) {
  // Points around longitude 180; tiles on both sides of it; random triangles against barycentric coordinates.
  std::mt19937 random(5);
  std::uniform_real_distribution<double> lon(178.5, 181.5), lat(40, 42);
  std::string text;
  for (int k = 0; k < 3000; ++k) text += std::to_string(lon(random)) + " " + std::to_string(lat(random)) + " 1\n";
  const auto posts = read_source_posts({text_file("around.xyz", text)}, {}, claim);
  ASSERT_TRUE(posts.has_value()) << posts.error();
  std::size_t in_tiles = 0;
  for (const TileId& id :
       {TileId{7, 255, 92}, TileId{7, 0, 92}, TileId{7, 255, 93}, TileId{7, 0, 93}, TileId{7, 254, 92}}) {
    const TilePosts tile(*posts, claim.frame, id);
    const double side = static_cast<double>(claim.frame.side(id.level)), degrees = 180.0 / 128;
    std::size_t expected = 0;
    for (std::size_t k = 0; k < posts->heights_m.size(); ++k) {
      const double x = (posts->longitudes_deg[k] + 180) / degrees, y = (posts->latitudes_deg[k] + 90) / degrees;
      const double dx = x - id.x - 256 * std::floor((x - id.x) / 256);
      if (dx <= 1 && y >= id.y && y <= id.y + 1) ++expected;
    }
    EXPECT_EQ(tile.size(), expected) << id.text();
    in_tiles += tile.size();
    std::uniform_real_distribution<double> inside(0, side);
    for (int n = 0; n < 40; ++n) {
      std::array<SurfacePoint, 3> p;
      for (auto& corner : p) corner = {inside(random), inside(random), 0};
      const auto plane = [](double x, double y) { return 5 + 1e-3 * x - 2e-3 * y; };
      for (auto& corner : p) corner.z_m = plane(corner.x, corner.y);
      std::vector<int> seen(tile.size(), 0);
      tile.scan(p, [&](std::size_t slot, double z) {
        ++seen[slot];
        const auto at = tile.place(slot);
        EXPECT_NEAR(z, plane(at.x, at.y), 1e-4);
      });
      for (std::size_t slot = 0; slot < tile.size(); ++slot) {
        const auto q = tile.place(slot);
        const auto turn = [&](int a, int b) {
          const auto &u = p[static_cast<std::size_t>(a)], &v = p[static_cast<std::size_t>(b)];
          return (v.x - u.x) * (q.y - u.y) - (v.y - u.y) * (q.x - u.x);
        };
        const double a = turn(0, 1), b = turn(1, 2), c = turn(2, 0);
        const bool within = (a >= 0 && b >= 0 && c >= 0) || (a <= 0 && b <= 0 && c <= 0);
        ASSERT_EQ(seen[slot], within ? 1 : 0) << id.text();
      }
    }
  }
  EXPECT_GT(in_tiles, 2000u);
}

/// A grid of N = 30 + 0.5 * lon + 0.25 * lat over 0..20 east, 40..50 north.
std::string write_geoid(const std::filesystem::path& path) {
  GDALAllRegister();
  GDALDataset* grid =
      GetGDALDriverManager()->GetDriverByName("GTX")->Create(path.c_str(), 21, 11, 1, GDT_Float32, nullptr);
  double t[6] = {-0.5, 1, 0, 50.5, 0, -1};
  grid->SetGeoTransform(t);
  for (int r = 0; r < 11; ++r) {
    std::vector<float> row;
    for (int c = 0; c < 21; ++c) row.push_back(static_cast<float>(30 + 0.5 * c + 0.25 * (50 - r)));
    EXPECT_EQ(grid->GetRasterBand(1)->RasterIO(GF_Write, 0, r, 21, 1, row.data(), 21, 1, GDT_Float32, 0, 0), CE_None);
  }
  GDALClose(grid);
  return path.string();
}

TEST_F(PointFiles, AGeoidGridLiftsPointsAndRasters) {
  SourceOptions options;
  options.geoid = write_geoid(folder / "n.gtx");
  const auto points = read_source_posts({text_file("p.csv", "12.25,44.5,100\n3.5,48.75,-20\n")}, options, claim);
  ASSERT_TRUE(points.has_value()) << points.error();
  ASSERT_EQ(points->heights_m.size(), 2u);
  for (std::size_t k = 0; k < 2; ++k) {
    const double n = 30 + 0.5 * points->longitudes_deg[k] + 0.25 * points->latitudes_deg[k];
    EXPECT_NEAR(points->heights_m[k], (points->latitudes_deg[k] < 45 ? 100 : -20) + n, 1e-3);
  }
  test::ProjectedPlan plan;
  plan.crs = "EPSG:4326";
  plan.transform = {10, 0.1, 0, 46, 0, -0.1};
  plan.n_columns = 20;
  plan.n_rows = 10;
  plan.height = [](double, double) { return 1000; };
  test::write_projected("/vsimem/lifted.tif", plan);
  const auto raster = read_source_posts({"/vsimem/lifted.tif"}, options, claim);
  ASSERT_TRUE(raster.has_value()) << raster.error();
  for (std::size_t k = 0; k < raster->heights_m.size(); ++k) {
    const auto at = static_cast<std::int64_t>(k);
    ASSERT_NEAR(raster->heights_m[k], 1030 + 0.5 * raster->longitude_of(at) + 0.25 * raster->latitude_of(at), 1e-3);
  }
}

TEST_F(PointFiles, AGeoidThatIsNotThereIsNeverPassedOver) {
  SourceOptions options;
  options.geoid = (folder / "absent.gtx").string();
  const std::string point = text_file("p.csv", "12.25,44.5,100\n"), far = text_file("far.csv", "112.25,4.5,100\n");
  EXPECT_THAT(read_source_posts({point}, options, claim).error(), HasSubstr("no such geoid grid"));
  options.geoid = text_file("junk.gtx", "this is no grid of anything, just some text that is long enough for a header");
  EXPECT_THAT(read_source_posts({point}, options, claim).error(), HasSubstr("junk.gtx"));
  options.geoid = write_geoid(folder / "n.gtx");
  EXPECT_THAT(read_source_posts({far}, options, claim).error(), HasSubstr("longitude 112.25"));
  options.geoid.clear();
  options.vertical_datum = "EPSG:32611";
  EXPECT_THAT(read_source_posts({point}, options, claim).error(), HasSubstr("no vertical system"));
  options.vertical_datum = "EPSG:9000000";
  EXPECT_THAT(read_source_posts({point}, options, claim).error(), HasSubstr("EPSG:9000000"));
  options.vertical_datum = "EPSG:5621";  // EVRF2007: no grid of it is in Debian
  EXPECT_THAT(read_source_posts({point}, options, claim).error(), HasSubstr("grid"));
}

TEST_F(PointFiles, EllipsoidalHeightsStayAsTheyAre) {
  const std::string point = text_file("p.csv", "12.25,44.5,100\n");
  SourceOptions options;
  options.vertical_datum = "EPSG:4979";
  const auto same = read_source_posts({point}, options, claim);
  ASSERT_TRUE(same.has_value()) << same.error();
  EXPECT_EQ(same->heights_m[0], 100);
}

TEST_F(PointFiles, Egm96IsKnownByItsNumber) {
  // NGA's test values of the WGS 84 EGM96 15-minute geoid: N(38.6281550, 269.7791550) = -31.628, N(-14.6212170,
  // 305.0211140) = -2.969.
  SourceOptions options;
  options.vertical_datum = "EPSG:5773";
  const auto posts = read_source_posts({text_file("nga.csv", "269.7791550,38.6281550,0\n305.0211140,-14.6212170,0\n")},
                                       options, claim);
  if (!posts) GTEST_SKIP() << posts.error();
  ASSERT_EQ(posts->heights_m.size(), 2u);
  for (std::size_t k = 0; k < 2; ++k)
    EXPECT_NEAR(posts->heights_m[k], posts->latitudes_deg[k] > 0 ? -31.628 : -2.969, 0.02);
}

}  // namespace
}  // namespace tind::client
