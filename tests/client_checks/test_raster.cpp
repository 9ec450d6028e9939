// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client_checks/test_raster.hpp"

#include <gdal_priv.h>

#include <cstdlib>
#include <vector>

namespace tind::test {

void write_raster(const std::string& path, const RasterPlan& plan) {
  constexpr double kSpacing = 0.01;
  GDALAllRegister();
  GDALDataset* dataset =
      GetGDALDriverManager()->GetDriverByName("GTiff")->Create(path.c_str(), plan.n, plan.n, 1, GDT_Int16, nullptr);
  if (dataset == nullptr) std::abort();
  double transform[6] = {plan.west_deg - kSpacing / 2,  kSpacing,      plan.rotation,
                         plan.north_deg + kSpacing / 2, plan.rotation, -kSpacing};
  dataset->SetGeoTransform(transform);
  dataset->SetProjection(SRS_WKT_WGS84_LAT_LONG);
  GDALRasterBand* band = dataset->GetRasterBand(1);
  if (plan.nodata) band->SetNoDataValue(*plan.nodata);
  std::vector<std::int16_t> row(static_cast<std::size_t>(plan.n));
  for (int r = 0; r < plan.n; ++r) {
    for (int c = 0; c < plan.n; ++c) row[static_cast<std::size_t>(c)] = static_cast<std::int16_t>(plan.height_m(r, c));
    if (band->RasterIO(GF_Write, 0, r, plan.n, 1, row.data(), plan.n, 1, GDT_Int16, 0, 0) != CE_None) std::abort();
  }
  GDALClose(dataset);
}

}  // namespace tind::test
