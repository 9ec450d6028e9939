// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/source_posts.hpp"

#include <cpl_conv.h>
#include <cpl_string.h>
#include <cpl_vsi.h>
#include <fmt/format.h>
#include <gdal.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

namespace tind::client {
namespace {

constexpr double kFeetInMetres = 0.3048;
constexpr double kSurveyFeetInMetres = 1200.0 / 3937.0;
/// Grids may be shifted against each other by this share of a post.
constexpr double kAlignment = 1e-3;

struct CloseDataset {
  void operator()(void* dataset) const { GDALClose(dataset); }
};
using Dataset = std::unique_ptr<void, CloseDataset>;

struct OneSource {
  Dataset dataset;
  std::string name;
  double west_deg = 0, south_deg = 0, dx_deg = 0, dy_deg = 0;
  int n_cols = 0, n_rows = 0;
  bool north_up = true;
};

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

Dataset open_raster(const std::string& path) {
  const QuietErrors quiet;
  const auto open = [](const std::string& name) {
    return Dataset(GDALOpenEx(name.c_str(), GDAL_OF_RASTER | GDAL_OF_READONLY, nullptr, nullptr, nullptr));
  };
  if (!ends_with(path, ".zip")) return open(path);
  const std::string root = "/vsizip/" + path;
  char** names = VSIReadDirRecursive(root.c_str());
  Dataset found;
  for (int k = 0; k < CSLCount(names) && found == nullptr; ++k) found = open(root + "/" + names[k]);
  CSLDestroy(names);
  return found != nullptr ? std::move(found) : open(path);
}

Outcome<OneSource> open_source(const std::string& path) {
  OneSource source;
  source.name = path;
  source.dataset = open_raster(path);
  if (source.dataset == nullptr) return refuse(path + ": no raster that GDAL can open");
  if (GDALGetRasterCount(source.dataset.get()) < 1) return refuse(path + ": holds no band");
  double gt[6];
  if (GDALGetGeoTransform(source.dataset.get(), gt) != CE_None) return refuse(path + ": is not georeferenced");
  if (gt[2] != 0 || gt[4] != 0 || gt[1] <= 0 || gt[5] == 0) return refuse(path + ": is rotated or mirrored");
  source.n_cols = GDALGetRasterXSize(source.dataset.get());
  source.n_rows = GDALGetRasterYSize(source.dataset.get());
  source.north_up = gt[5] < 0;
  source.dx_deg = gt[1];
  source.dy_deg = std::abs(gt[5]);
  source.west_deg = gt[0] + 0.5 * gt[1];
  source.south_deg = source.north_up ? gt[3] + (source.n_rows - 0.5) * gt[5] : gt[3] + 0.5 * gt[5];
  return source;
}

double unit_in_metres(GDALRasterBandH band) {
  std::string unit = GDALGetRasterUnitType(band);
  std::transform(unit.begin(), unit.end(), unit.begin(), [](unsigned char c) { return std::tolower(c); });
  if (unit == "ft" || unit == "foot" || unit == "feet" || unit == "international foot") return kFeetInMetres;
  if (unit == "us survey foot" || unit == "us-ft" || unit == "ftus" || unit == "us_ft") return kSurveyFeetInMetres;
  if (unit == "cm" || unit == "centimetre" || unit == "centimeter" || unit == "centimeters") return 0.01;
  if (unit == "dm" || unit == "decimetre" || unit == "decimeter") return 0.1;
  if (unit == "km" || unit == "kilometre" || unit == "kilometer") return 1000.0;
  return 1.0;
}

/// Adds one value to the post; keeps every different value.
void add_value(SourcePosts& posts, std::int64_t at, float height) {
  float& first = posts.heights_m[static_cast<std::size_t>(at)];
  if (std::isnan(first)) {
    first = height;
    ++posts.n_posts;
    return;
  }
  if (first == height) return;
  auto& others = posts.other_values[at];
  if (std::find(others.begin(), others.end(), height) != others.end()) return;
  double widest = std::abs(static_cast<double>(height) - static_cast<double>(first));
  for (const float other : others)
    widest = std::max(widest, std::abs(static_cast<double>(height) - static_cast<double>(other)));
  posts.disagreement_m = std::max(posts.disagreement_m, widest);
  others.push_back(height);
}

Outcome<void> read_into(const OneSource& source, const SourceOptions& options, SourcePosts& posts) {
  GDALRasterBandH band = GDALGetRasterBand(source.dataset.get(), 1);
  int has_nodata = 0;
  double nodata = GDALGetRasterNoDataValue(band, &has_nodata);
  if (options.nodata) {
    nodata = *options.nodata;
    has_nodata = 1;
  }
  const bool is_float = GDALGetRasterDataType(band) == GDT_Float32;
  const double scale = GDALGetRasterScale(band, nullptr), offset = GDALGetRasterOffset(band, nullptr);
  const double unit = options.metres_per_unit ? *options.metres_per_unit : unit_in_metres(band);
  const auto is_void = [&](double raw) {
    if (!std::isfinite(raw)) return true;
    if (has_nodata == 0) return false;
    return raw == nodata || (is_float && static_cast<float>(raw) == static_cast<float>(nodata));
  };
  const auto column0 = std::llround((source.west_deg - posts.west_deg) / posts.lon_spacing_deg);
  const auto row0 = std::llround((source.south_deg - posts.south_deg) / posts.lat_spacing_deg);
  // The columns close around the globe when this many make 360 degrees.
  const double around = 360.0 / posts.lon_spacing_deg;
  const auto period = std::abs(around - std::round(around)) < kAlignment ? std::llround(around) : 0;
  std::vector<double> line(static_cast<std::size_t>(source.n_cols));
  for (int r = 0; r < source.n_rows; ++r) {
    const int file_row = source.north_up ? source.n_rows - 1 - r : r;
    if (GDALRasterIO(band, GF_Read, 0, file_row, source.n_cols, 1, line.data(), source.n_cols, 1, GDT_Float64, 0, 0) !=
        CE_None) {
      return refuse(fmt::format("{}: row {} cannot be read: {}", source.name, file_row, CPLGetLastErrorMsg()));
    }
    for (int c = 0; c < source.n_cols; ++c) {
      const double raw = line[static_cast<std::size_t>(c)];
      if (is_void(raw)) continue;
      const double metres = (raw * scale + offset) * unit;
      const auto height = static_cast<float>(metres);
      posts.rounded = posts.rounded || static_cast<double>(height) != metres;
      std::int64_t column = column0 + c;
      if (period > 0 && column >= period) column -= period;
      add_value(posts, (row0 + r) * posts.n_cols + column, height);
    }
  }
  return {};
}

}  // namespace

Outcome<SourcePosts> read_source_posts(const std::vector<std::string>& paths, const SourceOptions& options) {
  GDALAllRegister();
  std::vector<OneSource> sources;
  for (const auto& path : paths) {
    auto source = open_source(path);
    if (!source) return refuse(source.error());
    sources.push_back(std::move(*source));
  }
  if (sources.empty()) return refuse("no source");
  SourcePosts posts;
  posts.lon_spacing_deg = sources[0].dx_deg;
  posts.lat_spacing_deg = sources[0].dy_deg;
  double west = sources[0].west_deg, south = sources[0].south_deg, east = west, north = south;
  for (const auto& s : sources) {
    const auto off = [](double distance, double spacing) {
      const double steps = distance / spacing;
      return std::abs(steps - std::round(steps));
    };
    if (std::abs(s.dx_deg - posts.lon_spacing_deg) * s.n_cols > kAlignment * posts.lon_spacing_deg ||
        std::abs(s.dy_deg - posts.lat_spacing_deg) * s.n_rows > kAlignment * posts.lat_spacing_deg ||
        off(s.west_deg - sources[0].west_deg, posts.lon_spacing_deg) > kAlignment ||
        off(s.south_deg - sources[0].south_deg, posts.lat_spacing_deg) > kAlignment) {
      return refuse(s.name + ": is not on the same grid of posts as " + sources[0].name);
    }
    west = std::min(west, s.west_deg);
    south = std::min(south, s.south_deg);
    east = std::max(east, s.west_deg + (s.n_cols - 1) * s.dx_deg);
    north = std::max(north, s.south_deg + (s.n_rows - 1) * s.dy_deg);
    posts.names.push_back(s.name);
  }
  posts.west_deg = west;
  posts.south_deg = south;
  posts.n_cols = std::llround((east - west) / posts.lon_spacing_deg) + 1;
  posts.n_rows = std::llround((north - south) / posts.lat_spacing_deg) + 1;
  if (posts.n_cols > (std::int64_t{1} << 31) / posts.n_rows) return refuse("the sources span more than 2^31 posts");
  posts.heights_m.assign(static_cast<std::size_t>(posts.n_cols * posts.n_rows),
                         std::numeric_limits<float>::quiet_NaN());
  for (const auto& s : sources) {
    if (auto ok = read_into(s, options, posts); !ok) return refuse(ok.error());
  }
  if (posts.n_posts == 0) return refuse(paths[0] + ": no post has a height");
  return posts;
}

}  // namespace tind::client
