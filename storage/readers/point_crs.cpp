// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/point_crs.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

#include <cpl_conv.h>
#include <cpl_vsi.h>
#include <fmt/format.h>
#include <gdal_priv.h>
#include <ogr_spatialref.h>

#include "storage/readers/gdal_errors.hpp"

namespace tind {
namespace {

constexpr std::uint16_t kVerticalUnitsKey = 4099;

/// Metres of a GeoTIFF vertical unit (EPSG unit code); nullopt: not a unit of length that files use.
std::optional<double> metres_of_unit_code(int code) {
  switch (code) {
    case 9001:
      return 1.0;
    case 9002:
      return 0.3048;
    case 9003:
      return 1200.0 / 3937.0;
    case 9005:
      return 0.3047972654;  // Clarke's foot
    case 9036:
      return 1000.0;
    default:
      return std::nullopt;
  }
}

std::string lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

/// The value of a GeoTIFF key that lies in the directory itself.
std::optional<int> short_key(const std::vector<std::uint16_t>& keys, std::uint16_t id) {
  for (std::size_t i = 4; i + 3 < keys.size(); i += 4) {
    if (keys[i] == id && keys[i + 1] == 0) return keys[i + 3];
  }
  return std::nullopt;
}

template <class T>
void put(std::vector<std::uint8_t>& out, T value) {
  const auto* bytes = reinterpret_cast<const std::uint8_t*>(&value);
  out.insert(out.end(), bytes, bytes + sizeof(T));
}

/// A TIFF of one pixel that carries the three GeoTIFF tags, so that GDAL reads them as it reads any file's.
std::vector<std::uint8_t> tiff_of(const LasCrs& crs) {
  constexpr std::uint16_t kShort = 3, kLong = 4, kDouble = 12, kAscii = 2;
  struct Tag {
    std::uint16_t id, type;
    std::uint32_t count;
    std::vector<std::uint8_t> bytes;
  };
  std::vector<Tag> tags;
  const auto number = [&](std::uint16_t id, std::uint32_t value) {
    Tag tag{id, kLong, 1, {}};
    put(tag.bytes, value);
    tags.push_back(std::move(tag));
  };
  const auto doubles = [&](std::uint16_t id, const std::vector<double>& values) {
    Tag tag{id, kDouble, static_cast<std::uint32_t>(values.size()), {}};
    for (const double v : values) put(tag.bytes, v);
    tags.push_back(std::move(tag));
  };
  number(256, 1);                      // width
  number(257, 1);                      // length
  number(258, 8);                      // bits per sample
  number(259, 1);                      // no compression
  number(262, 1);                      // black is zero
  number(273, 0);                      // strip at byte 0: its value does not matter
  number(277, 1);                      // samples per pixel
  number(278, 1);                      // rows per strip
  number(279, 1);                      // bytes of the strip
  doubles(33550, {1, 1, 0});           // pixel scale
  doubles(33922, {0, 0, 0, 0, 0, 0});  // tie point
  Tag keys{34735, kShort, static_cast<std::uint32_t>(crs.geo_keys.size()), {}};
  for (const std::uint16_t v : crs.geo_keys) put(keys.bytes, v);
  tags.push_back(std::move(keys));
  if (!crs.geo_doubles.empty()) doubles(34736, crs.geo_doubles);
  if (!crs.geo_ascii.empty()) {
    Tag tag{34737, kAscii, static_cast<std::uint32_t>(crs.geo_ascii.size() + 1), {}};
    tag.bytes.assign(crs.geo_ascii.begin(), crs.geo_ascii.end());
    tag.bytes.push_back(0);
    tags.push_back(std::move(tag));
  }
  std::vector<std::uint8_t> out = {'I', 'I', 42, 0, 8, 0, 0, 0};
  put(out, static_cast<std::uint16_t>(tags.size()));
  auto data_at = static_cast<std::uint32_t>(out.size() + tags.size() * 12 + 4);
  for (const Tag& tag : tags) {
    put(out, tag.id);
    put(out, tag.type);
    put(out, tag.count);
    if (tag.bytes.size() <= 4) {
      out.insert(out.end(), tag.bytes.begin(), tag.bytes.end());
      out.insert(out.end(), 4 - tag.bytes.size(), 0);
    } else {
      put(out, data_at);
      data_at += static_cast<std::uint32_t>(tag.bytes.size());
    }
  }
  put(out, std::uint32_t{0});  // no further directory
  for (const Tag& tag : tags) {
    if (tag.bytes.size() > 4) out.insert(out.end(), tag.bytes.begin(), tag.bytes.end());
  }
  return out;
}

/// The CRS that GDAL's GeoTIFF driver makes of the keys; empty when it makes none.
OGRSpatialReference crs_of_geo_keys(const LasCrs& crs) {
  std::vector<std::uint8_t> tiff = tiff_of(crs);
  // One name per call: other threads may read, too.
  const std::string name = fmt::format("/vsimem/tind_geo_keys_{}.tif", static_cast<const void*>(tiff.data()));
  VSIFCloseL(VSIFileFromMemBuffer(name.c_str(), tiff.data(), tiff.size(), FALSE));
  OGRSpatialReference result;
  {
    CPLConfigOptionSetter compound("GTIFF_REPORT_COMPD_CS", "YES", false);
    const char* const drivers[] = {"GTiff", nullptr};
    const GDALDatasetUniquePtr tiff_set(GDALDataset::Open(name.c_str(), GDAL_OF_RASTER, drivers));
    if (tiff_set && tiff_set->GetSpatialRef() != nullptr) result = *tiff_set->GetSpatialRef();
  }
  VSIUnlink(name.c_str());
  return result;
}

}  // namespace

PointCrs::PointCrs() = default;
PointCrs::PointCrs(PointCrs&&) noexcept = default;
PointCrs& PointCrs::operator=(PointCrs&&) noexcept = default;
PointCrs::~PointCrs() = default;

Result<PointCrs> PointCrs::from_user_input(const std::string& text, const std::string& what) {
  GdalErrors errors;
  OGRSpatialReference crs;
  if (crs.SetFromUserInput(text.c_str()) != OGRERR_NONE) {
    return fail(ErrorKind::kInvalidInput,
                fmt::format("{}: CRS \"{}\" is not known; try EPSG:n or WKT{}", what, text, errors.detail()));
  }
  PointCrs result;
  if (auto ok = result.set_up(crs, what); !ok) return tl::unexpected(ok.error());
  return result;
}

Result<std::optional<PointCrs>> PointCrs::from_las(const LasCrs& las, const std::string& path) {
  if (las.wkt.empty() && las.geo_keys.size() < 8) return std::nullopt;
  GdalErrors errors;
  GDALAllRegister();
  OGRSpatialReference crs;
  if (!las.wkt.empty()) {
    if (crs.importFromWkt(las.wkt.c_str()) != OGRERR_NONE) crs.Clear();
  } else {
    crs = crs_of_geo_keys(las);
  }
  if (crs.IsEmpty() || crs.IsLocal()) {
    return fail(ErrorKind::kInvalidInput,
                fmt::format("{}: the {} of its CRS make no sense; say what it is with --source-crs EPSG:n{}", path,
                            las.wkt.empty() ? "GeoTIFF keys" : "words (WKT)", errors.detail()));
  }
  PointCrs result;
  if (auto ok = result.set_up(crs, path); !ok) return tl::unexpected(ok.error());
  if (!crs.IsCompound() || crs.GetAttrNode("VERT_CS") == nullptr) {
    if (const auto code = short_key(las.geo_keys, kVerticalUnitsKey)) {
      if (const auto metres = metres_of_unit_code(*code)) result.metres_per_z_unit = *metres;
    }
  }
  return result;
}

Result<void> PointCrs::set_up(OGRSpatialReference& crs, const std::string& what) {
  name = crs.GetName() != nullptr ? crs.GetName() : "unnamed";
  if (const char* authority = crs.GetAuthorityName(nullptr), *code = crs.GetAuthorityCode(nullptr);
      authority != nullptr && code != nullptr) {
    name += fmt::format(" ({}:{})", authority, code);
  }
  if (crs.IsProjected()) metres_per_z_unit = crs.GetLinearUnits();
  if (const char* vertical = crs.GetAttrValue("VERT_CS"); crs.IsCompound() && vertical != nullptr) {
    const std::string known = lower(vertical);
    if (known != "unknown" && known != "unnamed") {
      vertical_datum = vertical;
      height_kind = known.find("ellipsoid") != std::string::npos ? "ellipsoidal" : "orthometric";
    }
    if (const double unit = crs.GetTargetLinearUnits("VERT_CS"); unit > 0) metres_per_z_unit = unit;
  } else if (crs.GetAxesCount() == 3) {
    vertical_datum = fmt::format("ellipsoid of {}", name);
    height_kind = "ellipsoidal";
  }
  OGRSpatialReference plan(crs);
  plan.StripVertical();
  plan.DemoteTo2D(nullptr);
  plan.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  OGRSpatialReference degrees;
  degrees.importFromEPSG(4326);
  degrees.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
  if (!plan.IsGeographic() && !plan.IsProjected()) {
    return fail(
        ErrorKind::kInvalidInput,
        fmt::format("{}: CRS \"{}\" is neither geographic nor projected; say what it is with --source-crs EPSG:n", what,
                    name));
  }
  is_identity_ = plan.IsSame(&degrees) != 0;
  if (is_identity_) return {};
  GdalErrors errors;
  transform_.reset(OGRCreateCoordinateTransformation(&plan, &degrees));
  if (!transform_) {
    return fail(
        ErrorKind::kInvalidInput,
        fmt::format("{}: PROJ knows no way from CRS \"{}\" to longitude and latitude{}", what, name, errors.detail()));
  }
  return {};
}

std::size_t PointCrs::to_degrees(std::span<double> x, std::span<double> y) const {
  constexpr double kNowhere = std::numeric_limits<double>::infinity();
  std::vector<int> ok(x.size(), TRUE);
  if (!is_identity_ && !x.empty()) {
    const GdalErrors quiet;  // what fails is counted
    transform_->Transform(static_cast<int>(x.size()), x.data(), y.data(), nullptr, ok.data());
  }
  std::size_t n_nowhere = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    const bool on_globe =
        ok[i] && std::isfinite(x[i]) && std::isfinite(y[i]) && std::abs(y[i]) <= 90.0 && std::abs(x[i]) <= 540.0;
    if (on_globe) continue;
    x[i] = y[i] = kNowhere;
    ++n_nowhere;
  }
  return n_nowhere;
}

}  // namespace tind
