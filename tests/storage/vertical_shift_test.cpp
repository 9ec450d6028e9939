// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/vertical_shift.hpp"

#include <bit>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "storage/readers/gdal_raster.hpp"
#include "storage/readers/height_grid.hpp"
#include "tests/storage/test_raster.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr char kEgm96[] = "/usr/share/proj/egm96_15.gtx";

template <class T>
void put_big_endian(std::string& out, T value) {
  const auto bits = std::bit_cast<std::conditional_t<sizeof(T) == 8, std::uint64_t, std::uint32_t>>(value);
  for (int k = static_cast<int>(sizeof(T)) - 1; k >= 0; --k) out += static_cast<char>(bits >> (8 * k));
}

class VerticalShiftTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-vertical-shift-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { fs::remove_all(folder_); }

  static double geoid_plane(double lon, double lat) { return -30 + 2 * (lon + 118) - 3 * (lat - 34); }

  /// NOAA's .gtx, byte by byte: corner and spacing in degrees, size, then rows from the south; all big-endian.
  std::string write_gtx(const std::string& name, double west, double south, double spacing, int n_cols,
                        int n_rows) const {
    std::string bytes;
    for (const double v : {south, west, spacing, spacing}) put_big_endian(bytes, v);
    for (const std::int32_t v : {n_rows, n_cols}) put_big_endian(bytes, v);
    for (int r = 0; r < n_rows; ++r) {
      for (int c = 0; c < n_cols; ++c)
        put_big_endian(bytes, static_cast<float>(geoid_plane(west + c * spacing, south + r * spacing)));
    }
    const std::string path = (folder_ / name).string();
    std::ofstream(path, std::ios::binary) << bytes;
    return path;
  }
  std::string write_raster(const std::string& name, const std::string& crs = "EPSG:32611") const {
    test::RasterPlan plan;
    plan.geotransform = {400000, 30, 0, 3800000, 0, -30};
    if (crs.find("32611") == std::string::npos && crs.find("26911") == std::string::npos)
      plan.geotransform = {-118, 0.001, 0, 34.3, 0, -0.001};
    plan.crs = crs;
    plan.height = [](double, double) { return 1000.0f; };
    const std::string path = (folder_ / name).string();
    test::write_raster(path, plan);
    return path;
  }
  static std::string message(const std::string& vertical_datum, const std::string& geoid) {
    auto shift = VerticalShift::create(vertical_datum, geoid);
    if (!shift) return shift.error().message;
    if (auto settled = shift->settle({-118, 34}); !settled) return settled.error().message;
    return "";
  }

  fs::path folder_;
};

TEST_F(VerticalShiftTest, GridOfOnesOwnIsAddedAtEveryPost) {
  RasterOptions options;
  options.geoid = write_gtx("n plane.gtx", -119, 33, 0.25, 9, 9);
  for (const char* crs : {"EPSG:32611", "EPSG:4326"}) {
    const auto mosaic = RasterMosaic::open({write_raster("a.tif", crs)}, options);
    ASSERT_TRUE(mosaic) << mosaic.error().message;
    EXPECT_EQ(mosaic->height_kind, "ellipsoidal");
    EXPECT_EQ(mosaic->vertical_datum, "WGS 84 ellipsoid, from heights above n plane.gtx");
    EXPECT_THAT(mosaic->vertical_operation, HasSubstr("+proj=vgridshift"));
    std::vector<float> heights;
    std::uint64_t n_implausible = 0;
    int n = 0;
    ASSERT_TRUE(mosaic->read_rows(0, 0, mosaic->n_rows, heights, n_implausible));
    for (std::int64_t r = 0; r < mosaic->n_rows; ++r) {
      for (std::int64_t c = 0; c < mosaic->n_cols; ++c) {
        const float h = heights[static_cast<std::size_t>(r * mosaic->n_cols + c)];
        if (std::isnan(h)) continue;
        const double lon = mosaic->west_deg + static_cast<double>(c) * mosaic->lon_spacing_deg;
        const double lat = mosaic->south_deg + static_cast<double>(r) * mosaic->lat_spacing_deg;
        ASSERT_NEAR(h, 1000 + geoid_plane(lon, lat), 1e-3);
        ++n;
      }
    }
    EXPECT_GT(n, 1000);
    NativePosts native;
    ASSERT_TRUE(mosaic->read_native_rows(0, 3, 5, native));
    for (std::size_t i = 0; i < native.heights_m.size(); ++i)
      ASSERT_NEAR(native.heights_m[i], 1000 + geoid_plane(native.lon_deg[i], native.lat_deg[i]), 1e-3);
  }
}

TEST_F(VerticalShiftTest, Egm96AtThePublishedTestPoints) {
  // INPUT.DAT and OUTF477.DAT of NGA's harmonic synthesis program; the 15' grid, bilinear, comes to within 0.1 m.
  struct Point {
    double lat, lon, geoid_m;
  };
  if (!fs::exists(kEgm96)) GTEST_SKIP() << "needs " << kEgm96;
  for (const char* datum : {"EPSG:5773", "EGM96 height", "EPSG:4326+5773"}) {
    for (const bool as_geoid : {false, true}) {
      auto shift = VerticalShift::create(datum, as_geoid ? kEgm96 : "");
      ASSERT_TRUE(shift) << shift.error().message;
      ASSERT_TRUE(shift->settle({0, 0}));
      EXPECT_EQ(shift->datum(), "EGM96 height");
      for (const Point& p : {Point{38.628155, -90.220845, -31.628}, Point{-14.621217, -54.978886, -2.969},
                             Point{46.874319, 102.448729, -43.575}, Point{-23.617446, 133.874712, 15.871},
                             Point{38.625473, -0.0005, 50.066}, Point{-0.466744, 0.0023, 17.329}}) {
        const std::array<Place, 2> places{Place{p.lon, p.lat}, Place{p.lon, p.lat}};
        std::array<float, 2> heights{100, test::kNoHeight};
        ASSERT_TRUE(shift->apply(places, heights.data()));
        EXPECT_NEAR(heights[0], 100 + p.geoid_m, 0.1) << p.lat << ' ' << p.lon;
        EXPECT_TRUE(std::isnan(heights[1]));
      }
    }
  }
}

