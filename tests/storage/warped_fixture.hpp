// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "storage/readers/gdal_raster.hpp"
#include "storage/readers/height_grid.hpp"
#include "tests/storage/test_raster.hpp"

namespace tind::test {

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
    std::string name = (std::filesystem::temp_directory_path() / "tind-warped-raster-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

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

  std::filesystem::path folder_;
};

}  // namespace tind::test
