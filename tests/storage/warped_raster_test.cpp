// SPDX-License-Identifier: GPL-3.0-or-later
// Rasters of many CRSs whose surface is a plane in their own coordinates: bilinear resampling keeps a plane, so every
// post is known from OGR's transformation of its position alone.
#include "storage/readers/gdal_raster.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <numbers>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "storage/readers/height_grid.hpp"
#include "storage/readers/raster_warper.hpp"
#include "tests/storage/test_raster.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;
using test::CrsProbe;
using test::RasterPlan;
using test::write_raster;
using ::testing::HasSubstr;

struct Posts {
  RasterMosaic mosaic;
  std::vector<float> heights_m;  ///< Of source 0, its used rows and columns.

  double lon_deg(std::int64_t c) const {
    const double lon = mosaic.west_deg + static_cast<double>(mosaic.sources[0].grid_col + c) * mosaic.lon_spacing_deg;
    return std::remainder(lon, 360.0);
  }
  double lat_deg(std::int64_t r) const {
    return mosaic.south_deg + static_cast<double>(mosaic.sources[0].grid_row + r) * mosaic.lat_spacing_deg;
  }
  float at(std::int64_t r, std::int64_t c) const {
    return heights_m[static_cast<std::size_t>(r * mosaic.sources[0].n_used_cols + c)];
  }
};

class WarpedRasterTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-warped-raster-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { fs::remove_all(folder_); }

  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  std::string write(const std::string& name, const RasterPlan& plan) const {
    write_raster(path(name), plan);
    return path(name);
  }
  Result<Posts> read(const std::vector<std::string>& paths, const RasterOptions& options = {},
                     std::int64_t strip_rows = 1 << 20) const {
    auto mosaic = RasterMosaic::open(paths, options);
    if (!mosaic) return tl::unexpected(mosaic.error());
    Posts posts{std::move(*mosaic), {}};
    const RasterSource& s = posts.mosaic.sources[0];
    std::vector<float> strip;
    std::uint64_t n_implausible = 0;
    for (std::int64_t r = 0; r < s.n_used_rows; r += strip_rows) {
      const auto n = std::min(strip_rows, s.n_used_rows - r);
      if (auto ok = posts.mosaic.read_rows(0, r, n, strip, n_implausible); !ok) return tl::unexpected(ok.error());
      posts.heights_m.insert(posts.heights_m.end(), strip.begin(), strip.end());
    }
    return posts;
  }
  std::string message(const RasterPlan& plan, const RasterOptions& options = {}) const {
    const auto posts = read({write("message.tif", plan)}, options);
    return posts ? "" : posts.error().message;
  }
  Result<HeightGrid> load(const RasterMosaic& mosaic) const {
    Lattice lattice;
    lattice.level = 8;
    lattice.height_exponent = 6;
    return HeightGrid::load(mosaic, lattice, {0, 8, folder_.string()}, {});
  }

  fs::path folder_;
};

struct Case {
  const char* name;
  const char* crs;
  std::array<double, 6> geotransform;
  int n_cols = 40, n_rows = 30;
  /// x of one turn around the globe, where the CRS's x repeats.
  double turn = 0;
  /// A pole lies inside.
  bool holds_pole = false;
};

void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }

class WarpedCaseTest : public WarpedRasterTest, public ::testing::WithParamInterface<Case> {
 protected:
  /// Column and row of a place, counted from the corner of cell (0, 0); of the turn inside the raster if there is one.
  std::optional<std::array<double, 2>> cell_of(const CrsProbe& probe, double lon, double lat) const {
    const Case& p = GetParam();
    const auto& gt = p.geotransform;
    const auto at = probe.to_crs(lon, lat);
    if (!at) return std::nullopt;
    std::array<double, 2> first{};
    for (const double k : {0.0, -1.0, 1.0}) {
      const double dx = (*at)[0] + k * p.turn - gt[0], dy = (*at)[1] - gt[3], area = gt[1] * gt[5] - gt[2] * gt[4];
      const std::array<double, 2> cell{(dx * gt[5] - dy * gt[2]) / area, (dy * gt[1] - dx * gt[4]) / area};
      if (k == 0.0) first = cell;
      if (cell[0] >= 0 && cell[0] < p.n_cols && cell[1] >= 0 && cell[1] < p.n_rows) return cell;
    }
    return first;
  }
  /// The surface in cells: steep, so that half a cell is 6 m along a row and 3.5 m along a column.
  static double plane(double col, double row) { return 500 + 12 * col - 7 * row; }

