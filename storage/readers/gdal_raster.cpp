// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/gdal_raster.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <tuple>
#include <utility>

#include <cpl_string.h>
#include <cpl_vsi.h>
#include <fmt/format.h>
#include <gdal_priv.h>
#include <ogr_spatialref.h>

#include "storage/readers/gdal_errors.hpp"
#include "storage/readers/sha256.hpp"

namespace tind {
namespace {

/// Sources must agree with the grid within this share of a post.
constexpr double kAlignPosts = 1e-3;
/// A spacing that misses one whole part of a degree by less than this share of a post over the whole raster is a
/// decimal rounding of it.
constexpr double kSnapPosts = 1e-4;
/// A raster that misses closing around the globe by less than this share of a post has a rounded spacing in its header.
constexpr double kClosePosts = 0.1;

std::string lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

bool ends_with_zip(const std::string& path) { return path.size() > 4 && lower(path.substr(path.size() - 4)) == ".zip"; }

/// Everything to know about one input. Rows of the file run from `top` by `lat_step` (negative: north-up).
struct Source {
  RasterSource info;
  std::string gdal_name;
  double west = 0, south = 0;  ///< First used post, degrees.
  double dx = 0, dy = 0;       ///< Positive, degrees.
  bool north_up = true;
  std::int64_t skip_south = 0;  ///< Rows south of the first used one.
  bool has_nodata = false;
  double nodata = 0;
  double scale = 1, offset = 0;  ///< metres = raw * scale + offset
  bool has_mask = false;
  std::string vertical_datum;
  std::vector<std::string> notes;
  GDALDatasetUniquePtr dataset;
};

tl::unexpected<Error> bad(const Source& s, const std::string& what) {
  return fail(ErrorKind::kInvalidInput, fmt::format("{}: {}", s.info.path, what));
}

Result<std::string> hash_file(const std::string& name) {
  VSILFILE* file = VSIFOpenL(name.c_str(), "rb");
  if (file == nullptr) return fail(ErrorKind::kIo, fmt::format("{}: cannot read the file", name));
  Sha256 sha;
  std::vector<char> buffer(1 << 20);
  std::size_t n = 0;
  while ((n = VSIFReadL(buffer.data(), 1, buffer.size(), file)) > 0) sha.update(buffer.data(), n);
  VSIFCloseL(file);
  return sha.finish_hex();
}

/// The GDAL name of the one raster in a zip archive.
Result<std::string> raster_in_zip(const Source& s) {
  const std::string root = "/vsizip/" + s.info.path;
  const CPLStringList entries(VSIReadDirRecursive(root.c_str()));
  std::vector<std::string> rasters;
  for (int i = 0; i < entries.Count(); ++i) {
    const std::string name = root + "/" + entries[i];
    if (name.back() != '/' && GDALIdentifyDriverEx(name.c_str(), GDAL_OF_RASTER, nullptr, nullptr))
      rasters.push_back(name);
  }
  if (rasters.size() == 1) return rasters[0];
  if (entries.Count() == 0) return bad(s, "not a zip archive, or an empty or truncated one");
  if (rasters.empty()) return bad(s, "the archive holds no raster that GDAL reads");
  return bad(s, fmt::format("the archive holds {} rasters; name one, for example {}", rasters.size(), rasters[0]));
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

/// Posts at whole or half spacings from 0 (all arc-second grids) get that very position.
double snap_origin(double degrees, double spacing) {
  const double halves = degrees / spacing * 2.0, whole = std::round(halves);
  return std::abs(halves - whole) <= 2 * kSnapPosts ? whole / (2.0 / spacing) : degrees;
}

Result<void> read_crs(Source& s) {
  const OGRSpatialReference* crs = s.dataset->GetSpatialRef();
  if (crs == nullptr || crs->IsEmpty()) {
    const double east = s.west + s.dx * static_cast<double>(s.info.n_cols - 1);
    const double north = s.south + s.dy * static_cast<double>(s.info.n_rows - 1);
    if (s.west < -361 || east > 541 || s.south < -91 || north > 91) {
      return bad(s,
                 "no CRS, and its coordinates are not degrees; give it one with gdal_translate -a_srs, then gdalwarp "
                 "-t_srs EPSG:4326");
    }
    s.notes.push_back(fmt::format("{}: no CRS; its degrees are taken as EPSG:4326", s.info.name));
    return {};
  }
  if (!crs->IsGeographic() || crs->IsDerivedGeographic()) {
    return bad(s,
               fmt::format("CRS \"{}\" is not geographic; warp it first: gdalwarp -t_srs EPSG:4326 -r bilinear IN OUT",
                           crs->GetName() ? crs->GetName() : "?"));
  }
  constexpr double kDegree = 0.0174532925199433;
  if (std::abs(crs->GetAngularUnits() / kDegree - 1) > 1e-9 || std::abs(crs->GetPrimeMeridian()) > 1e-12) {
    return bad(s, "its CRS does not count degrees from Greenwich; warp it first: gdalwarp -t_srs EPSG:4326 IN OUT");
  }
  if (crs->GetSemiMajor() < 6370000 || crs->GetSemiMajor() > 6385000) {
    s.notes.push_back(
        fmt::format("{}: not a CRS of the Earth; its latitudes and longitudes are used as they are", s.info.name));
  } else if (const char* datum = crs->GetAttrValue("DATUM"); datum != nullptr && std::strstr(datum, "1927")) {
    s.notes.push_back(
        fmt::format("{}: datum {} is taken as WGS 84 without a shift (it may be off by 100 m; gdalwarp "
                    "-t_srs EPSG:4326 shifts it)",
                    s.info.name, datum));
  }
  if (const char* datum = crs->GetAttrValue("VERT_CS")) s.vertical_datum = datum;
  return {};
}

Result<void> read_vertical(Source& s, GDALRasterBand& band, const RasterOptions& options) {
  int has_nodata = 0;
  const double nodata = band.GetNoDataValue(&has_nodata);
  s.has_nodata = has_nodata != 0 || options.nodata.has_value();
  s.nodata = options.nodata.value_or(nodata);
  s.has_mask = (band.GetMaskFlags() & (GMF_PER_DATASET | GMF_ALPHA)) != 0;

  double factor = 1;
  if (options.metres_per_unit) {
    factor = *options.metres_per_unit;
    if (!(factor > 0) || !std::isfinite(factor)) {
      return fail(ErrorKind::kInvalidInput, fmt::format("{} metres per unit is not a positive number", factor));
    }
  } else if (const std::string unit = band.GetUnitType(); !unit.empty()) {
    const auto known = metres_per_unit(unit);
    if (!known)
      return bad(
          s, fmt::format("vertical unit \"{}\" is not known; say how many metres it has with --metres-per-unit", unit));
    factor = *known;
  } else if (const auto* crs = s.dataset->GetSpatialRef(); crs != nullptr && crs->GetAttrNode("VERT_CS")) {
    const double vertical = crs->GetTargetLinearUnits("VERT_CS", nullptr);
    if (vertical > 0) factor = vertical;
  }
  int has_scale = 0, has_offset = 0;
  const double scale = band.GetScale(&has_scale), offset = band.GetOffset(&has_offset);
  s.scale = (has_scale ? scale : 1.0) * factor;
  s.offset = (has_offset ? offset : 0.0) * factor;
  if (!std::isfinite(s.scale) || s.scale == 0 || !std::isfinite(s.offset))
    return bad(s, "its scale or offset is broken");
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

Result<void> open_dataset(Source& s) {
  GdalErrors errors;
  s.dataset.reset(GDALDataset::Open(s.gdal_name.c_str(), GDAL_OF_RASTER | GDAL_OF_READONLY | GDAL_OF_VERBOSE_ERROR));
  if (s.dataset) return {};
  VSIStatBufL stat;
  if (VSIStatL(s.info.path.c_str(), &stat) != 0) {
    // A name with a colon may be a GDAL connection string; then GDAL's words say more.
    return bad(s, s.info.path.find(':') == std::string::npos ? "no such file" : "cannot be opened" + errors.detail());
  }
  if (VSI_ISDIR(stat.st_mode)) return bad(s, "is a folder; name the raster files in it");
  if (stat.st_size == 0) return bad(s, "is an empty file");
  return bad(s, "not a raster that GDAL can read, or a truncated one" + errors.detail());
}

/// Opens one input and reads all of its header.
Result<Source> inspect(const std::string& path, const RasterOptions& options) {
  Source s;
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
  if (auto opened = open_dataset(s); !opened) return tl::unexpected(opened.error());
  GdalErrors errors;
  if (s.dataset->GetRasterCount() == 0) {
    return bad(s, s.dataset->GetMetadata("SUBDATASETS") != nullptr
                      ? "holds several rasters; name one as gdalinfo lists it (SUBDATASET_1_NAME)"
                      : "holds no raster band");
  }
  s.info.n_cols = s.dataset->GetRasterXSize();
  s.info.n_rows = s.dataset->GetRasterYSize();
  if (s.info.n_cols < 2 || s.info.n_rows < 2) return bad(s, "needs at least 2 x 2 posts");
  if (s.dataset->GetRasterCount() > 1) {
    s.notes.push_back(
        fmt::format("{}: {} bands; heights are read from band 1", s.info.name, s.dataset->GetRasterCount()));
  }
  GDALRasterBand& band = *s.dataset->GetRasterBand(1);
  if (raw_file_is_short(*s.dataset)) return bad(s, "is truncated: shorter than its header says");
  if (GDALDataTypeIsComplex(band.GetRasterDataType())) return bad(s, "band 1 holds complex numbers, not heights");

  double gt[6];
  if (s.dataset->GetGeoTransform(gt) != CE_None) {
    return bad(s, s.dataset->GetGCPCount() > 0
                      ? "placed by ground control points; warp it first: gdalwarp -t_srs EPSG:4326 IN OUT"
                      : "has no geotransform, so nothing says where it lies; set one with "
                        "gdal_translate -a_ullr");
  }
  const double pixel = std::max(std::abs(gt[1]), std::abs(gt[5]));
  if (std::abs(gt[2]) > 1e-9 * pixel || std::abs(gt[4]) > 1e-9 * pixel) {
    return bad(s, "is rotated or sheared; make it north-up first: gdalwarp -t_srs EPSG:4326 IN OUT");
  }
  if (!(gt[1] > 0) || gt[5] == 0 || !std::all_of(gt, gt + 6, [](double v) { return std::isfinite(v); })) {
    return bad(s, "its geotransform is mirrored or broken; make it north-up first: gdalwarp -t_srs EPSG:4326 IN OUT");
  }
  s.north_up = gt[5] < 0;
  s.dx = snap_spacing(gt[1], s.info.n_cols);
  s.dy = snap_spacing(std::abs(gt[5]), s.info.n_rows);
  if (const auto closing = closing_spacing(gt[1], s.info.n_cols)) {
    if (std::abs(*closing / s.dx - 1) * static_cast<double>(s.info.n_cols) > kAlignPosts) {
      s.notes.push_back(fmt::format(
          "{}: its columns reach around the globe but for {:.3f} of a post; their spacing is taken as {} degrees",
          s.info.name, std::abs(360.0 / gt[1] - 360.0 / *closing), *closing));
    }
    s.dx = *closing;
  }
  const double south_row = s.north_up ? static_cast<double>(s.info.n_rows) - 0.5 : 0.5;
  s.west = snap_origin(gt[0] + 0.5 * gt[1], s.dx);
  s.south = snap_origin(gt[3] + south_row * gt[5], s.dy);
  if (auto ok = read_crs(s); !ok) return tl::unexpected(ok.error());
  if (auto ok = read_vertical(s, band, options); !ok) return tl::unexpected(ok.error());

  // Rows beyond a pole are no place on the globe.
  const auto rows_to = [&](double latitude) { return (latitude - s.south) / s.dy; };
  s.skip_south = std::max<std::int64_t>(0, std::llround(std::ceil(rows_to(-90.0) - kAlignPosts)));
  const auto last = std::min(s.info.n_rows - 1, std::int64_t{std::llround(std::floor(rows_to(90.0) + kAlignPosts))});
  s.info.n_used_rows = last - s.skip_south + 1;
  s.info.n_used_cols = s.info.n_cols;
  if (s.info.n_used_rows < 2 || s.west < -361 || s.west > 361) return bad(s, "lies outside the globe's degrees");
  if (s.info.n_used_rows < s.info.n_rows) {
    s.notes.push_back(
        fmt::format("{}: {} rows beyond a pole are left out", s.info.name, s.info.n_rows - s.info.n_used_rows));
  }
  s.south += static_cast<double>(s.skip_south) * s.dy;
  s.west -= 360.0 * std::floor((s.west + 180.0 + kAlignPosts * s.dx) / 360.0);

  std::string hashed = path;
  if (VSIStatL(path.c_str(), &stat) != 0) {
    const CPLStringList files(s.dataset->GetFileList());
    if (files.Count() > 0) hashed = files[0];
  }
  auto hash = hash_file(hashed);
  if (!hash) return tl::unexpected(hash.error());
  s.info.sha256 = *hash;
  s.dataset.reset();  // read_rows() opens it again: a mosaic may have more files than a process may have open
  return s;
}

auto canonical_key(const Source& s) {
  return std::tie(s.south, s.west, s.info.n_rows, s.info.n_cols, s.info.sha256, s.info.name);
}

}  // namespace

struct RasterMosaic::Impl {
  std::vector<Source> sources;  ///< Same order as RasterMosaic::sources.
};

RasterMosaic::RasterMosaic(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
RasterMosaic::RasterMosaic(RasterMosaic&&) noexcept = default;
RasterMosaic& RasterMosaic::operator=(RasterMosaic&&) noexcept = default;
RasterMosaic::~RasterMosaic() = default;

namespace {

/// Gives every source its rows and columns in the mosaic's grid, and the grid its size.
Result<void> place(RasterMosaic& m, std::vector<Source>& sources) {
  const Source& first = sources.front();
  double dx = first.dx;
  const double around = std::round(360.0 / dx);
  const bool closes = std::abs(360.0 / dx - around) <= kAlignPosts && around >= 2;
  if (closes) dx = 360.0 / around;
  const auto n_around = static_cast<std::int64_t>(around);

  std::int64_t last_row = 0;
  for (Source& s : sources) {
    const double cols_off = std::abs(s.dx / dx - 1) * static_cast<double>(s.info.n_cols);
    const double rows_off = std::abs(s.dy / first.dy - 1) * static_cast<double>(s.info.n_rows);
    if (cols_off > kAlignPosts || rows_off > kAlignPosts) {
      return bad(
          s, fmt::format("its posts are {} x {} degrees apart, those of {} {} x {}; resample first: gdalwarp -tr", s.dx,
                         s.dy, first.info.name, dx, first.dy));
    }
    const double row = (s.south - first.south) / first.dy;
    // The same meridian has two names near longitude 180: take the one that lies on the grid.
    double col = (s.west - first.west) / dx;
    for (const double turn : {-360.0, 360.0}) {
      const double other = (s.west - first.west + turn) / dx;
      if (std::abs(other - std::round(other)) < std::abs(col - std::round(col)) - kAlignPosts) col = other;
    }
    if (std::abs(row - std::round(row)) > kAlignPosts || std::abs(col - std::round(col)) > kAlignPosts) {
      return bad(
          s, fmt::format("its posts do not lie on the grid of {}; resample first: gdalwarp -tap -tr", first.info.name));
    }
    s.info.grid_row = std::llround(row);
    s.info.grid_col = std::llround(col);
    last_row = std::max(last_row, s.info.grid_row + s.info.n_used_rows);
  }
  m.lat_spacing_deg = first.dy;
  m.lon_spacing_deg = dx;
  m.south_deg = first.south;  // the canonical order starts with the southernmost
  m.n_rows = last_row;

  if (!closes) {
    std::int64_t low = 0, high = 0;
    for (const Source& s : sources) {
      low = std::min(low, s.info.grid_col);
      high = std::max(high, s.info.grid_col + s.info.n_used_cols);
    }
    if (static_cast<double>(high - low) > 360.0 / dx) {
      return fail(ErrorKind::kInvalidInput,
                  fmt::format("{}: reaches around the globe, but 360 degrees are not a whole number of posts; "
                              "resample first: gdalwarp -tr",
                              first.info.path));
    }
    for (Source& s : sources) s.info.grid_col -= low;
    m.west_deg = first.west + static_cast<double>(low) * dx;
    m.n_cols = high - low;
  } else {
    // Columns counted around the globe from the first one at or east of longitude -180.
    double start = std::ceil((-180.0 - first.west) / dx - kAlignPosts);
    const double zero_deg = first.west + start * dx;
    struct Arc {
      std::int64_t begin, end;
    };
    std::vector<Arc> arcs;
    for (Source& s : sources) {
      if (s.info.n_used_cols > n_around) {
        s.notes.push_back(fmt::format("{}: {} columns repeat others after 360 degrees and are left out", s.info.name,
                                      s.info.n_used_cols - n_around));
        s.info.n_used_cols = n_around;
      }
      auto col = (s.info.grid_col - static_cast<std::int64_t>(start)) % n_around;
      s.info.grid_col = col < 0 ? col + n_around : col;
      arcs.push_back({s.info.grid_col, s.info.grid_col + s.info.n_used_cols});
    }
    std::sort(arcs.begin(), arcs.end(),
              [](const Arc& a, const Arc& b) { return std::tie(a.begin, a.end) < std::tie(b.begin, b.end); });
    // The mosaic starts after the widest gap; no gap: it closes around the globe.
    std::int64_t reach = arcs.front().end;
    for (const Arc& a : arcs) reach = std::max(reach, a.end);
    reach -= n_around;  // how far arcs that pass longitude 180 cover the beginning
    std::int64_t widest = 0, west_col = 0;
    for (const Arc& a : arcs) {
      // Before the first arc the gap is what is left behind the arcs that end last.
      if (a.begin - reach > widest) {
        widest = a.begin - reach;
        west_col = a.begin;
      }
      reach = std::max(reach, a.end);
    }
    m.wraps = widest == 0;
    m.n_cols = n_around - widest;
    for (Source& s : sources) s.info.grid_col = (s.info.grid_col - west_col + n_around) % n_around;
    m.west_deg = zero_deg + static_cast<double>(west_col) * dx;
  }
  m.west_deg = snap_origin(m.west_deg, dx);
  if (m.west_deg >= 180.0) m.west_deg -= 360.0;
  if (m.west_deg < -180.0) m.west_deg += 360.0;
  return {};
}

}  // namespace

Result<RasterMosaic> RasterMosaic::open(const std::vector<std::string>& paths, const RasterOptions& options) {
  if (paths.empty()) return fail(ErrorKind::kInvalidInput, "no input raster given");
  GDALAllRegister();
  auto impl = std::make_unique<Impl>();
  for (const std::string& path : paths) {
    auto source = inspect(path, options);
    if (!source) return tl::unexpected(source.error());
    impl->sources.push_back(std::move(*source));
  }
  std::sort(impl->sources.begin(), impl->sources.end(),
            [](const Source& a, const Source& b) { return canonical_key(a) < canonical_key(b); });
  RasterMosaic m(std::move(impl));
  auto& sources = m.impl_->sources;
  const auto same = [](const Source& a, const Source& b) {
    return std::tie(a.south, a.west, a.info.sha256) == std::tie(b.south, b.west, b.info.sha256);
  };
  if (const auto end = std::unique(sources.begin(), sources.end(), same); end != sources.end()) {
    m.notes.push_back(fmt::format("{} inputs given twice are used once", sources.end() - end));
    sources.erase(end, sources.end());
  }
  if (auto placed = place(m, sources); !placed) return tl::unexpected(placed.error());
  m.vertical_datum = sources.front().vertical_datum.empty() ? "unknown" : sources.front().vertical_datum;
  for (const Source& s : sources) {
    m.sources.push_back(s.info);
    m.notes.insert(m.notes.end(), s.notes.begin(), s.notes.end());
    if (s.vertical_datum != sources.front().vertical_datum) {
      m.notes.push_back(
          fmt::format("{}: its vertical datum differs from that of {}", s.info.name, sources.front().info.name));
    }
  }
  return m;
}

Result<void> RasterMosaic::read_rows(std::size_t index, std::int64_t first_row, std::int64_t n,
                                     std::vector<float>& heights_m, std::uint64_t& n_implausible) const {
  Source& s = impl_->sources[index];
  const std::int64_t n_used_cols = s.info.n_used_cols;
  if (!s.dataset) {
    if (auto opened = open_dataset(s); !opened) return opened;
  }
  GdalErrors errors;
  // From rows counted northwards among the used ones to rows of the file.
  const std::int64_t from_south = s.skip_south + first_row;
  const std::int64_t file_row = s.north_up ? s.info.n_rows - from_south - n : from_south;
  const auto n_values = static_cast<std::size_t>(n * n_used_cols);
  std::vector<double> raw(n_values);
  std::vector<std::uint8_t> mask(s.has_mask ? n_values : 0);
  const int x_size = static_cast<int>(n_used_cols), y_size = static_cast<int>(n), y_off = static_cast<int>(file_row);
  GDALRasterBand& band = *s.dataset->GetRasterBand(1);
  CPLErr status =
      band.RasterIO(GF_Read, 0, y_off, x_size, y_size, raw.data(), x_size, y_size, GDT_Float64, 0, 0, nullptr);
  if (status == CE_None && s.has_mask) {
    status = band.GetMaskBand()->RasterIO(GF_Read, 0, y_off, x_size, y_size, mask.data(), x_size, y_size, GDT_Byte, 0,
                                          0, nullptr);
  }
  if (status != CE_None || errors.failed()) {
    return fail(ErrorKind::kIo, fmt::format("{}: reading rows {} to {} failed: the file is truncated or damaged{}",
                                            s.info.path, file_row, file_row + n - 1, errors.detail()));
  }
  heights_m.resize(n_values);
  constexpr float kVoid = std::numeric_limits<float>::quiet_NaN();
  // A nodata value of a float32 band is often written with fewer digits than the posts have.
  const bool is_float32 = band.GetRasterDataType() == GDT_Float32;
  const auto nodata_float = static_cast<float>(s.nodata);
  for (std::int64_t r = 0; r < n; ++r) {
    const std::int64_t in = (s.north_up ? n - 1 - r : r) * n_used_cols;
    float* out = heights_m.data() + r * n_used_cols;
    for (std::int64_t c = 0; c < n_used_cols; ++c) {
      const double v = raw[static_cast<std::size_t>(in + c)];
      const bool marked = s.has_nodata && (v == s.nodata || (is_float32 && static_cast<float>(v) == nodata_float));
      if (marked || !std::isfinite(v) || (s.has_mask && mask[static_cast<std::size_t>(in + c)] == 0)) {
        out[c] = kVoid;
        continue;
      }
      const double metres = v * s.scale + s.offset;
      const bool plausible = std::abs(metres) <= kMaxHeightM;
      n_implausible += plausible ? 0 : 1;
      out[c] = plausible ? static_cast<float>(metres) : kVoid;
    }
  }
  if (first_row + n == s.info.n_used_rows) s.dataset.reset();
  return {};
}

}  // namespace tind
