// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/raster_file.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstring>
#include <optional>
#include <utility>

#include <cpl_string.h>
#include <cpl_vsi.h>
#include <fmt/format.h>

#include "storage/readers/gdal_errors.hpp"

namespace tind {
namespace {

/// A spacing that misses one whole part of a degree by less than this share of a post over the whole raster is a
/// decimal rounding of it.
constexpr double kSnapPosts = 1e-4;
/// A raster that misses closing around the globe by less than this share of a post has a rounded spacing in its header.
constexpr double kClosePosts = 0.1;
/// Semi-major axes that are the Earth's.
constexpr double kEarthLeastM = 6370000, kEarthMostM = 6385000;
constexpr double kDegreeInRadians = 0.0174532925199433;

std::string lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

bool ends_with_zip(const std::string& path) { return path.size() > 4 && lower(path.substr(path.size() - 4)) == ".zip"; }

/// The GDAL name of the one raster in a zip archive.
Result<std::string> raster_in_zip(const RasterFile& s) {
  const std::string root = "/vsizip/" + s.info.path;
  const CPLStringList entries(VSIReadDirRecursive(root.c_str()));
  std::vector<std::string> rasters;
  for (int i = 0; i < entries.Count(); ++i) {
    const std::string name = root + "/" + entries[i];
    if (name.back() != '/' && GDALIdentifyDriverEx(name.c_str(), GDAL_OF_RASTER, nullptr, nullptr))
      rasters.push_back(name);
  }
  if (rasters.size() == 1) return rasters[0];
  if (entries.Count() == 0) return bad_raster(s, "not a zip archive, or an empty or truncated one");
  if (rasters.empty()) return bad_raster(s, "the archive holds no raster that GDAL reads");
  return bad_raster(s,
                    fmt::format("the archive holds {} rasters; name one, for example {}", rasters.size(), rasters[0]));
}

/// Metres per vertical unit by the names that rasters use; nullopt: unknown.
std::optional<double> metres_per_unit(const std::string& unit) {
  std::string name;
  for (const char c : lower(unit)) name += c == '_' || c == '-' ? ' ' : c;
  const auto is_one_of = [&](std::initializer_list<const char*> names) {
    return std::any_of(names.begin(), names.end(), [&](const char* n) { return name == n; });
  };
  if (is_one_of({"", "m", "metre", "metres", "meter", "meters"})) return 1.0;
  if (is_one_of({"ft", "foot", "feet", "international foot", "international feet"})) return 0.3048;
  if (is_one_of({"us survey foot", "us survey feet", "foot us", "ftus", "us ft", "us foot", "u.s. survey foot",
                 "survey foot"}))
    return 1200.0 / 3937.0;
  if (is_one_of({"dm", "decimetre", "decimeter", "decimetres", "decimeters"})) return 0.1;
  if (is_one_of({"cm", "centimetre", "centimeter", "centimetres", "centimeters"})) return 0.01;
  if (is_one_of({"mm", "millimetre", "millimeter", "millimetres", "millimeters"})) return 0.001;
  if (is_one_of({"km", "kilometre", "kilometer", "kilometres", "kilometers"})) return 1000.0;
  return std::nullopt;
}

/// The spacing with which n columns (or all but a repeated last one) close exactly around the globe, if they nearly do.
std::optional<double> closing_spacing(double spacing, std::int64_t n) {
  for (const auto columns : {static_cast<double>(n), static_cast<double>(n - 1)}) {
    if (std::abs(columns - 360.0 / spacing) <= kClosePosts) return 360.0 / columns;
  }
  return std::nullopt;
}

double snap_spacing(double spacing, std::int64_t n) {
  const double per_degree = 1.0 / spacing, whole = std::round(per_degree);
  const bool close = whole >= 1 && std::abs(per_degree - whole) / per_degree * static_cast<double>(n) <= kSnapPosts;
  return close ? 1.0 / whole : spacing;
}

bool is_earth(const OGRSpatialReference& crs) {
  return crs.GetSemiMajor() >= kEarthLeastM && crs.GetSemiMajor() <= kEarthMostM;
}

/// "WGS 84 / UTM zone 11N (EPSG:32611)".
std::string crs_text(const OGRSpatialReference& crs) {
  const char* name = crs.GetName();
  const char *authority = crs.GetAuthorityName(nullptr), *code = crs.GetAuthorityCode(nullptr);
  std::string text = name != nullptr ? name : "unnamed";
  if (authority != nullptr && code != nullptr) text += fmt::format(" ({}:{})", authority, code);
  return text;
}

/// Corners of the raster in its own coordinates lie within the degrees that a globe has, with some slack.
bool looks_like_degrees(const RasterFile& s) {
  const auto& gt = s.geotransform;
  const auto n_cols = static_cast<double>(s.info.n_cols), n_rows = static_cast<double>(s.info.n_rows);
  for (const double c : {0.0, n_cols}) {
    for (const double r : {0.0, n_rows}) {
      const double x = gt[0] + c * gt[1] + r * gt[2], y = gt[3] + c * gt[4] + r * gt[5];
      if (!(x >= -361 && x <= 541 && y >= -95 && y <= 95)) return false;
    }
  }
  return true;
}

/// What the file's CRS says of its heights; leaves the horizontal part in s.crs.
void take_vertical_part(RasterFile& s) {
  if (const char* name = s.crs.GetAttrValue("VERT_CS"); s.crs.IsCompound() && name != nullptr) {
    const std::string known = lower(name);
    if (known != "unknown" && known != "unnamed") {
      s.vertical_datum = name;
      s.height_kind = known.find("ellipsoid") != std::string::npos ? "ellipsoidal" : "orthometric";
    }
    s.crs.StripVertical();
  } else if (s.crs.GetAxesCount() == 3 && (s.crs.IsGeographic() || s.crs.IsProjected())) {
    s.crs.DemoteTo2D(nullptr);
    s.vertical_datum = fmt::format("ellipsoid of {}", s.crs.GetName() != nullptr ? s.crs.GetName() : "the CRS");
    s.height_kind = "ellipsoidal";
  }
}

Result<void> read_crs(RasterFile& s) {
  const OGRSpatialReference* crs = s.dataset->GetSpatialRef();
  if (crs == nullptr || crs->IsEmpty()) {
    if (!looks_like_degrees(s)) {
      return bad_raster(s,
                        "no CRS, and its coordinates are not degrees; give it one with gdal_translate -a_srs EPSG:N");
    }
    s.notes.push_back(fmt::format("{}: no CRS; its degrees are taken as EPSG:4326", s.info.name));
    s.info.crs_is_assumed = true;
    s.crs.SetWellKnownGeogCS("WGS84");
    s.crs.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
    s.info.crs = crs_text(s.crs);
    return {};
  }
  s.crs = *crs;
  if (s.crs.IsLocal() || s.crs.IsGeocentric() || !(s.crs.IsGeographic() || s.crs.IsProjected())) {
    return bad_raster(s, fmt::format("CRS \"{}\" does not say where on the globe it lies; give it the right one with "
                                     "gdal_translate -a_srs EPSG:N",
                                     s.crs.GetName() != nullptr ? s.crs.GetName() : "?"));
  }
  take_vertical_part(s);
  s.info.crs = crs_text(s.crs);
  return {};
}

/// Finds out whether the file's posts can be taken as they are, and where they lie.
Result<void> read_own_grid(RasterFile& s) {
  const auto& gt = s.geotransform;
  const double pixel = std::max(std::abs(gt[1]), std::abs(gt[5]));
  const bool aligned = std::abs(gt[2]) <= 1e-9 * pixel && std::abs(gt[4]) <= 1e-9 * pixel && gt[1] > 0;
  const bool degrees = s.crs.IsGeographic() && !s.crs.IsDerivedGeographic() &&
                       std::abs(s.crs.GetAngularUnits() / kDegreeInRadians - 1) <= 1e-9 &&
                       std::abs(s.crs.GetPrimeMeridian()) <= 1e-12;
  s.has_own_grid = aligned && degrees;
  if (!is_earth(s.crs)) {
    if (!s.has_own_grid) {
      return bad_raster(s, fmt::format("CRS \"{}\" is not one of the Earth; warp it to the latitudes and longitudes of "
                                       "its own body first: gdalwarp -t_srs",
                                       s.crs.GetName() != nullptr ? s.crs.GetName() : "?"));
    }
    s.own_grid_notes.push_back(
        fmt::format("{}: not a CRS of the Earth; its latitudes and longitudes are used as they are", s.info.name));
  } else if (const char* datum = s.crs.GetAttrValue("DATUM"); datum != nullptr && std::strstr(datum, "1927")) {
    s.own_grid_notes.push_back(
        fmt::format("{}: datum {} is taken as WGS 84 without a shift (it may be off by 100 m; gdalwarp "
                    "-t_srs EPSG:4326 shifts it)",
                    s.info.name, datum));
  }
  if (!s.has_own_grid) {
    s.why_not_own = fmt::format("{}: {}", s.info.name,
                                degrees ? "its rows do not run along parallels"
                                        : fmt::format("its CRS {} does not count degrees from Greenwich", s.info.crs));
    return {};
  }

  s.north_up = gt[5] < 0;
  s.dx = snap_spacing(gt[1], s.info.n_cols);
  s.dy = snap_spacing(std::abs(gt[5]), s.info.n_rows);
  if (const auto closing = closing_spacing(gt[1], s.info.n_cols)) {
    if (std::abs(*closing / s.dx - 1) * static_cast<double>(s.info.n_cols) > kAlignPosts) {
      s.own_grid_notes.push_back(fmt::format(
          "{}: its columns reach around the globe but for {:.3f} of a post; their spacing is taken as {} degrees",
          s.info.name, std::abs(360.0 / gt[1] - 360.0 / *closing), *closing));
    }
    s.dx = *closing;
  }
  const double south_row = s.north_up ? static_cast<double>(s.info.n_rows) - 0.5 : 0.5;
  s.west = snap_origin(gt[0] + 0.5 * gt[1], s.dx);
  s.south = snap_origin(gt[3] + south_row * gt[5], s.dy);

  // Rows beyond a pole are no place on the globe.
  if (!looks_like_degrees(s))
    return bad_raster(s, "lies outside the globe's degrees; check its CRS and geotransform with gdalinfo");
  const auto rows_to = [&](double latitude) { return (latitude - s.south) / s.dy; };
  s.skip_south = std::max<std::int64_t>(0, std::llround(std::ceil(rows_to(-90.0) - kAlignPosts)));
  const auto last = std::min(s.info.n_rows - 1, std::int64_t{std::llround(std::floor(rows_to(90.0) + kAlignPosts))});
  s.info.n_used_rows = last - s.skip_south + 1;
  s.info.n_used_cols = s.info.n_cols;
  if (s.info.n_used_rows < 2)
    return bad_raster(s, "lies outside the globe's degrees; check its CRS and geotransform with gdalinfo");
  if (s.info.n_used_rows < s.info.n_rows) {
    s.own_grid_notes.push_back(
        fmt::format("{}: {} rows beyond a pole are left out", s.info.name, s.info.n_rows - s.info.n_used_rows));
  }
  s.south += static_cast<double>(s.skip_south) * s.dy;
  s.west -= 360.0 * std::floor((s.west + 180.0 + kAlignPosts * s.dx) / 360.0);
  return {};
}

/// Mean length of a cell's two sides in metres, by the CRS's own unit; degrees along the equator and a meridian.
double mean_spacing_m(const RasterFile& s) {
  const auto& gt = s.geotransform;
  const double unit_m =
      s.crs.IsGeographic() ? s.crs.GetAngularUnits() * s.crs.GetSemiMajor() : s.crs.GetLinearUnits(nullptr);
  return (std::hypot(gt[1], gt[4]) + std::hypot(gt[2], gt[5])) / 2 * unit_m;
}

Result<void> read_vertical(RasterFile& s, GDALRasterBand& band, const RasterOptions& options, double vertical_unit_m) {
  int has_nodata = 0;
  const double nodata = band.GetNoDataValue(&has_nodata);
  s.has_nodata = has_nodata != 0 || options.nodata.has_value();
  s.nodata = options.nodata.value_or(nodata);
  s.has_mask = (band.GetMaskFlags() & (GMF_PER_DATASET | GMF_ALPHA)) != 0;
  // A nodata value of a float32 band is often written with fewer digits than the posts have.
  s.is_float32 = band.GetRasterDataType() == GDT_Float32;

  double factor = vertical_unit_m;
  if (options.metres_per_unit) {
    factor = *options.metres_per_unit;
    if (!(factor > 0) || !std::isfinite(factor)) {
      return fail(ErrorKind::kInvalidInput, fmt::format("{} metres per unit is not a positive number", factor));
    }
  } else if (const std::string unit = band.GetUnitType(); !unit.empty()) {
    const auto known = metres_per_unit(unit);
    if (!known) {
      return bad_raster(
          s, fmt::format("vertical unit \"{}\" is not known; say how many metres it has with --metres-per-unit", unit));
    }
    factor = *known;
  } else if (const auto* crs = s.dataset->GetSpatialRef(); crs != nullptr && crs->GetAttrNode("VERT_CS")) {
    const double vertical = crs->GetTargetLinearUnits("VERT_CS", nullptr);
    if (vertical > 0) factor = vertical;
  } else {
    s.info.unit_is_assumed = true;
  }
  int has_scale = 0, has_offset = 0;
  const double scale = band.GetScale(&has_scale), offset = band.GetOffset(&has_offset);
  s.scale = (has_scale ? scale : 1.0) * factor;
  s.offset = (has_offset ? offset : 0.0) * factor;
  if (!std::isfinite(s.scale) || s.scale == 0 || !std::isfinite(s.offset))
    return bad_raster(s, "its scale or offset is broken");
  return {};
}

/// GDAL reads what a raw binary file lacks as zeros, without a word.
bool raw_file_is_short(GDALDataset& dataset) {
  const std::string driver = dataset.GetDriver()->GetDescription();
  GDALRasterBand& band = *dataset.GetRasterBand(1);
  const char* compression = dataset.GetMetadataItem("file_compression", "ENVI");
  if ((driver != "ENVI" && driver != "EHdr") || band.GetMetadataItem("NBITS", "IMAGE_STRUCTURE") != nullptr ||
      (compression != nullptr && std::string(compression) != "0")) {
    return false;
  }
  VSIStatBufL stat;
  const auto needed = static_cast<vsi_l_offset>(dataset.GetRasterXSize()) *
                      static_cast<vsi_l_offset>(dataset.GetRasterYSize()) *
                      static_cast<vsi_l_offset>(GDALGetDataTypeSizeBytes(band.GetRasterDataType()));
  return VSIStatL(dataset.GetDescription(), &stat) == 0 && static_cast<vsi_l_offset>(stat.st_size) < needed;
}

/// Whether any row is found at once, by any number of datasets side by side: text and archives are read from their
/// beginning, and not every format's library is for several threads.
bool reads_anywhere(GDALDataset& dataset, const std::string& gdal_name) {
  const std::string driver = dataset.GetDriver()->GetDescription();
  return !gdal_name.starts_with("/vsi") &&
         (driver == "EHdr" || driver == "ENVI" || driver == "GTiff" || driver == "SRTMHGT");
}

Result<GDALDatasetUniquePtr> open_dataset(const RasterFile& s) {
  GdalErrors errors;
  GDALDatasetUniquePtr dataset(
      GDALDataset::Open(s.gdal_name.c_str(), GDAL_OF_RASTER | GDAL_OF_READONLY | GDAL_OF_VERBOSE_ERROR));
  if (dataset) return dataset;
  VSIStatBufL stat;
  if (VSIStatL(s.info.path.c_str(), &stat) != 0) {
    // A name with a colon may be a GDAL connection string; then GDAL's words say more.
    return bad_raster(
        s, s.info.path.find(':') == std::string::npos ? "no such file" : "cannot be opened" + errors.detail());
  }
  if (VSI_ISDIR(stat.st_mode)) return bad_raster(s, "is a folder; name the raster files in it");
  if (stat.st_size == 0) return bad_raster(s, "is an empty file");
  return bad_raster(s, "not a raster that GDAL can read, or a truncated one" + errors.detail());
}

/// Size, band and geotransform.
Result<void> read_frame(RasterFile& s) {
  if (s.dataset->GetRasterCount() == 0) {
    return bad_raster(s, s.dataset->GetMetadata("SUBDATASETS") != nullptr
                             ? "holds several rasters; name one as gdalinfo lists it (SUBDATASET_1_NAME)"
                             : "holds no raster band");
  }
  s.info.n_cols = s.dataset->GetRasterXSize();
  s.info.n_rows = s.dataset->GetRasterYSize();
  if (s.info.n_cols < 2 || s.info.n_rows < 2) return bad_raster(s, "needs at least 2 x 2 posts");
  if (s.dataset->GetRasterCount() > 1) {
    s.notes.push_back(
        fmt::format("{}: {} bands; heights are read from band 1", s.info.name, s.dataset->GetRasterCount()));
  }
  if (raw_file_is_short(*s.dataset)) return bad_raster(s, "is truncated: shorter than its header says");
  int block_width = 0, block_height = 0;
  s.dataset->GetRasterBand(1)->GetBlockSize(&block_width, &block_height);
  s.has_row_blocks = block_height == 1 && reads_anywhere(*s.dataset, s.gdal_name);
  if (GDALDataTypeIsComplex(s.dataset->GetRasterBand(1)->GetRasterDataType()))
    return bad_raster(s, "band 1 holds complex numbers, not heights");

  auto& gt = s.geotransform;
  if (s.dataset->GetGeoTransform(gt.data()) != CE_None) {
    return bad_raster(s, s.dataset->GetGCPCount() > 0
                             ? "placed by ground control points; warp it first: gdalwarp -t_srs EPSG:4326 IN OUT"
                             : "has no geotransform, so nothing says where it lies; set one with "
                               "gdal_translate -a_ullr");
  }
  const double cell = std::abs(gt[1] * gt[5] - gt[2] * gt[4]);
  const double longest = std::max(std::hypot(gt[1], gt[4]), std::hypot(gt[2], gt[5]));
  if (!std::all_of(gt.begin(), gt.end(), [](double v) { return std::isfinite(v); }) || !(cell > 0) ||
      !(cell > 1e-12 * longest * longest) || !std::isfinite(cell)) {
    return bad_raster(s,
                      "its geotransform is broken: cells without an area cannot be found on the globe; set it right "
                      "with gdal_translate -a_ullr");
  }
  return {};
}

}  // namespace

tl::unexpected<Error> bad_raster(const RasterFile& file, const std::string& what) {
  return fail(ErrorKind::kInvalidInput, fmt::format("{}: {}", file.info.path, what));
}

double snap_origin(double degrees, double spacing) {
  const double halves = degrees / spacing * 2.0, whole = std::round(halves);
  return std::abs(halves - whole) <= 2 * kSnapPosts ? whole / (2.0 / spacing) : degrees;
}

Result<RasterFile> inspect_raster(const std::string& path, const RasterOptions& options, double vertical_unit_m) {
  RasterFile s;
  s.info.path = path;
  s.info.name = path.substr(path.find_last_of('/') + 1);
  s.gdal_name = path;
  VSIStatBufL stat;
  if (ends_with_zip(path) && path.rfind("/vsi", 0) != 0 && VSIStatL(path.c_str(), &stat) == 0) {
    GdalErrors quiet;
    auto name = raster_in_zip(s);
    if (!name) return tl::unexpected(name.error());
    s.gdal_name = *name;
  }
  auto opened = open_dataset(s);
  if (!opened) return tl::unexpected(opened.error());
  s.dataset = std::move(*opened);
  GdalErrors errors;
  if (auto ok = read_frame(s); !ok) return tl::unexpected(ok.error());
  if (auto ok = read_crs(s); !ok) return tl::unexpected(ok.error());
  if (auto ok = read_own_grid(s); !ok) return tl::unexpected(ok.error());
  s.info.native_spacing_m = mean_spacing_m(s);
  if (auto ok = read_vertical(s, *s.dataset->GetRasterBand(1), options, vertical_unit_m); !ok)
    return tl::unexpected(ok.error());

  s.info.sha256 = s.gdal_name;
  s.hashed_name = path;
  if (VSIStatL(path.c_str(), &stat) != 0) {
    const CPLStringList files(s.dataset->GetFileList());
    if (files.Count() > 0) s.hashed_name = files[0];
  }
  s.dataset.reset();  // reading opens it again: a mosaic may have more files than a process may have open
  return s;
}

Result<void> RasterFile::read_window(std::int64_t col, std::int64_t row, std::int64_t n_cols, std::int64_t n_rows,
                                     std::vector<float>& heights_m, std::uint64_t& n_implausible, bool* has_void) {
  std::unique_lock lock(*mutex_);
  // Where rows are blocks of their own each thread has a dataset; else one has a cache of blocks that all need.
  GDALDatasetUniquePtr taken = std::move(dataset);
  if (has_row_blocks && !taken && !idle_.empty()) {
    taken = std::move(idle_.back());
    idle_.pop_back();
  }
  if (has_row_blocks) lock.unlock();
  if (!taken) {
    auto opened = open_dataset(*this);
    if (!opened) return tl::unexpected(opened.error());
    taken = std::move(*opened);
  }
  GdalErrors errors;
  const auto n_values = static_cast<std::size_t>(n_cols * n_rows);
  GDALRasterBand& band = *taken->GetRasterBand(1);
  // Types whose values a float holds exactly are read as floats.
  const GDALDataType stored = band.GetRasterDataType();
  const bool fits_float = stored == GDT_Byte || stored == GDT_Int16 || stored == GDT_UInt16 || stored == GDT_Float32;
  heights_m.resize(n_values);
  std::vector<double> wide(fits_float ? 0 : n_values);
  void* const raw = fits_float ? static_cast<void*>(heights_m.data()) : wide.data();
  std::vector<std::uint8_t> mask(has_mask ? n_values : 0);
  const int x_off = static_cast<int>(col), y_off = static_cast<int>(row), x_size = static_cast<int>(n_cols),
            y_size = static_cast<int>(n_rows);
  CPLErr status = band.RasterIO(GF_Read, x_off, y_off, x_size, y_size, raw, x_size, y_size,
                                fits_float ? GDT_Float32 : GDT_Float64, 0, 0, nullptr);
  if (status == CE_None && has_mask) {
    status = band.GetMaskBand()->RasterIO(GF_Read, x_off, y_off, x_size, y_size, mask.data(), x_size, y_size, GDT_Byte,
                                          0, 0, nullptr);
  }
  if (status != CE_None || errors.failed()) {
    return fail(ErrorKind::kIo, fmt::format("{}: reading rows {} to {} failed: the file is truncated or damaged{}",
                                            info.path, row, row + n_rows - 1, errors.detail()));
  }
  if (has_row_blocks) lock.lock();
  if (dataset) {
    idle_.push_back(std::move(taken));
  } else {
    dataset = std::move(taken);
  }
  lock.unlock();
  if (fits_float && !has_mask && scale == 1 && offset == 0) {
    const CellSigns found = settle_metres(heights_m, n_implausible);
    if (has_void) *has_void = found.has_void;
    lock.lock();
    signs.add(found);
    return {};
  }
  CellSigns found;
  constexpr float kVoid = std::numeric_limits<float>::quiet_NaN();
  const auto nodata_float = static_cast<float>(nodata);
  for (std::size_t i = 0; i < n_values; ++i) {
    const double v = fits_float ? static_cast<double>(heights_m[i]) : wide[i];
    const bool marked = has_nodata && (v == nodata || (is_float32 && static_cast<float>(v) == nodata_float));
    heights_m[i] = kVoid;
    if (!marked && std::isfinite(v) && (!has_mask || mask[i] != 0)) {
      const double metres = v * scale + offset;
      if (std::abs(metres) <= kMaxHeightM) {
        heights_m[i] = static_cast<float>(metres);
      } else {
        ++n_implausible;
      }
    }
    if (std::isnan(heights_m[i])) {
      found.has_void = true;
    } else if (heights_m[i] == 0) {
      found.has_zero = true;
    } else {
      found.lowest_other = std::min(found.lowest_other, heights_m[i]);
    }
  }
  if (has_void) *has_void = found.has_void;
  lock.lock();
  signs.add(found);
  return {};
}

void RasterFile::close_when_read(std::int64_t n_rows) {
  const std::scoped_lock lock(*mutex_);
  n_rows_read_ += n_rows;
  if (n_rows_read_ < info.n_used_rows) return;
  n_rows_read_ = 0;
  dataset.reset();
  idle_.clear();
}

CellSigns RasterFile::settle_metres(std::vector<float>& heights_m, std::uint64_t& n_implausible) const {
  constexpr float kInfinity = std::numeric_limits<float>::infinity(), kMost = static_cast<float>(kMaxHeightM);
  // A value that no float is marks none of them; a nodata value of a float32 band is rounded as its posts are.
  const auto as_float = static_cast<float>(nodata);
  const bool marks = has_nodata && (is_float32 || static_cast<double>(as_float) == nodata);
  const float marker = marks ? as_float : std::numeric_limits<float>::quiet_NaN();
  using Four = float __attribute__((vector_size(16)));
  using FourBits = std::int32_t __attribute__((vector_size(16)));
  constexpr std::size_t kLanes = 4;
  Four lowest = Four{} + kInfinity;
  FourBits all_sound = FourBits{} - 1, any_zero{};
  const auto look_at = [&](const float* at) {
    Four v;
    std::memcpy(&v, at, sizeof v);
    const FourBits sound = (v <= kMost) & (v >= -kMost) & (v != marker), zero = v == 0.0f;
    all_sound &= sound;
    any_zero |= zero & sound;
    const Four other = (sound & ~zero) ? v : Four{} + kInfinity;
    lowest = other < lowest ? other : lowest;
  };
  const std::size_t n = heights_m.size();
  for (std::size_t i = 0; i + kLanes <= n; i += kLanes) look_at(heights_m.data() + i);
  if (n % kLanes != 0) {
    std::array<float, kLanes> last{};
    for (std::size_t k = 0; k < kLanes; ++k) last[k] = heights_m[std::min(n / kLanes * kLanes + k, n - 1)];
    look_at(last.data());
  }
  CellSigns found;
  bool has_void = false;
  for (std::size_t k = 0; k < kLanes; ++k) {
    has_void = has_void || all_sound[k] == 0;
    found.has_zero = found.has_zero || any_zero[k] != 0;
    found.lowest_other = std::min(found.lowest_other, lowest[k]);
  }
  if (!has_void) return found;
  found.has_void = true;
  for (float& height : heights_m) {
    const bool marked = height == marker;
    if (!marked && std::abs(height) <= kMost) continue;
    if (!marked && std::isfinite(height)) ++n_implausible;
    height = std::numeric_limits<float>::quiet_NaN();
  }
  return found;
}

}  // namespace tind