  RasterPlan plan() const {
    const Case& p = GetParam();
    const auto gt = p.geotransform;
    RasterPlan surface;
    surface.n_cols = p.n_cols;
    surface.n_rows = p.n_rows;
    surface.geotransform = gt;
    surface.crs = p.crs;
    surface.height = [gt](double x, double y) {
      const double dx = x - gt[0], dy = y - gt[3], area = gt[1] * gt[5] - gt[2] * gt[4];
      return static_cast<float>(plane((dx * gt[5] - dy * gt[2]) / area, (dy * gt[1] - dx * gt[4]) / area));
    };
    return surface;
  }
};

TEST_P(WarpedCaseTest, EveryPostInsideIsThePlaneAndAllOthersAreVoids) {
  const Case& p = GetParam();
  const auto posts = read({write("a.tif", plan())});
  ASSERT_TRUE(posts) << posts.error().message;
  const CrsProbe probe(p.crs);
  EXPECT_TRUE(posts->mosaic.warped);
  EXPECT_EQ(posts->mosaic.resampling, "bilinear");
  EXPECT_FALSE(posts->mosaic.sources[0].operation.empty());
  const RasterSource& s = posts->mosaic.sources[0];
  std::int64_t n_inside = 0, n_flat = 0;
  for (std::int64_t r = 0; r < s.n_used_rows; ++r) {
    for (std::int64_t c = 0; c < s.n_used_cols; ++c) {
      const auto cell = cell_of(probe, posts->lon_deg(c), posts->lat_deg(r));
      const float h = posts->at(r, c);
      const double x = cell ? (*cell)[0] : -1, y = cell ? (*cell)[1] : -1;
      constexpr double kRim = 1e-6;  // a post on the raster's very rim may be either
      const bool inside = x >= kRim && x < p.n_cols - kRim && y >= kRim && y < p.n_rows - kRim;
      const bool outside = !(x >= -kRim && x < p.n_cols + kRim && y >= -kRim && y < p.n_rows + kRim);
      if (outside) {
        ASSERT_TRUE(std::isnan(h)) << posts->lon_deg(c) << ' ' << posts->lat_deg(r) << ' ' << x << ' ' << y;
      }
      if (!inside) continue;
      ++n_inside;
      // Within half a cell of the rim the cells outside are dropped, and the surface is level across it.
      const double xx = std::clamp(x, 0.5, p.n_cols - 0.5), yy = std::clamp(y, 0.5, p.n_rows - 0.5);
      n_flat += xx != x || yy != y ? 1 : 0;
      ASSERT_NEAR(h, plane(xx, yy), 2e-3) << posts->lon_deg(c) << ' ' << posts->lat_deg(r) << ' ' << x << ' ' << y;
    }
  }
  // No coarser than native: there are as many posts as cells, but for a row and a column on the rim.
  EXPECT_GE(n_inside, std::int64_t{p.n_cols - 1} * (p.n_rows - 1));
  EXPECT_GT(n_inside, n_flat);
}

