// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client_checks/projected_raster.hpp"

#include <gdal_priv.h>
#include <ogr_spatialref.h>

#include <cstdlib>
#include <map>
#include <memory>
#include <vector>

namespace tind::test {
namespace {

OGRSpatialReference system_of(const std::string& text) {
  OGRSpatialReference system;
  if (system.SetFromUserInput(text.c_str()) != OGRERR_NONE) std::abort();
  system.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  return system;
}

}  // namespace

void write_projected(const std::string& path, const ProjectedPlan& plan) {
  GDALAllRegister();
  GDALDataset* dataset = GetGDALDriverManager()->GetDriverByName("GTiff")->Create(path.c_str(), plan.n_columns,
                                                                                  plan.n_rows, 1, GDT_Float32, nullptr);
  if (dataset == nullptr) std::abort();
  if (plan.pixel_is_point) dataset->SetMetadataItem("AREA_OR_POINT", "Point");
  auto t = plan.transform;
  dataset->SetGeoTransform(t.data());
  const OGRSpatialReference system = system_of(plan.crs);
  dataset->SetSpatialRef(&system);
  GDALRasterBand* band = dataset->GetRasterBand(1);
  if (plan.nodata) band->SetNoDataValue(*plan.nodata);
  if (!plan.unit.empty()) band->SetUnitType(plan.unit.c_str());
  std::vector<float> row(static_cast<std::size_t>(plan.n_columns));
  for (int r = 0; r < plan.n_rows; ++r) {
    for (int c = 0; c < plan.n_columns; ++c) {
      row[static_cast<std::size_t>(c)] = static_cast<float>(
          plan.height(t[0] + (c + 0.5) * t[1] + (r + 0.5) * t[2], t[3] + (c + 0.5) * t[4] + (r + 0.5) * t[5]));
    }
    if (band->RasterIO(GF_Write, 0, r, plan.n_columns, 1, row.data(), plan.n_columns, 1, GDT_Float32, 0, 0) !=
        CE_None) {
      std::abort();
    }
  }
  GDALClose(dataset);
}

std::array<double, 2> project(const std::string& crs, double lon_deg, double lat_deg) {
  static std::map<std::string, std::unique_ptr<OGRCoordinateTransformation>> known;
  auto& transform = known[crs];
  if (transform == nullptr) {
    const OGRSpatialReference globe = system_of("EPSG:4326"), system = system_of(crs);
    transform.reset(OGRCreateCoordinateTransformation(&globe, &system));
  }
  std::array<double, 2> at = {lon_deg, lat_deg};
  if (transform == nullptr || transform->Transform(1, &at[0], &at[1]) == 0) std::abort();
  return at;
}

}  // namespace tind::test
