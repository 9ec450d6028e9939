// SPDX-License-Identifier: GPL-3.0-or-later
// Rules of docs/decisions/0005-warped-posts.md one by one, and what cannot be warped.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <numbers>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "storage/readers/raster_warper.hpp"
#include "tests/storage/warped_fixture.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;
using test::CrsProbe;
using test::RasterPlan;
using test::WarpedRasterTest;
using ::testing::HasSubstr;

/// A UTM raster, 30 m cells, whose corner is at (400000, 3800000).
RasterPlan utm_plan(std::function<float(double, double)> height) {
  RasterPlan plan;
  plan.geotransform = {400000, 30, 0, 3800000, 0, -30};
  plan.crs = "EPSG:32611";
  plan.height = std::move(height);
  return plan;
}

TEST_F(WarpedRasterTest, TiePointIsACornerForAreasAndACentreForPoints) {
  // Two files made byte by byte: values equal the coordinate of the place they stand for.
  constexpr int kSide = 20;
  constexpr double kCell = 32, kX = 400000, kY = 3800000;
  for (const bool pixel_is_point : {false, true}) {
    std::vector<float> values;
    for (int r = 0; r < kSide; ++r) {
      for (int c = 0; c < kSide; ++c) {
        const double shift = pixel_is_point ? 0 : 0.5;
        values.push_back(static_cast<float>((c + shift) * kCell + 10 * (r + shift) * kCell));
      }
    }
    const std::string file = path(pixel_is_point ? "point.tif" : "area.tif");
    std::ofstream(file, std::ios::binary)
        << test::geotiff_bytes(kSide, kSide, kX, kY, kCell, 32611, pixel_is_point, values);
    const auto posts = read({file});
    ASSERT_TRUE(posts) << posts.error().message;
    const CrsProbe probe("EPSG:32611");
    int n = 0;
    for (std::int64_t r = 0; r < posts->mosaic.n_rows; ++r) {
      for (std::int64_t c = 0; c < posts->mosaic.n_cols; ++c) {
        const auto at = probe.to_crs(posts->lon_deg(c), posts->lat_deg(r));
        const double x = (*at)[0] - kX, y = kY - (*at)[1];
        if (x < kCell || y < kCell || x > (kSide - 2) * kCell || y > (kSide - 2) * kCell) continue;
        ++n;
        ASSERT_NEAR(posts->at(r, c), x + 10 * y, 0.01) << pixel_is_point;
      }
    }
    EXPECT_GT(n, 200);
  }
}

TEST_F(WarpedRasterTest, TiePointOfDegreesIsACornerForAreasAndACentreForPoints) {
  for (const bool pixel_is_point : {false, true}) {
    const std::string file = path(pixel_is_point ? "point.tif" : "area.tif");
    std::ofstream(file, std::ios::binary)
        << test::geotiff_bytes(5, 4, 10, 46, 0.01, 4326, pixel_is_point, std::vector<float>(20, 7.0f));
    const auto mosaic = RasterMosaic::open({file}, {});
    ASSERT_TRUE(mosaic) << mosaic.error().message;
    EXPECT_FALSE(mosaic->warped);
    EXPECT_NEAR(mosaic->west_deg, pixel_is_point ? 10 : 10.005, 1e-12);
    EXPECT_NEAR(mosaic->south_deg, pixel_is_point ? 45.97 : 45.965, 1e-12);
  }
}