TEST_P(WarpedCaseTest, PostsAreNoFartherApartThanCellsAndLieAtWholePartsOfADegree) {
  const Case& p = GetParam();
  const auto mosaic = RasterMosaic::open({write("a.tif", plan())}, {});
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  const CrsProbe probe(p.crs);
  const double dx = mosaic->lon_spacing_deg, dy = mosaic->lat_spacing_deg;
  EXPECT_NEAR(1 / dx, std::round(1 / dx), 1e-6);
  EXPECT_NEAR(1 / dy, std::round(1 / dy), 1e-6);
  EXPECT_NEAR(mosaic->west_deg / dx, std::round(mosaic->west_deg / dx), 1e-6);
  EXPECT_NEAR(mosaic->south_deg / dy, std::round(mosaic->south_deg / dy), 1e-6);
  double widest_x = 0, widest_y = 0;
  for (int r = 0; r <= 16; ++r) {
    for (int c = 0; c <= 16; ++c) {
      const double col = p.n_cols * c / 16.0, row = p.n_rows * r / 16.0;
      const auto& gt = p.geotransform;
      const auto globe = probe.to_globe(gt[0] + col * gt[1] + row * gt[2], gt[3] + col * gt[4] + row * gt[5]);
      ASSERT_TRUE(globe);
      const double lon = (*globe)[0], lat = (*globe)[1];
      const auto here = cell_of(probe, lon, lat);
      const auto east = cell_of(probe, std::remainder(lon + dx / 16, 360.0), lat);
      const auto north = cell_of(probe, lon, lat + (lat > 0 ? -1 : 1) * dy / 16);
      if (!here || !east || !north) continue;
      const auto length = [](const std::array<double, 2>& a, const std::array<double, 2>& b) {
        const double l = 16 * std::hypot(a[0] - b[0], a[1] - b[1]);
        return l < 8 ? l : 0;  // the seam of the CRS's own longitudes lies between
      };
      widest_x = std::max(widest_x, length(*here, *east));
      widest_y = std::max(widest_y, length(*here, *north));
    }
  }
  EXPECT_LE(widest_x, 1.001);
  EXPECT_LE(widest_y, 1.001);
  // ... and no finer than need be: with one part of a degree less they would be.
  const double lon_parts = std::round(1 / dx), lat_parts = std::round(1 / dy);
  if (lon_parts > 1) {
    EXPECT_GT(widest_x * lon_parts / (lon_parts - 1), 0.995);
  }
  if (lat_parts > 1) {
    EXPECT_GT(widest_y * lat_parts / (lat_parts - 1), 0.995);
  }
}

TEST_P(WarpedCaseTest, AnyStripHeightGivesTheSameBytes) {
  const std::string file = write("a.tif", plan());
  const auto whole = read({file}), strips = read({file}, {}, 7), rows = read({file}, {}, 1);
  ASSERT_TRUE(whole && strips && rows);
  ASSERT_EQ(whole->heights_m.size(), strips->heights_m.size());
  const std::size_t n_bytes = whole->heights_m.size() * sizeof(float);
  EXPECT_EQ(std::memcmp(whole->heights_m.data(), strips->heights_m.data(), n_bytes), 0);
  EXPECT_EQ(std::memcmp(whole->heights_m.data(), rows->heights_m.data(), n_bytes), 0);
}

