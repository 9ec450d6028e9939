// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/storage/test_raster.hpp"

#include <cstdint>
#include <cstring>

#include <gdal_priv.h>
#include <gtest/gtest.h>
#include <ogr_spatialref.h>

namespace tind::test {
namespace {

void append(std::string& out, const void* data, std::size_t n) { out.append(static_cast<const char*>(data), n); }

struct Tag {
  std::uint16_t id, type;  ///< 3: uint16, 4: uint32, 12: double
  std::uint32_t count;
  std::string data;
};

Tag shorts(std::uint16_t id, const std::vector<std::uint16_t>& values) {
  Tag tag{id, 3, static_cast<std::uint32_t>(values.size()), {}};
  append(tag.data, values.data(), values.size() * 2);
  return tag;
}

Tag longs(std::uint16_t id, std::uint32_t value) {
  Tag tag{id, 4, 1, {}};
  append(tag.data, &value, 4);
  return tag;
}

Tag doubles(std::uint16_t id, const std::vector<double>& values) {
  Tag tag{id, 12, static_cast<std::uint32_t>(values.size()), {}};
  append(tag.data, values.data(), values.size() * 8);
  return tag;
}

}  // namespace

void write_raster(const std::string& path, const RasterPlan& plan) {
  GDALAllRegister();
  GDALDriver* driver = GetGDALDriverManager()->GetDriverByName(plan.driver.c_str());
  ASSERT_NE(driver, nullptr);
  const GDALDatasetUniquePtr dataset(driver->Create(path.c_str(), plan.n_cols, plan.n_rows, 1, GDT_Float32, nullptr));
  ASSERT_NE(dataset, nullptr) << path;
  std::array<double, 6> gt = plan.geotransform;
  ASSERT_EQ(dataset->SetGeoTransform(gt.data()), CE_None);
  if (!plan.crs.empty()) {
    OGRSpatialReference crs;
    ASSERT_EQ(crs.SetFromUserInput(plan.crs.c_str()), OGRERR_NONE) << plan.crs;
    crs.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
    ASSERT_EQ(dataset->SetSpatialRef(&crs), CE_None);
  }
  GDALRasterBand& band = *dataset->GetRasterBand(1);
  if (plan.nodata) band.SetNoDataValue(*plan.nodata);
  if (!plan.unit.empty()) band.SetUnitType(plan.unit.c_str());
  std::vector<float> row(static_cast<std::size_t>(plan.n_cols));
  for (int r = 0; r < plan.n_rows; ++r) {
    for (int c = 0; c < plan.n_cols; ++c) {
      row[static_cast<std::size_t>(c)] =
          plan.height(gt[0] + (c + 0.5) * gt[1] + (r + 0.5) * gt[2], gt[3] + (c + 0.5) * gt[4] + (r + 0.5) * gt[5]);
    }
    ASSERT_EQ(band.RasterIO(GF_Write, 0, r, plan.n_cols, 1, row.data(), plan.n_cols, 1, GDT_Float32, 0, 0, nullptr),
              CE_None);
  }
}

CrsProbe::CrsProbe(const std::string& crs) {
  OGRSpatialReference own, globe;
  EXPECT_EQ(own.SetFromUserInput(crs.c_str()), OGRERR_NONE) << crs;
  globe.importFromEPSG(4326);
  own.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  globe.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  to_crs_ = OGRCreateCoordinateTransformation(&globe, &own);
  to_globe_ = OGRCreateCoordinateTransformation(&own, &globe);
}

CrsProbe::~CrsProbe() {
  OGRCoordinateTransformation::DestroyCT(static_cast<OGRCoordinateTransformation*>(to_crs_));
  OGRCoordinateTransformation::DestroyCT(static_cast<OGRCoordinateTransformation*>(to_globe_));
}

std::optional<std::array<double, 2>> CrsProbe::to_crs(double lon_deg, double lat_deg) const {
  if (!static_cast<OGRCoordinateTransformation*>(to_crs_)->Transform(1, &lon_deg, &lat_deg)) return std::nullopt;
  return std::array<double, 2>{lon_deg, lat_deg};
}

std::optional<std::array<double, 2>> CrsProbe::to_globe(double x, double y) const {
  if (!static_cast<OGRCoordinateTransformation*>(to_globe_)->Transform(1, &x, &y)) return std::nullopt;
  return std::array<double, 2>{x, y};
}

std::string geotiff_bytes(int n_cols, int n_rows, double x, double y, double side, int epsg, bool pixel_is_point,
                          const std::vector<float>& values) {
  const auto model = static_cast<std::uint16_t>(epsg == 4326 ? 2 : 1);
  const auto crs_key = static_cast<std::uint16_t>(epsg == 4326 ? 2048 : 3072);
  const auto n_bytes = static_cast<std::uint32_t>(values.size() * sizeof(float));
  std::vector<Tag> tags{
      longs(256, static_cast<std::uint32_t>(n_cols)),
      longs(257, static_cast<std::uint32_t>(n_rows)),
      shorts(258, {32}),
      shorts(259, {1}),
      shorts(262, {1}),
      longs(273, 0),
      shorts(277, {1}),
      longs(278, static_cast<std::uint32_t>(n_rows)),
      longs(279, n_bytes),
      shorts(339, {3}),
      doubles(33550, {side, side, 0}),
      doubles(33922, {0, 0, 0, x, y, 0}),
      shorts(34735, {1, 1, 0, 3, 1024, 0, 1, model, 1025, 0, 1, static_cast<std::uint16_t>(pixel_is_point ? 2 : 1),
                     crs_key, 0, 1, static_cast<std::uint16_t>(epsg)})};
  // Header, directory, what does not fit into the directory, values.
  std::uint32_t extra = static_cast<std::uint32_t>(8 + 2 + tags.size() * 12 + 4), end = extra;
  for (const Tag& tag : tags) end += tag.data.size() > 4 ? static_cast<std::uint32_t>(tag.data.size()) : 0;
  for (Tag& tag : tags) {
    if (tag.id == 273) std::memcpy(tag.data.data(), &end, 4);
  }
  std::string out("II*\0\x08\0\0\0", 8), more;
  const auto n_tags = static_cast<std::uint16_t>(tags.size());
  append(out, &n_tags, 2);
  for (const Tag& tag : tags) {
    append(out, &tag.id, 2);
    append(out, &tag.type, 2);
    append(out, &tag.count, 4);
    std::string value = tag.data;
    if (value.size() > 4) {
      const auto at = static_cast<std::uint32_t>(extra + more.size());
      more += value;
      value.clear();
      append(value, &at, 4);
    }
    value.resize(4, '\0');
    out += value;
  }
  out.append(4, '\0');
  out += more;
  append(out, values.data(), n_bytes);
  return out;
}

}  // namespace tind::test