TEST_F(WarpedRasterTest, PostInAVoidCellIsAVoidAndVoidNeighboursAreDropped) {
  // NaN without a nodata tag in one cell; the surface is 100 at even columns and 200 at odd ones.
  RasterPlan plan = utm_plan([](double x, double y) {
    const auto col = static_cast<int>((x - 400000) / 30), row = static_cast<int>((3800000 - y) / 30);
    return col == 20 && row == 15 ? test::kNoHeight : col % 2 == 0 ? 100.0f : 200.0f;
  });
  const CrsProbe probe("EPSG:32611");
  for (const bool tagged : {false, true}) {
    if (tagged) {
      plan.nodata = -9999;
      plan.height = [old = plan.height](double x, double y) { return std::isnan(old(x, y)) ? -9999 : old(x, y); };
    }
    const auto posts = read({write("a.tif", plan)});
    ASSERT_TRUE(posts) << posts.error().message;
    int n_void = 0, n_beside = 0;
    for (std::int64_t r = 0; r < posts->mosaic.n_rows; ++r) {
      for (std::int64_t c = 0; c < posts->mosaic.n_cols; ++c) {
        const auto at = probe.to_crs(posts->lon_deg(c), posts->lat_deg(r));
        const double col = ((*at)[0] - 400000) / 30, row = (3800000 - (*at)[1]) / 30;
        if (col < 2 || row < 2 || col > 38 || row > 28) continue;
        const double fx = col - 0.5 - std::floor(col - 0.5), fy = row - 0.5 - std::floor(row - 0.5);
        const auto c0 = static_cast<int>(col - 0.5), r0 = static_cast<int>(row - 0.5);
        if (static_cast<int>(col) == 20 && static_cast<int>(row) == 15) {
          EXPECT_TRUE(std::isnan(posts->at(r, c)));
          ++n_void;
          continue;
        }
        double sum = 0, weights = 0;
        for (int j = 0; j < 2; ++j) {
          for (int i = 0; i < 2; ++i) {
            if (c0 + i == 20 && r0 + j == 15) continue;
            const double w = (i == 0 ? 1 - fx : fx) * (j == 0 ? 1 - fy : fy);
            sum += w * ((c0 + i) % 2 == 0 ? 100 : 200);
            weights += w;
          }
        }
        n_beside += weights < 0.999 ? 1 : 0;
        ASSERT_NEAR(posts->at(r, c), sum / weights, 0.02) << col << ' ' << row;
      }
    }
    EXPECT_GE(n_void, 1);
    EXPECT_GE(n_beside, 3);
  }
}

TEST_F(WarpedRasterTest, CubicKeepsAParabolaAndFallsBackToBilinearBesideVoids) {
  const auto parabola = [](double col) { return 100 + 3 * col * col; };
  const RasterPlan plan = utm_plan([&](double x, double y) {
    const double col = (x - 400000) / 30 - 0.5, row = (3800000 - y) / 30 - 0.5;
    return std::lround(col) == 20 && std::lround(row) == 15 ? test::kNoHeight : static_cast<float>(parabola(col));
  });
  const std::string file = write("a.tif", plan);
  RasterOptions options;
  options.resampling = Resampling::kCubic;
  const auto cubic = read({file}, options), bilinear = read({file});
  ASSERT_TRUE(cubic && bilinear);
  EXPECT_EQ(cubic->mosaic.resampling, "cubic");
  const CrsProbe probe("EPSG:32611");
  double worst_bilinear = 0;
  int n_fallen = 0;
  for (std::int64_t r = 0; r < cubic->mosaic.n_rows; ++r) {
    for (std::int64_t c = 0; c < cubic->mosaic.n_cols; ++c) {
      const auto at = probe.to_crs(cubic->lon_deg(c), cubic->lat_deg(r));
      const double col = ((*at)[0] - 400000) / 30 - 0.5, row = (3800000 - (*at)[1]) / 30 - 0.5;
      if (col < 0 || row < 0 || col > 39 || row > 29) continue;
      const double left = std::floor(col), top = std::floor(row);
      const bool at_rim = left < 1 || top < 1 || left > 37 || top > 27;
      const bool beside = left >= 18 && left <= 21 && top >= 13 && top <= 16;
      if (at_rim || beside) {
        n_fallen += beside ? 1 : 0;
        ASSERT_TRUE(cubic->at(r, c) == bilinear->at(r, c) || (std::isnan(cubic->at(r, c)) && beside));
        continue;
      }
      ASSERT_NEAR(cubic->at(r, c), parabola(col), 2e-2) << col << ' ' << row;
      worst_bilinear = std::max(worst_bilinear, std::abs(bilinear->at(r, c) - parabola(col)));
    }
  }
  EXPECT_GT(worst_bilinear, 0.6);
  EXPECT_GE(n_fallen, 12);
}