TEST_P(WarpedCaseTest, NativeCellsLieWhereOgrPutsThemInsideTheGrid) {
  const Case& p = GetParam();
  const auto mosaic = RasterMosaic::open({write("a.tif", plan())}, {});
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  EXPECT_EQ(mosaic->wraps, p.holds_pole);
  const CrsProbe probe(p.crs);
  const auto& gt = p.geotransform;
  NativePosts native;
  for (int first = 0; first < p.n_rows; first += 7) {
    const int n = std::min(7, p.n_rows - first);
    ASSERT_TRUE(mosaic->read_native_rows(0, first, n, native));
    ASSERT_EQ(native.heights_m.size(), static_cast<std::size_t>(n * p.n_cols));
    for (int r = 0; r < n; ++r) {
      for (int c = 0; c < p.n_cols; ++c) {
        const auto i = static_cast<std::size_t>(r * p.n_cols + c);
        const double col = c + 0.5, row = first + r + 0.5;
        const auto globe = probe.to_globe(gt[0] + col * gt[1] + row * gt[2], gt[3] + col * gt[4] + row * gt[5]);
        ASSERT_TRUE(globe);
        ASSERT_NEAR(native.heights_m[i], plane(col, row), 2e-3);
        ASSERT_NEAR(native.lat_deg[i], (*globe)[1], 1e-9);
        ASSERT_NEAR(std::remainder(native.lon_deg[i] - (*globe)[0], 360.0), 0, 1e-9);
        const double north = mosaic->south_deg + static_cast<double>(mosaic->n_rows - 1) * mosaic->lat_spacing_deg;
        ASSERT_GE(native.lat_deg[i], mosaic->south_deg);
        ASSERT_LE(native.lat_deg[i], north);
        double east = std::fmod(native.lon_deg[i] - mosaic->west_deg, 360.0);
        if (east < 0) east += 360;
        ASSERT_LE(east, mosaic->lon_spacing_deg * static_cast<double>(mosaic->n_cols));
      }
    }
  }
}

constexpr double kMercatorTurn = 2 * std::numbers::pi * 6378137.0;

INSTANTIATE_TEST_SUITE_P(
    Crs, WarpedCaseTest,
    ::testing::Values(Case{"Utm", "EPSG:32611", {376313.655, 30, 0, 3807917.827, 0, -30}},
                      Case{"UtmOddCells", "EPSG:26910", {444395.6, 10.5, 0, 4398530.9, 0, -23}},
                      Case{"UtmSouthUp", "EPSG:32611", {376313.655, 30, 0, 3807917.827, 0, 30}},
                      Case{"UtmMirrored", "EPSG:32611", {376313.655, -30, 0, 3807917.827, 0, -30}},
                      Case{"UtmRotated", "EPSG:32611", {376313.655, 26, 15, 3807917.827, 15, -26}},
                      Case{"UtmNad27", "EPSG:26711", {376313.655, 30, 0, 3807917.827, 0, -30}},
                      Case{"UtmAcrossLongitude180", "EPSG:32601", {200000, 7000, 0, 5600000, 0, -7000}},
                      Case{"LambertFeet", "EPSG:2992", {900000, 98.4, 0, 800000, 0, -98.4}},
                      Case{"LambertSurveyFeet", "EPSG:2285", {1200000, 98.4, 0, 300000, 0, -98.4}},
                      Case{"WebMercator", "EPSG:3857", {-11800000, 150, 0, 4500000, 0, -150}, 40, 30, kMercatorTurn},
                      Case{"WebMercatorAcrossLongitude180",
                           "EPSG:3857",
                           {19980000, 1500, 0, 5000000, 0, -1500},
                           60,
                           30,
                           kMercatorTurn},
                      Case{"MercatorOf150", "EPSG:3832", {3300000, 1500, 0, 5000000, 0, -1500}, 60, 30},
                      Case{"AntarcticPole", "EPSG:3031", {-1000000, 50000, 0, 800000, 0, -50000}, 40, 30, 0, true},
                      Case{"ArcticPoleAtTheRim", "EPSG:3413", {-1000000, 50000, 0, 0, 0, -50000}, 40, 30},
                      Case{"ArcticOffThePole", "EPSG:3995", {400000, 10000, 0, 800000, 0, -10000}, 40, 30},
                      Case{"GradsFromParis", "EPSG:4807", {2, 0.01, 0, 52, 0, -0.01}},
                      Case{"RotatedDegrees", "EPSG:4326", {10, 0.009, 0.002, 46, 0.002, -0.009}},
                      Case{"DegreesMirrored", "EPSG:4326", {10, -0.01, 0, 46, 0, -0.01}}),
    [](const auto& one) { return std::string(one.param.name); });

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
