// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/source_raster.hpp"

#include <cpl_conv.h>
#include <cpl_string.h>
#include <cpl_vsi.h>
#include <fmt/format.h>
#include <gdal.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace tind::client {
namespace {

constexpr double kFeetInMetres = 0.3048;
constexpr double kSurveyFeetInMetres = 1200.0 / 3937.0;

bool ends_with(const std::string& text, const std::string& end) {
  return text.size() >= end.size() &&
         std::equal(end.rbegin(), end.rend(), text.rbegin(), [](char a, char b) { return a == std::tolower(b); });
}

/// Quiet while we try several ways to open.
class QuietErrors {
 public:
  QuietErrors() { CPLPushErrorHandler(CPLQuietErrorHandler); }
  ~QuietErrors() { CPLPopErrorHandler(); }
  QuietErrors(const QuietErrors&) = delete;
  QuietErrors& operator=(const QuietErrors&) = delete;
};

GDALDatasetH open_raster(const std::string& path) {
  const QuietErrors quiet;
  const auto open = [](const std::string& name) {
    return GDALOpenEx(name.c_str(), GDAL_OF_RASTER | GDAL_OF_READONLY, nullptr, nullptr, nullptr);
  };
  if (!ends_with(path, ".zip")) return open(path);
  const std::string root = "/vsizip/" + path;
  char** names = VSIReadDirRecursive(root.c_str());
  GDALDatasetH found = nullptr;
  for (int k = 0; k < CSLCount(names) && found == nullptr; ++k) found = open(root + "/" + names[k]);
  CSLDestroy(names);
  return found != nullptr ? found : open(path);
}

/// Metres in one unit that the band names; nullopt when it names none.
std::optional<double> band_unit_m(GDALRasterBandH band) {
  std::string unit = GDALGetRasterUnitType(band);
  std::transform(unit.begin(), unit.end(), unit.begin(), [](unsigned char c) { return std::tolower(c); });
  if (unit.empty()) return std::nullopt;
  if (unit == "ft" || unit == "foot" || unit == "feet" || unit == "international foot") return kFeetInMetres;
  if (unit == "us survey foot" || unit == "us-ft" || unit == "ftus" || unit == "us_ft") return kSurveyFeetInMetres;
  if (unit == "cm" || unit == "centimetre" || unit == "centimeter" || unit == "centimeters") return 0.01;
  if (unit == "dm" || unit == "decimetre" || unit == "decimeter") return 0.1;
  if (unit == "km" || unit == "kilometre" || unit == "kilometer") return 1000.0;
  return 1.0;
}

}  // namespace

std::optional<double> datum_unit_m(const SourceOptions& options) {
  if (options.vertical_datum.empty()) return std::nullopt;
  const auto datum = Crs::from_text(options.vertical_datum);
  return datum ? datum->vertical_unit_m() : std::nullopt;
}

void SourceRaster::Close::operator()(void* dataset) const { GDALClose(dataset); }