TEST_F(VerticalShiftTest, DatumInFeetGivesTheUnitOfTheFile) {
  const auto shift = VerticalShift::create("EPSG:6360", "");
  ASSERT_TRUE(shift) << shift.error().message;
  EXPECT_NEAR(shift->unit_m(), 1200.0 / 3937, 1e-12);
  // With a grid of one's own the heights are metres when it is added.
  RasterOptions options;
  options.vertical_datum = "EPSG:6360";
  options.geoid = write_gtx("n.gtx", -119, 33, 0.25, 9, 9);
  const auto mosaic = RasterMosaic::open({write_raster("a.tif")}, options);
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  NativePosts native;
  ASSERT_TRUE(mosaic->read_native_rows(0, 0, 1, native));
  EXPECT_NEAR(native.heights_m[0], 1000 * 1200.0 / 3937 + geoid_plane(native.lon_deg[0], native.lat_deg[0]), 1e-3);
}

TEST_F(VerticalShiftTest, EllipsoidalInputStaysAsItIs) {
  RasterOptions options;
  options.vertical_datum = "EPSG:4979";
  const auto mosaic = RasterMosaic::open({write_raster("a.tif")}, options);
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  EXPECT_EQ(mosaic->height_kind, "ellipsoidal");
  EXPECT_EQ(mosaic->vertical_operation, "");
  NativePosts native;
  ASSERT_TRUE(mosaic->read_native_rows(0, 0, 1, native));
  EXPECT_EQ(native.heights_m[0], 1000);
}

TEST_F(VerticalShiftTest, WithoutOptionsHeightsStayAndTheDatumIsNamed) {
  const auto plain = RasterMosaic::open({write_raster("a.tif")}, {});
  ASSERT_TRUE(plain);
  EXPECT_EQ(plain->height_kind, "unknown");
  const auto compound = RasterMosaic::open({write_raster("b.tif", "EPSG:32611+5773")}, {});
  ASSERT_TRUE(compound);
  EXPECT_EQ(compound->height_kind, "orthometric");
  EXPECT_EQ(compound->vertical_datum, "EGM96 height");
  const auto spatial = RasterMosaic::open({write_raster("c.tif", "EPSG:4979")}, {});
  ASSERT_TRUE(spatial);
  EXPECT_EQ(spatial->height_kind, "ellipsoidal");
  NativePosts native;
  ASSERT_TRUE(compound->read_native_rows(0, 0, 1, native));
  EXPECT_EQ(native.heights_m[0], 1000);
}

TEST_F(VerticalShiftTest, PostsBeyondTheGridAreAnErrorThatNamesThePlace) {
  RasterOptions options;
  options.geoid = write_gtx("small.gtx", -118.092, 34, 0.005, 3, 80);  // ends inside the raster's columns
  const auto mosaic = RasterMosaic::open({write_raster("a.tif")}, options);
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  Lattice lattice;
  lattice.level = 8;
  lattice.height_exponent = 6;
  const auto grid = HeightGrid::load(*mosaic, lattice, {0, 8, folder_.string()}, {});
  ASSERT_FALSE(grid);
  EXPECT_EQ(grid.error().kind, ErrorKind::kInvalidInput);
  EXPECT_THAT(grid.error().message, HasSubstr("no geoid height at longitude -118.0"));
  EXPECT_THAT(grid.error().message, HasSubstr("beyond the grid"));
}

TEST_F(VerticalShiftTest, WhatCannotBeShiftedIsNamed) {
  EXPECT_THAT(message("nonsense", ""), HasSubstr("PROJ knows no such CRS"));
  EXPECT_THAT(message("EPSG:4326", ""), HasSubstr("says nothing of heights"));
  EXPECT_THAT(message("EPSG:5715", ""), HasSubstr("counts depths"));
  EXPECT_THAT(message("EPSG:5711", ""), HasSubstr("PROJ knows no way"));  // Australian heights in California
  EXPECT_THAT(message("", "/none/geoid.gtx"), HasSubstr("/none/geoid.gtx: no such file"));
  EXPECT_THAT(message("", "no_such_grid.gtx"), HasSubstr("no such file"));
  std::ofstream(folder_ / "text.gtx") << "no grid";
  EXPECT_THAT(message("", (folder_ / "text.gtx").string()), HasSubstr("PROJ cannot read it"));
  // Grids that Debian's proj-data does not have: PROJ alone would answer with unchanged heights.
  if (!fs::exists("/usr/share/proj/us_nga_egm08_25.tif")) {
    const std::string text = message("EPSG:3855", "");
    EXPECT_THAT(text, HasSubstr("us_nga_egm08_25.tif"));
    EXPECT_THAT(text, HasSubstr("projsync --file us_nga_egm08_25.tif"));
    EXPECT_THAT(text, HasSubstr("--geoid FILE"));
  }
}

}  // namespace
}  // namespace tind