TEST_F(WarpedRasterTest, PoleIsOnePostAndTheColumnsClose) {
  RasterPlan plan;
  plan.geotransform = {-1000000, 50000, 0, 1000000, 0, -50000};
  plan.n_cols = plan.n_rows = 40;
  plan.crs = "EPSG:3031";
  plan.height = [](double x, double y) { return static_cast<float>(2800 + x / 1000 + y / 2000); };
  const auto mosaic = RasterMosaic::open({write("a.tif", plan)}, {});
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  EXPECT_TRUE(mosaic->wraps);
  EXPECT_EQ(mosaic->south_deg, -90);
  EXPECT_EQ(mosaic->west_deg, -180);
  const auto grid = load(*mosaic);
  ASSERT_TRUE(grid) << grid.error().message;
  const HeightField& f = grid->field();
  EXPECT_TRUE(f.continues_south);
  EXPECT_NEAR(f.south_pole_m, 2800, 1e-3);
  EXPECT_LT(f.disagreement_m, 1e-3);
  for (std::int64_t c = 0; c < f.n_cols; ++c) ASSERT_EQ(f.height_at(0, c), static_cast<double>(f.south_pole_m));
}

TEST_F(WarpedRasterTest, ZonesOverlapInTheirMeanInAnyOrder) {
  RasterPlan west = utm_plan([](double, double) { return 100.0f; }), east = west;
  west.geotransform = {770000, 300, 0, 4000000, 0, -300};  // zone 11 ends at longitude -114, x = 770 km
  east.geotransform = {230000, 300, 0, 4000000, 0, -300};
  east.crs = "EPSG:32612";
  east.height = [](double, double) { return 103.0f; };
  const auto a = write("w.tif", west), b = write("e.tif", east);
  const auto one = RasterMosaic::open({a, b}, {}), two = RasterMosaic::open({b, a, b}, {});
  ASSERT_TRUE(one && two);
  ASSERT_EQ(one->sources.size(), 2u);
  EXPECT_NE(one->sources[0].operation, one->sources[1].operation);
  const auto grid = load(*one), other = load(*two);
  ASSERT_TRUE(grid && other);
  EXPECT_GT(grid->counts().overlapping, 100u);
  EXPECT_EQ(grid->counts().disagreeing, grid->counts().overlapping);
  EXPECT_EQ(grid->field().disagreement_m, 1.5);
  const auto n = static_cast<std::size_t>(grid->field().n_rows * grid->field().n_cols);
  ASSERT_EQ(n, static_cast<std::size_t>(other->field().n_rows * other->field().n_cols));
  EXPECT_EQ(std::memcmp(grid->field().heights_m, other->field().heights_m, n * sizeof(float)), 0);
}

