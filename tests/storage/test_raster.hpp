// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <vector>

namespace tind::test {

inline constexpr float kNoHeight = std::numeric_limits<float>::quiet_NaN();

/// A raster to write: Float32, one band.
struct RasterPlan {
  int n_cols = 40, n_rows = 30;
  std::array<double, 6> geotransform{};  ///< GDAL's: of the corner of cell (0, 0).
  std::string crs;                       ///< As gdal_translate -a_srs takes it; empty: none.
  /// Height at a cell's centre, in the CRS's x and y.
  std::function<float(double x, double y)> height = [](double, double) { return 100.0f; };
  std::optional<double> nodata;
  std::string unit;
  std::string driver = "GTiff";
};

/// Writes the raster through GDAL; a gtest failure when that cannot be done.
void write_raster(const std::string& path, const RasterPlan& plan);

/// A place of the globe in a CRS (x, y in the traditional order), through OGR's own transformation; nullopt: none.
class CrsProbe {
 public:
  explicit CrsProbe(const std::string& crs);
  ~CrsProbe();
  CrsProbe(const CrsProbe&) = delete;
  CrsProbe& operator=(const CrsProbe&) = delete;
  std::optional<std::array<double, 2>> to_crs(double lon_deg, double lat_deg) const;
  std::optional<std::array<double, 2>> to_globe(double x, double y) const;

 private:
  void* to_crs_;
  void* to_globe_;
};

/// The bytes of a GeoTIFF made without any library: Float32, little-endian, one strip; the tie point puts raster place
/// (0, 0) at (x, y), which is a corner for pixel-is-area and a centre for pixel-is-point. `epsg`: of a projected CRS,
/// or 4326. `values`: n_rows x n_cols.
std::string geotiff_bytes(int n_cols, int n_rows, double x, double y, double side, int epsg, bool pixel_is_point,
                          const std::vector<float>& values);

}  // namespace tind::test
