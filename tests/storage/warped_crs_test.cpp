// SPDX-License-Identifier: GPL-3.0-or-later
// Rasters of many CRSs whose surface is a plane in their own coordinates: bilinear resampling keeps a plane, so every
// post is known from OGR's transformation of its position alone.
#include <array>
#include <cmath>
#include <cstring>
#include <numbers>
#include <optional>
#include <ostream>

#include "tests/storage/warped_fixture.hpp"

namespace tind {
namespace {

using test::CrsProbe;
using test::RasterPlan;
using test::WarpedRasterTest;

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

}  // namespace
}  // namespace tind