TEST_F(WarpedRasterTest, ManySourcesReadInTurnKeepTheirHeights) {
  // More cells than all sources together may keep: what was read first is forgotten and read again.
  std::vector<std::string> files;
  RasterPlan plan = utm_plan({});
  plan.n_cols = 16000;
  plan.n_rows = 40;
  plan.height = [](double x, double y) { return static_cast<float>((x - 400000) / 100 + (y - 3700000) / 200); };
  for (int k = 0; k < 10; ++k) {
    plan.geotransform = {400000, 10, 0, 3800000.0 + 400 * k, 0, -10};
    files.push_back(write(fmt::format("{}.tif", k), plan));
  }
  const auto mosaic = RasterMosaic::open(files, {});
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  const CrsProbe probe("EPSG:32611");
  std::vector<float> heights;
  std::uint64_t n_implausible = 0;
  std::int64_t n = 0;
  for (const double share : {0.1, 0.5, 0.9}) {
    for (std::size_t s = 0; s < files.size(); ++s) {
      const RasterSource& source = mosaic->sources[s];
      const auto row = static_cast<std::int64_t>(share * static_cast<double>(source.n_used_rows));
      ASSERT_TRUE(mosaic->read_rows(s, row, 1, heights, n_implausible));
      for (std::int64_t c = 0; c < source.n_used_cols; c += 97) {
        if (std::isnan(heights[static_cast<std::size_t>(c)])) continue;
        const double lon = mosaic->west_deg + static_cast<double>(source.grid_col + c) * mosaic->lon_spacing_deg;
        const double lat = mosaic->south_deg + static_cast<double>(source.grid_row + row) * mosaic->lat_spacing_deg;
        const auto at = probe.to_crs(lon, lat);
        ASSERT_NEAR(heights[static_cast<std::size_t>(c)], ((*at)[0] - 400000) / 100 + ((*at)[1] - 3700000) / 200, 0.06);
        ++n;
      }
    }
  }
  EXPECT_GT(n, 1000);
}

TEST_F(WarpedRasterTest, KeptBlocksAreBoundedAndForgottenOnesAreReadAgain) {
  RasterPlan plan = utm_plan([](double x, double) { return static_cast<float>((x - 400000) / 100); });
  plan.n_cols = 200000;  // 782 blocks across
  plan.n_rows = 2;
  plan.geotransform = {400000, 1, 0, 3800000, 0, -1};
  auto file = inspect_raster(write("a.tif", plan), {}, 1);
  ASSERT_TRUE(file) << file.error().message;
  auto transform = PixelTransform::create(*file);
  ASSERT_TRUE(transform) << transform.error().message;
  RasterWarper warper(*file, std::move(*transform), Resampling::kBilinear);
  std::uint64_t n_implausible = 0;
  for (const int from : {0, 199999, 0}) {
    for (int k = 0; k < 200000; k += 125) {
      const double col = std::abs(from - k) + 0.75;
      std::array<Place, 1> place{Place{col, 1}};
      warper.transform().to_globe(place);
      float height = 0;
      ASSERT_TRUE(warper.sample(place, &height, n_implausible));
      ASSERT_NEAR(height, std::min(col, 199999.5) / 100, 1e-3);
    }
    EXPECT_EQ(warper.n_blocks(), RasterWarper::kMostBlocks);
  }
}

TEST_F(WarpedRasterTest, DegreesThatShareNoGridAreWarpedAndFineArcSecondPostsKeepTheirHeights) {
  RasterPlan fine, coarse;
  fine.geotransform = {10 - 0.5 / 1200, 1.0 / 1200, 0, 46 + 0.5 / 1200, 0, -1.0 / 1200};
  fine.crs = coarse.crs = "EPSG:4326";
  fine.height = [](double x, double y) { return static_cast<float>(1000 * (x - 10) + 500 * (46 - y)); };
  coarse.geotransform = {10.02, 0.003, 0, 46, 0, -0.003};  // from longitude 10.02: an overlap
  coarse.height = fine.height;
  const auto mosaic = RasterMosaic::open({write("f.tif", fine), write("c.tif", coarse)}, {});
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  EXPECT_TRUE(mosaic->warped);
  EXPECT_EQ(mosaic->lon_spacing_deg, 1.0 / 1200);
  EXPECT_THAT(mosaic->notes, ::testing::Contains(HasSubstr("degrees apart")));
  const auto grid = load(*mosaic);
  ASSERT_TRUE(grid);
  EXPECT_GT(grid->counts().overlapping, 100u);
  EXPECT_LT(grid->field().disagreement_m, 1.6);  // half a coarse cell on the rim
}

