// SPDX-License-Identifier: GPL-3.0-or-later
// tind-build report on a projected source: errors at the cells of its own grid.
#include <cmath>

#include <gmock/gmock.h>

#include "storage/readers/gdal_raster.hpp"
#include "tests/storage/report_world.hpp"
#include "tests/storage/test_raster.hpp"

namespace tind::test {
namespace {

TEST_F(ReportTest, CellsOfAProjectedSourceAreMeasuredAtTheirOwnPlaces) {
  RasterPlan plan;
  plan.n_cols = 36;
  plan.n_rows = 28;
  plan.geotransform = {350000, 100, 0, 3800000, 0, -100};
  plan.crs = "EPSG:32611";
  // Waves short enough for warping to lose something.
  plan.height = [](double x, double y) {
    return static_cast<float>(500 + 60 * std::sin(x / 130) * std::cos(y / 170) + x / 500);
  };
  const std::string dem = path("utm.tif");
  write_raster(dem, plan);
  BuildOptions o = options(dem, "utm.tind");
  o.lines.drainage = false;
  const std::string file = build(o);
  const auto j = report({file, "--source", dem, "--levels", "10-", "--no-streams"});
  EXPECT_EQ(j["source_kind"], "warped");

  const Tiles tiles(file);
  const Lattice& lattice = tiles.manifest.lattice;
  const auto mosaic = RasterMosaic::open({dem}, {});
  ASSERT_TRUE(mosaic.has_value());
  std::vector<float> posts;
  std::uint64_t n_implausible = 0;
  ASSERT_TRUE(mosaic->read_rows(0, 0, mosaic->n_rows, posts, n_implausible).has_value());
  NativePosts cells;
  ASSERT_TRUE(mosaic->read_native_rows(0, 0, plan.n_rows, cells).has_value());

  for (const auto& level : j["levels"]) {
    double squares = 0, most = 0;
    int n = 0;
    for (std::size_t i = 0; i < cells.heights_m.size(); ++i) {
      const auto r =
          static_cast<std::int64_t>(std::floor((cells.lat_deg[i] - mosaic->south_deg) / mosaic->lat_spacing_deg));
      const auto c =
          static_cast<std::int64_t>(std::floor((cells.lon_deg[i] - mosaic->west_deg) / mosaic->lon_spacing_deg));
      bool inside = r >= 0 && c >= 0 && r + 1 < mosaic->n_rows && c + 1 < mosaic->n_cols;
      for (const std::int64_t dr : {0, 1}) {
        for (const std::int64_t dc : {0, 1}) {
          inside = inside && !std::isnan(posts[static_cast<std::size_t>((r + dr) * mosaic->n_cols + c + dc)]);
        }
      }
      if (!inside) continue;
      const double z = tiles.height_m(level["level"], (cells.lon_deg[i] + 180) / lattice.step_deg(),
                                      (cells.lat_deg[i] + 90) / lattice.step_deg());
      const double e = z - double{cells.heights_m[i]};
      squares += e * e;
      most = std::max(most, std::abs(e));
      ++n;
    }
    ASSERT_GT(n, 800);
    EXPECT_EQ(level["native"]["cells"], n);
    EXPECT_EQ(j["native_cells_left_out"], plan.n_rows * plan.n_cols - n);
    EXPECT_NEAR(level["native"]["rmse_m"], std::sqrt(squares / n), 1e-6);
    EXPECT_NEAR(level["native"]["max_error_m"], most, 1e-6);
  }
  // Warping is not free: the cells are farther off than the posts, where the surface follows those closely.
  const auto& bottom = j["levels"].back();
  EXPECT_GT(bottom["native"]["rmse_m"].get<double>(), bottom["tin"]["rmse_m"].get<double>());
}

TEST_F(ReportTest, SourcesOnTheirOwnPostsHaveNoCellsToMeasure) {
  const std::string dem = write(mountains(), "dem.asc"), file = build(options(dem, "dem.tind"));
  const auto j = report({file, "--source", dem, "--no-streams"});
  for (const auto& level : j["levels"]) EXPECT_FALSE(level.contains("native"));
}

}  // namespace
}  // namespace tind::test