Outcome<SourceRaster> SourceRaster::open(const std::string& path, const SourceOptions& options) {
  GDALAllRegister();
  SourceRaster r;
  r.name_ = path;
  r.dataset_.reset(open_raster(path));
  if (r.dataset_ == nullptr) return refuse(path + ": no raster that GDAL can open");
  if (GDALGetRasterCount(r.dataset_.get()) < 1) return refuse(path + ": holds no band");
  if (GDALGetGeoTransform(r.dataset_.get(), r.transform_.data()) != CE_None)
    return refuse(path + ": is not georeferenced");
  const auto& t = r.transform_;
  if (t[1] * t[5] - t[2] * t[4] == 0) return refuse(path + ": its cells have no area");
  r.n_columns_ = GDALGetRasterXSize(r.dataset_.get());
  r.n_rows_ = GDALGetRasterYSize(r.dataset_.get());
  if (options.source_crs.empty()) {
    r.crs_ = Crs::copy_of(GDALGetSpatialRef(r.dataset_.get()));
  } else {
    auto crs = Crs::from_text(options.source_crs);
    if (!crs) return refuse(crs.error());
    r.crs_ = std::move(*crs);
  }
  const double far_x = t[0] + static_cast<double>(r.n_columns_) * t[1],
               far_y = t[3] + static_cast<double>(r.n_rows_) * t[5];
  const bool looks_like_degrees =
      std::max(std::abs(t[0]), std::abs(far_x)) <= 541 && std::max(std::abs(t[3]), std::abs(far_y)) <= 91;
  if (r.crs_.empty() && !looks_like_degrees) {
    return refuse(
        path + ": names no coordinate system and its coordinates are no degrees: say what they are with --source-crs");
  }
  r.is_plain_grid_ = (r.crs_.empty() || r.crs_.is_plain_geographic()) && t[2] == 0 && t[4] == 0 && t[1] > 0;

  r.band_ = GDALGetRasterBand(r.dataset_.get(), 1);
  const int mask_flags = GDALGetMaskFlags(r.band_);
  if ((mask_flags & (GMF_ALL_VALID | GMF_NODATA)) == 0) r.mask_ = GDALGetMaskBand(r.band_);
  int has_nodata = 0;
  r.nodata_ = GDALGetRasterNoDataValue(r.band_, &has_nodata);
  r.has_nodata_ = has_nodata != 0;
  if (options.nodata) {
    r.nodata_ = *options.nodata;
    r.has_nodata_ = true;
  }
  r.is_float_ = GDALGetRasterDataType(r.band_) == GDT_Float32;
  r.scale_ = GDALGetRasterScale(r.band_, nullptr);
  r.offset_ = GDALGetRasterOffset(r.band_, nullptr);
  r.unit_m_ = options.metres_per_unit.value_or(
      band_unit_m(r.band_).value_or(r.crs_.vertical_unit_m().value_or(datum_unit_m(options).value_or(1.0))));
  return r;
}

Outcome<void> SourceRaster::read(CellWindow& w) const {
  const std::int64_t column0 = std::max<std::int64_t>(0, w.column0), row0 = std::max<std::int64_t>(0, w.row0);
  w.n_columns = std::max<std::int64_t>(0, std::min(n_columns_, w.column0 + w.n_columns) - column0);
  w.n_rows = std::max<std::int64_t>(0, std::min(n_rows_, w.row0 + w.n_rows) - row0);
  w.column0 = column0;
  w.row0 = row0;
  w.heights_m.assign(static_cast<std::size_t>(w.n_columns * w.n_rows), CellWindow::kVoid);
  if (w.heights_m.empty()) return {};
  const auto fetch = [&](GDALRasterBandH band, void* into, GDALDataType type) {
    return GDALRasterIO(band, GF_Read, static_cast<int>(w.column0), static_cast<int>(w.row0),
                        static_cast<int>(w.n_columns), static_cast<int>(w.n_rows), into, static_cast<int>(w.n_columns),
                        static_cast<int>(w.n_rows), type, 0, 0) == CE_None;
  };
  if (!fetch(band_, w.heights_m.data(), GDT_Float64)) {
    return refuse(fmt::format("{}: rows {}.. cannot be read: {}", name_, w.row0, CPLGetLastErrorMsg()));
  }
  std::vector<std::uint8_t> mask;
  if (mask_ != nullptr) {
    mask.resize(w.heights_m.size());
    if (!fetch(mask_, mask.data(), GDT_Byte)) return refuse(name_ + ": its mask cannot be read");
  }
  for (std::size_t k = 0; k < w.heights_m.size(); ++k) {
    double& cell = w.heights_m[k];
    const bool marked =
        has_nodata_ && (cell == nodata_ || (is_float_ && static_cast<float>(cell) == static_cast<float>(nodata_)));
    const double metres = (cell * scale_ + offset_) * unit_m_;
    const bool is_void =
        marked || !std::isfinite(metres) || std::abs(metres) > kHighest || (!mask.empty() && mask[k] == 0);
    cell = is_void ? CellWindow::kVoid : metres;
  }
  return {};
}

}  // namespace tind::client