TEST_F(WarpedRasterTest, DegreesFromZeroTo360MixWithAProjectedRaster) {
  RasterPlan globe;
  globe.geotransform = {-0.5, 1, 0, 90.5, 0, -1};
  globe.n_cols = 361;
  globe.n_rows = 181;
  globe.crs = "EPSG:4326";
  globe.height = [](double, double y) { return static_cast<float>(10 * y); };
  RasterPlan local;
  local.geotransform = {-2000000, 100000, 0, 2000000, 0, -100000};
  local.n_cols = local.n_rows = 40;
  local.crs = "EPSG:3413";
  local.height = [](double, double) { return 700.0f; };
  const auto mosaic = RasterMosaic::open({write("g.tif", globe), write("l.tif", local)}, {});
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  EXPECT_TRUE(mosaic->wraps);
  const auto grid = load(*mosaic);
  ASSERT_TRUE(grid) << grid.error().message;
  const HeightField& f = grid->field();
  EXPECT_EQ(grid->counts().source, static_cast<std::uint64_t>(f.n_rows * f.n_cols));
  // South of the arctic raster the globe alone: on both sides of longitude 0 and of 180.
  for (const std::int64_t lat : {-60, 0, 45}) {
    const std::int64_t row = (lat + 90) * std::llround(1 / mosaic->lat_spacing_deg);
    for (const double lon : {-180.0, -90.0, -1.0, 0.0, 1.0, 179.0})
      ASSERT_NEAR(f.height_at(row, std::llround((lon + 180) / mosaic->lon_spacing_deg)),
                  10.0 * static_cast<double>(lat), 1e-3);
  }
}

TEST_F(WarpedRasterTest, RepeatedMeridianIsAMeanAndItsDisagreementCounts) {
  RasterPlan globe;
  globe.geotransform = {-180.5, 1, 0, 60.5, 0, -1};
  globe.n_cols = 361;
  globe.n_rows = 121;
  globe.crs = "EPSG:4326";
  globe.height = [](double x, double) { return x > 179.5 ? 106.0f : 100.0f; };
  const auto mosaic = RasterMosaic::open({write("g.tif", globe)}, {});
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  EXPECT_FALSE(mosaic->warped);
  EXPECT_TRUE(mosaic->wraps);
  EXPECT_EQ(mosaic->n_cols, 360);
  EXPECT_THAT(mosaic->notes, ::testing::Contains(HasSubstr("1 columns repeat others")));
  const auto grid = load(*mosaic);
  ASSERT_TRUE(grid) << grid.error().message;
  EXPECT_EQ(grid->counts().overlapping, 121u);
  EXPECT_EQ(grid->counts().disagreeing, 121u);
  EXPECT_EQ(grid->field().disagreement_m, 3);
  EXPECT_EQ(grid->field().height_at(40, 0), 103);
  EXPECT_EQ(grid->field().height_at(40, 1), 100);
}

TEST_F(WarpedRasterTest, ZerosBesideVoidsAreKeptAndNamed) {
  // A basin above 400 m; outside it NaN; on its rim some zeros.
  const auto basin = [](double zero) {
    return utm_plan([zero](double x, double y) {
      const double d = std::hypot(x - 400600, y - 3799550);
      return d > 400 ? test::kNoHeight : static_cast<float>(d > 360 ? zero : 400 + d / 10);
    });
  };
  const auto suspicions = [&](const RasterPlan& plan, const RasterOptions& options = {}) {
    const auto mosaic = RasterMosaic::open({write("a.tif", plan)}, options);
    EXPECT_TRUE(mosaic);
    const auto grid = load(*mosaic);
    EXPECT_TRUE(grid);
    return fmt::format("{}", fmt::join(grid->notes(), "\n"));
  };
  const std::string text = suspicions(basin(0));
  EXPECT_THAT(text, HasSubstr("posts of exactly 0 m"));
  EXPECT_THAT(text, HasSubstr("while all other posts are above 40"));
  EXPECT_THAT(text, HasSubstr("--nodata 0"));
  EXPECT_THAT(suspicions(basin(0), {.nodata = 0.0, .metres_per_unit = {}}), ::testing::Not(HasSubstr("exactly 0 m")));
  EXPECT_THAT(suspicions(basin(401)), ::testing::Not(HasSubstr("exactly 0 m")));
  // A coast has zeros beside land of 1 m.
  EXPECT_THAT(suspicions(utm_plan([](double x, double) {
                return x < 400300 ? test::kNoHeight : x < 400600 ? 0.0f : 1.0f;
              })),
              ::testing::Not(HasSubstr("exactly 0 m")));
}

