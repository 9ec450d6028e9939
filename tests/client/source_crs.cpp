// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/source_crs.hpp"

#include <cpl_conv.h>
#include <cpl_error.h>
#include <cpl_vsi.h>
#include <fmt/format.h>
#include <gdal.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <utility>

namespace tind::client {
namespace {

constexpr double kNotTransformed = std::numeric_limits<double>::quiet_NaN();

/// GDAL's messages go nowhere while this lives: what failed is told by return values.
class QuietErrors {
 public:
  QuietErrors() { CPLPushErrorHandler(CPLQuietErrorHandler); }
  ~QuietErrors() { CPLPopErrorHandler(); }
  QuietErrors(const QuietErrors&) = delete;
  QuietErrors& operator=(const QuietErrors&) = delete;
};

/// The bytes of a one-pixel TIFF that carries the three GeoTIFF tags.
Blob tiff_with(const GeoKeys& keys) {
  struct Tag {
    std::uint16_t id, type;
    std::uint32_t count;
    Blob data;
  };
  const auto bytes_of = [](const void* from, std::size_t n) {
    Blob data(n);
    if (n > 0) std::memcpy(data.data(), from, n);
    return data;
  };
  const auto number = [&](std::uint16_t id, std::uint16_t value) { return Tag{id, 3, 1, bytes_of(&value, 2)}; };
  std::vector<Tag> tags = {number(256, 1), number(257, 1), number(258, 8), number(259, 1), number(262, 1),
                           number(273, 8), number(277, 1), number(278, 1), number(279, 1)};
  tags.push_back({34735, 3, static_cast<std::uint32_t>(keys.directory.size()),
                  bytes_of(keys.directory.data(), keys.directory.size() * 2)});
  if (!keys.doubles.empty()) {
    tags.push_back({34736, 12, static_cast<std::uint32_t>(keys.doubles.size()),
                    bytes_of(keys.doubles.data(), keys.doubles.size() * 8)});
  }
  if (!keys.text.empty()) {
    tags.push_back({34737, 2, static_cast<std::uint32_t>(keys.text.size() + 1),
                    bytes_of(keys.text.c_str(), keys.text.size() + 1)});
  }
  Blob out = {'I', 'I', 42, 0, 10, 0, 0, 0, 0, 0};  // The pixel is the byte at 8; the directory starts at 10.
  const auto put = [](Blob& into, std::uint64_t value, int n) {
    for (int k = 0; k < n; ++k) into.push_back(static_cast<std::uint8_t>(value >> (8 * k)));
  };
  put(out, tags.size(), 2);
  Blob after;
  const std::size_t after_at = out.size() + tags.size() * 12 + 4;
  for (const Tag& tag : tags) {
    put(out, tag.id, 2);
    put(out, tag.type, 2);
    put(out, tag.count, 4);
    if (tag.data.size() <= 4) {
      out.insert(out.end(), tag.data.begin(), tag.data.end());
      out.resize(out.size() + 4 - tag.data.size());
    } else {
      put(out, after_at + after.size(), 4);
      after.insert(after.end(), tag.data.begin(), tag.data.end());
    }
  }
  put(out, 0, 4);
  out.insert(out.end(), after.begin(), after.end());
  return out;
}

/// A transform that must really have its grids: PROJ would otherwise leave heights as they are and say nothing.
OGRCoordinateTransformationH exact_transform(const Crs& from, const Crs& to) {
  const auto options = OCTNewCoordinateTransformationOptions();
  OCTCoordinateTransformationOptionsSetBallparkAllowed(options, 0);
  const auto transform = OCTNewCoordinateTransformationEx(from.get(), to.get(), options);
  OCTDestroyCoordinateTransformationOptions(options);
  return transform;
}

std::shared_ptr<void> owned(OGRCoordinateTransformationH transform) {
  if (transform == nullptr) return nullptr;
  return {transform, [](void* t) { OCTDestroyCoordinateTransformation(t); }};
}

}  // namespace

Outcome<Crs> Crs::from_text(const std::string& text) {
  const QuietErrors quiet;
  Crs crs(OSRNewSpatialReference(nullptr));
  if (OSRSetFromUserInput(crs.get(), text.c_str()) != OGRERR_NONE) {
    return refuse("'" + text + "' is no coordinate system that GDAL knows");
  }
  OSRSetAxisMappingStrategy(crs.get(), OAMS_TRADITIONAL_GIS_ORDER);
  return crs;
}

Crs Crs::copy_of(OGRSpatialReferenceH handle) {
  if (handle == nullptr) return {};
  Crs crs(OSRClone(handle));
  OSRSetAxisMappingStrategy(crs.get(), OAMS_TRADITIONAL_GIS_ORDER);
  return crs;
}

Outcome<Crs> Crs::from_geo_keys(const GeoKeys& keys) {
  GDALAllRegister();
  const QuietErrors quiet;
  Blob bytes = tiff_with(keys);
  const std::string path = fmt::format("/vsimem/tind_client_keys_{}.tif", static_cast<const void*>(&bytes));
  VSIFCloseL(VSIFileFromMemBuffer(path.c_str(), bytes.data(), bytes.size(), FALSE));
  Crs crs;
  if (GDALDatasetH dataset = GDALOpenEx(path.c_str(), GDAL_OF_RASTER, nullptr, nullptr, nullptr)) {
    crs = copy_of(GDALGetSpatialRef(dataset));
    GDALClose(dataset);
  }
  VSIUnlink(path.c_str());
  if (crs.empty()) return refuse("its GeoTIFF keys name no coordinate system");
  return crs;
}

std::string Crs::name() const {
  const char* text = empty() ? nullptr : OSRGetName(get());
  return text != nullptr ? text : "none";
}

bool Crs::is_geographic() const { return !empty() && OSRIsGeographic(get()) != 0; }

bool Crs::is_plain_geographic() const {
  if (!is_geographic()) return false;
  const double degree = std::acos(-1.0) / 180;
  return std::abs(OSRGetAngularUnits(get(), nullptr) - degree) < 1e-12 &&
         std::abs(OSRGetPrimeMeridian(get(), nullptr)) < 1e-12;
}

double Crs::linear_unit_m() const {
  return empty() || OSRIsProjected(get()) == 0 ? 1.0 : OSRGetTargetLinearUnits(get(), "PROJCS", nullptr);
}

std::optional<double> Crs::vertical_unit_m() const {
  if (empty() || (OSRIsCompound(get()) == 0 && OSRIsVertical(get()) == 0)) return std::nullopt;
  return OSRGetTargetLinearUnits(get(), "VERT_CS", nullptr);
}

Crs Crs::horizontal() const {
  if (empty() || OSRIsCompound(get()) == 0) return *this;
  Crs crs = copy_of(get());
  OSRStripVertical(crs.get());
  OSRSetAxisMappingStrategy(crs.get(), OAMS_TRADITIONAL_GIS_ORDER);
  return crs;
}

Outcome<Transform> Transform::make(const Crs& from, const Crs& to) {
  const QuietErrors quiet;
  Transform transform;
  transform.handle_.reset(OCTNewCoordinateTransformation(from.get(), to.get()));
  if (transform.handle_ == nullptr)
    return refuse(fmt::format("PROJ knows no way from '{}' to '{}'", from.name(), to.name()));
  return transform;
}

void Transform::apply(std::vector<double>& x, std::vector<double>& y, std::vector<double>* z) const {
  const QuietErrors quiet;
  std::vector<int> good(x.size(), 0);
  OCTTransformEx(handle_.get(), static_cast<int>(x.size()), x.data(), y.data(), z != nullptr ? z->data() : nullptr,
                 good.data());
  for (std::size_t k = 0; k < x.size(); ++k) {
    if (good[k] != 0 && std::isfinite(x[k]) && std::isfinite(y[k])) continue;
    x[k] = y[k] = kNotTransformed;
    if (z != nullptr) (*z)[k] = kNotTransformed;
  }
}

Outcome<GeoidShift> GeoidShift::from_datum(const std::string& vertical_datum) {
  auto given = Crs::from_text(vertical_datum);
  if (!given) return refuse(given.error());
  const QuietErrors quiet;
  GeoidShift shift;
  shift.what_ = vertical_datum;
  const bool is_compound = OSRIsCompound(given->get()) != 0;
  if (!is_compound && given->is_geographic() && OSRGetAxesCount(given->get()) == 3) return shift;
  const auto globe = Crs::from_text("EPSG:4326"), globe_up = Crs::from_text("EPSG:4979");
  auto from = is_compound ? given : Crs::from_text("EPSG:4326");
  if (!globe || !globe_up || !from) return refuse("PROJ's database is missing");
  if (!is_compound && OSRIsVertical(given->get()) != 0) {
    if (OSRSetCompoundCS(from->get(), "WGS 84 with these heights", globe->get(), given->get()) != OGRERR_NONE) {
      return refuse("'" + vertical_datum + "' cannot be used with WGS 84");
    }
    OSRSetAxisMappingStrategy(from->get(), OAMS_TRADITIONAL_GIS_ORDER);
  } else if (!is_compound || !given->horizontal().is_plain_geographic()) {
    return refuse("'" + vertical_datum + "' is no vertical system: give one such as EPSG:5773 (EGM96)");
  }
  auto transform = exact_transform(*from, *globe_up);
  if (transform == nullptr && is_compound) {
    const Crs own = Crs::copy_of(given->horizontal().get());
    OSRPromoteTo3D(own.get(), nullptr);
    OSRSetAxisMappingStrategy(own.get(), OAMS_TRADITIONAL_GIS_ORDER);
    transform = exact_transform(*from, own);
  }
  if (transform == nullptr) {
    return refuse("PROJ has no grid for '" + vertical_datum + "': install it (projsync, or Debian's proj-data)");
  }
  shift.handle_ = owned(transform);
  return shift;
}

Outcome<GeoidShift> GeoidShift::from_grid(const std::string& path) {
  std::error_code error;
  const bool there = std::filesystem::is_regular_file(path, error);
  const bool bare = path.find('/') == path.npos;
  if (!there && !bare) return refuse(path + ": there is no such geoid grid");
  const std::string name = there ? std::filesystem::absolute(path, error).string() : path;
  const auto from = Crs::from_text("+proj=longlat +datum=WGS84 +geoidgrids=" + name + " +vunits=m +no_defs +type=crs");
  const auto to = Crs::from_text("EPSG:4979");
  GeoidShift shift;
  shift.what_ = path;
  const QuietErrors quiet;
  if (from && to) shift.handle_ = owned(exact_transform(*from, *to));
  if (shift.handle_ == nullptr) return refuse(path + ": is no geoid grid that PROJ reads (.gtx, .tif)");
  return shift;
}

Outcome<std::vector<double>> GeoidShift::undulation_m(const std::vector<double>& lon_deg,
                                                      const std::vector<double>& lat_deg) const {
  const QuietErrors quiet;
  std::vector<double> x = lon_deg, y = lat_deg, z(lon_deg.size(), 0.0);
  if (handle_ == nullptr) return z;
  for (double& lon : x) lon -= 360 * std::floor((lon + 180) / 360);
  std::vector<int> good(x.size(), 0);
  OCTTransformEx(handle_.get(), static_cast<int>(x.size()), x.data(), y.data(), z.data(), good.data());
  for (std::size_t k = 0; k < z.size(); ++k) {
    if (good[k] == 0 || !std::isfinite(z[k])) {
      return refuse(
          fmt::format("{}: has no value at longitude {:.6f}, latitude {:.6f}", what_, lon_deg[k], lat_deg[k]));
    }
  }
  return z;
}

}  // namespace tind::client