TEST_F(WarpedRasterTest, FeetOfTheBandAreMetresInThePosts) {
  RasterPlan plan = utm_plan([](double, double) { return 1000.0f; });
  plan.unit = "US survey foot";
  const auto posts = read({write("a.tif", plan)});
  ASSERT_TRUE(posts) << posts.error().message;
  EXPECT_NEAR(posts->at(posts->mosaic.n_rows / 2, posts->mosaic.n_cols / 2), 304.8006, 1e-4);
  // A compound CRS: NAVD88 in feet, without a unit of the band.
  plan.unit.clear();
  plan.crs = "EPSG:26911+6360";
  const auto compound = read({write("b.tif", plan)});
  ASSERT_TRUE(compound) << compound.error().message;
  EXPECT_NEAR(compound->at(compound->mosaic.n_rows / 2, compound->mosaic.n_cols / 2), 304.8006, 1e-4);
  EXPECT_EQ(compound->mosaic.height_kind, "orthometric");
  EXPECT_THAT(compound->mosaic.vertical_datum, HasSubstr("NAVD88"));
}

TEST_F(WarpedRasterTest, ManifestMembersSayWhatTheSourceIs) {
  const auto mosaic = RasterMosaic::open({write("a.tif", utm_plan([](double, double) { return 1.0f; }))}, {});
  ASSERT_TRUE(mosaic);
  EXPECT_EQ(mosaic->sources[0].crs, "WGS 84 / UTM zone 11N (EPSG:32611)");
  EXPECT_THAT(mosaic->sources[0].operation, HasSubstr("+proj=utm +zone=11"));
  EXPECT_EQ(mosaic->native_spacing_m, 30);
  EXPECT_EQ(mosaic->height_kind, "unknown");
  EXPECT_EQ(mosaic->vertical_datum, "unknown");
}

TEST_F(WarpedRasterTest, RasterOverTheEdgeOfItsProjectionIsWarpedAsFarAsTheGlobeGoes) {
  // The western outline of the sinusoidal projection runs through the middle.
  constexpr double kRadius = 6371007.181;
  RasterPlan plan;
  plan.geotransform = {-16000000, 50000, 0, 6000000, 0, -50000};
  plan.n_cols = 60;
  plan.n_rows = 40;
  plan.crs = "+proj=sinu +R=6371007.181";
  plan.height = [](double x, double y) { return static_cast<float>(x / 10000 + y / 10000); };
  const auto posts = read({write("a.tif", plan)});
  ASSERT_TRUE(posts) << posts.error().message;
  int n = 0;
  for (std::int64_t r = 0; r < posts->mosaic.n_rows; ++r) {
    for (std::int64_t c = 0; c < posts->mosaic.n_cols; ++c) {
      const double lon = posts->lon_deg(c) * std::numbers::pi / 180, lat = posts->lat_deg(r) * std::numbers::pi / 180;
      const double x = kRadius * lon * std::cos(lat), y = kRadius * lat;
      if (x < -15970000 || x > -13030000 || y > 5970000 || y < 4030000) continue;
      ++n;
      ASSERT_NEAR(posts->at(r, c), x / 10000 + y / 10000, 0.01);
    }
  }
  EXPECT_GT(n, 500);
  // Native cells beyond the outline have no place.
  NativePosts native;
  ASSERT_TRUE(posts->mosaic.read_native_rows(0, 0, 40, native));
  for (int r = 0; r < 40; ++r) {
    for (int c = 0; c < 60; ++c) {
      const double x = -16000000 + (c + 0.5) * 50000, y = 6000000 - (r + 0.5) * 50000;
      const double edge = -kRadius * std::numbers::pi * std::cos(y / kRadius);
      if (std::abs(x - edge) < 1000) continue;
      ASSERT_EQ(std::isfinite(native.lon_deg[static_cast<std::size_t>(r * 60 + c)]), x > edge) << x << ' ' << y;
    }
  }
}

TEST_F(WarpedRasterTest, WhatCannotBeWarpedIsNamed) {
  const auto flat = [](double, double) { return 1.0f; };
  RasterPlan plan = utm_plan(flat);
  plan.crs.clear();
  EXPECT_THAT(message(plan), HasSubstr("no CRS, and its coordinates are not degrees; give it one"));
  plan = utm_plan(flat);
  plan.geotransform = {400000, 30, 30, 3800000, 15, 15};
  EXPECT_THAT(message(plan), HasSubstr("its geotransform is broken"));
  plan.geotransform = {400000, 30, 0, 3800000, 0, std::numeric_limits<double>::infinity()};
  EXPECT_THAT(message(plan), HasSubstr("its geotransform is broken"));
  plan.geotransform = {4e12, 30, 0, 3.8e12, 0, -30};
  EXPECT_THAT(message(plan), HasSubstr("message.tif: PROJ finds no way"));
  plan.geotransform = {400000, 1e-4, 0, 3800000, 0, -1e4};
  EXPECT_THAT(message(plan), HasSubstr("posts, more than 1e11"));
  plan.geotransform = {1.9e7, 1000, 0, 8e6, 0, -1000};  // beyond the outline of the projection
  plan.crs = "+proj=sinu +R=6371007.181";
  EXPECT_THAT(message(plan), HasSubstr("nothing of it lies on the globe"));
  plan = utm_plan(flat);
  plan.crs = "EPSG:4326";
  EXPECT_THAT(message(plan), HasSubstr("lies outside the globe's degrees; check"));
  plan = utm_plan(flat);
  plan.crs = "LOCAL_CS[\"a building site\",UNIT[\"metre\",1]]";
  EXPECT_THAT(message(plan), HasSubstr("does not say where on the globe it lies"));
  plan.crs =
      "PROJCS[\"Mars\",GEOGCS[\"GCS_Mars\",DATUM[\"D_Mars\",SPHEROID[\"Mars\",3396190,169.894447223612]],"
      "PRIMEM[\"Reference_Meridian\",0],UNIT[\"Degree\",0.0174532925199433]],PROJECTION[\"Equirectangular\"],"
      "PARAMETER[\"central_meridian\",0],PARAMETER[\"standard_parallel_1\",0],UNIT[\"metre\",1]]";
  EXPECT_THAT(message(plan), HasSubstr("is not one of the Earth"));
  // Read but void.
  const auto mosaic =
      RasterMosaic::open({write("void.tif", utm_plan([](double, double) { return test::kNoHeight; }))}, {});
  ASSERT_TRUE(mosaic);
  const auto grid = load(*mosaic);
  ASSERT_FALSE(grid);
  EXPECT_THAT(grid.error().message, HasSubstr("every post is a void"));
  EXPECT_EQ(message(utm_plan(flat)), "");
}

TEST_F(WarpedRasterTest, DamagedProjectedFileFailsInsteadOfGivingHeights) {
  RasterPlan plan = utm_plan([](double x, double y) { return static_cast<float>(x / 1000 + y / 1000); });
  plan.n_cols = plan.n_rows = 300;
  const std::string file = write("a.tif", plan);
  fs::resize_file(file, fs::file_size(file) / 2);
  const auto posts = read({file});
  ASSERT_FALSE(posts);
  EXPECT_EQ(posts.error().kind, ErrorKind::kIo);
  EXPECT_THAT(posts.error().message, HasSubstr("truncated or damaged"));
}

}  // namespace
}  // namespace tind
