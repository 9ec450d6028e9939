// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/point_source.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <numbers>
#include <tuple>
#include <utility>

#include <fmt/format.h>

#include "core/lattice.hpp"
#include "storage/readers/byte_source.hpp"
#include "storage/readers/gdal_raster.hpp"
#include "storage/readers/las.hpp"
#include "storage/readers/occupied_cells.hpp"
#include "storage/readers/point_crs.hpp"
#include "storage/readers/vertical_shift.hpp"
#include "storage/readers/xyz_points.hpp"

namespace tind {
namespace {

/// Memory that a point takes on its way from the file to the sink, generously.
constexpr std::uint64_t kBytesPerPoint = 256;
/// Spacings below this are no terrain.
constexpr double kMinSpacingM = 1e-3;

bool has_ending(const std::string& path, const char* ending) {
  const std::string_view want = ending;
  if (path.size() < want.size()) return false;
  return std::equal(want.begin(), want.end(), path.end() - static_cast<std::ptrdiff_t>(want.size()),
                    [](char a, char b) { return a == std::tolower(static_cast<unsigned char>(b)); });
}

bool is_las(const std::string& path) { return has_ending(path, ".las") || has_ending(path, ".laz"); }

/// What happened to the points of a file, or of all.
struct Tally {
  std::uint64_t seen = 0, used = 0, withheld = 0, not_finite = 0, nowhere = 0, implausible = 0;
  std::array<std::uint64_t, 256> by_class{};  ///< LAS only.

  void add(const Tally& t) {
    seen += t.seen;
    used += t.used;
    withheld += t.withheld;
    not_finite += t.not_finite;
    nowhere += t.nowhere;
    implausible += t.implausible;
    for (std::size_t i = 0; i < by_class.size(); ++i) by_class[i] += t.by_class[i];
  }
  std::string classes() const {
    std::string text;
    for (std::size_t i = 0; i < by_class.size(); ++i) {
      if (by_class[i] > 0) text += fmt::format("{}{} ({} points)", text.empty() ? "" : ", ", i, by_class[i]);
    }
    return text;
  }
};

/// One input. Its file is open only while it is read.
struct Source {
  PointFile info;
  std::optional<PointCrs> crs;  ///< None: x and y are taken as degrees.
  double metres_per_unit = 1;
  std::vector<std::string> notes;
};

tl::unexpected<Error> bad(const Source& s, const std::string& what) {
  return fail(ErrorKind::kInvalidInput, fmt::format("{}: {}", s.info.path, what));
}

/// Raw coordinates of wanted points.
struct RawBatch {
  std::vector<double> x, y, z;
  void clear() { x.clear(), y.clear(), z.clear(); }
};

/// The points of one file, batch by batch.
class FileReader {
 public:
  static Result<FileReader> open(const std::string& path) {
    FileReader reader;
    reader.path_ = path;
    auto bytes = open_bytes(path);
    if (!bytes) return tl::unexpected(bytes.error());
    reader.bytes_ = std::move(*bytes);
    if (is_las(path)) {
      auto header = read_las_header(*reader.bytes_, path);
      if (!header) return tl::unexpected(header.error());
      reader.las_ = std::move(*header);
    } else {
      auto xyz = XyzReader::open(*reader.bytes_, path);
      if (!xyz) return tl::unexpected(xyz.error());
      reader.xyz_ = std::move(*xyz);
    }
    return reader;
  }

  ByteSource& bytes() { return *bytes_; }
  const std::optional<LasHeader>& las() const { return las_; }

  /// Reads up to `n_most` points and appends those that are wanted; false when there are no more.
  Result<bool> next(std::size_t n_most, const ClassFilter& classes, RawBatch& batch, Tally& tally) {
    if (las_) return next_las(n_most, classes, batch, tally);
    text_points_.clear();
    auto more = xyz_->next(n_most, text_points_);
    if (!more) return more;
    for (const XyzPoint& p : text_points_) {
      ++tally.seen;
      take(p.x, p.y, p.z, batch, tally);
    }
    return *more;
  }

 private:
  FileReader() = default;

  Result<bool> next_las(std::size_t n_most, const ClassFilter& classes, RawBatch& batch, Tally& tally) {
    const std::size_t n = std::min<std::uint64_t>(n_most, las_->n_points - next_point_);
    if (n == 0) return false;
    records_.resize(n * las_->record_bytes);
    if (!bytes_->read(las_->points_offset + next_point_ * las_->record_bytes, records_)) {
      return fail(ErrorKind::kIo, fmt::format("{}: reading points {} to {} failed: the file is truncated or damaged",
                                              path_, next_point_, next_point_ + n - 1));
    }
    next_point_ += n;
    las_points_.clear();
    decode_las_points(*las_, records_, las_points_);
    for (const LasPoint& p : las_points_) {
      ++tally.seen;
      if (p.withheld) {
        ++tally.withheld;
        continue;
      }
      ++tally.by_class[p.classification];
      if (classes[p.classification]) take(p.x, p.y, p.z, batch, tally);
    }
    return true;
  }

  static void take(double x, double y, double z, RawBatch& batch, Tally& tally) {
    if (!std::isfinite(x) || !std::isfinite(y) || !std::isfinite(z)) {
      ++tally.not_finite;
      return;
    }
    batch.x.push_back(x);
    batch.y.push_back(y);
    batch.z.push_back(z);
  }

  std::string path_;
  std::unique_ptr<ByteSource> bytes_;
  std::optional<LasHeader> las_;
  std::optional<XyzReader> xyz_;
  std::uint64_t next_point_ = 0;
  std::vector<std::uint8_t> records_;
  std::vector<LasPoint> las_points_;
  std::vector<XyzPoint> text_points_;
};

using Sink = std::function<Result<void>(std::span<const GeoPoint>)>;

/// Hands out the used points of one file, longitudes in [-180, 180).
Result<Tally> read_points(const Source& s, const PointOptions& options, const Sink& sink) {
  auto reader = FileReader::open(s.info.path);
  if (!reader) return tl::unexpected(reader.error());
  const std::size_t n_most = std::clamp<std::uint64_t>(options.memory_bytes / kBytesPerPoint, 1024, 1 << 20);
  Tally tally;
  RawBatch batch;
  std::vector<GeoPoint> points;
  for (bool more = true; more;) {
    batch.clear();
    auto read = reader->next(n_most, options.classes, batch, tally);
    if (!read) return tl::unexpected(read.error());
    more = *read;
    if (s.crs) {
      tally.nowhere += s.crs->to_degrees(batch.x, batch.y);
    } else {
      for (std::size_t i = 0; i < batch.x.size(); ++i) {
        if (std::abs(batch.x[i]) <= 360 && std::abs(batch.y[i]) <= 90) continue;
        return bad(s, fmt::format("says nothing about its CRS, and {}, {} are not degrees; say what they are with "
                                  "--source-crs EPSG:n",
                                  batch.x[i], batch.y[i]));
      }
    }
    points.clear();
    for (std::size_t i = 0; i < batch.x.size(); ++i) {
      if (!std::isfinite(batch.x[i])) continue;
      const double metres = batch.z[i] * s.metres_per_unit;
      if (!(std::abs(metres) <= kMaxHeightM)) {
        ++tally.implausible;
        continue;
      }
      double lon = batch.x[i];
      if (lon < -180.0 || lon >= 180.0) lon -= 360.0 * std::floor((lon + 180.0) / 360.0);
      points.push_back({lon < 180.0 ? lon : -180.0, batch.y[i], static_cast<float>(metres)});
    }
    tally.used += points.size();
    if (points.empty()) continue;
    if (auto ok = sink(points); !ok) return tl::unexpected(ok.error());
  }
  return tally;
}

/// Opens one input, reads its header and hash. `vertical_unit_m`: when neither the options nor the file say it.
Result<Source> inspect(const std::string& path, const PointOptions& options, double vertical_unit_m) {
  Source s;
  s.info.path = path;
  s.info.name = path.substr(path.find_last_of('/') + 1);
  auto reader = FileReader::open(path);
  if (!reader) return tl::unexpected(reader.error());
  if (!options.source_crs.empty()) {
    auto crs = PointCrs::from_user_input(options.source_crs, "--source-crs");
    if (!crs) return tl::unexpected(crs.error());
    s.crs = std::move(*crs);
  } else if (reader->las()) {
    auto crs = PointCrs::from_las(reader->las()->crs, path);
    if (!crs) return tl::unexpected(crs.error());
    if (!*crs) return bad(s, "says nothing about its CRS; say what it is with --source-crs EPSG:n");
    s.crs = std::move(**crs);
  }
  s.metres_per_unit = vertical_unit_m;
  if (s.crs) {
    s.info.crs = s.crs->name;
    s.metres_per_unit = s.crs->metres_per_z_unit.value_or(vertical_unit_m);
  } else {
    s.info.crs = "WGS 84 (EPSG:4326)";
    s.notes.push_back(fmt::format("{}: no CRS; its degrees are taken as EPSG:4326", s.info.name));
  }
  if (options.metres_per_unit) {
    s.metres_per_unit = *options.metres_per_unit;
  } else if (s.metres_per_unit != 1) {
    s.notes.push_back(
        fmt::format("{}: its heights are in units of {:.9g} m, by its CRS (--metres-per-unit says otherwise)",
                    s.info.name, s.metres_per_unit));
  }
  auto hash = sha256_of(reader->bytes(), path);
  if (!hash) return tl::unexpected(hash.error());
  s.info.sha256 = *hash;
  return s;
}

/// Bounds of longitudes on a circle: from -180 on, or from 0 on where that is the shorter way.
struct LonBounds {
  double west = 1e9, east = -1e9, west_of_0 = 1e9, east_of_0 = -1e9;

  void add(double lon) {
    west = std::min(west, lon);
    east = std::max(east, lon);
    const double from_0 = lon < 0 ? lon + 360.0 : lon;
    west_of_0 = std::min(west_of_0, from_0);
    east_of_0 = std::max(east_of_0, from_0);
  }
  bool crosses_180() const { return east - west > 180.0 && east_of_0 - west_of_0 < east - west; }
};

}  // namespace

Result<ClassFilter> parse_class_filter(const std::string& text) {
  ClassFilter filter;
  if (text == "all") return filter.set();
  for (std::size_t at = 0; at <= text.size();) {
    const std::size_t end = std::min(text.find(',', at), text.size());
    int value = -1;
    const auto [stop, error] = std::from_chars(text.data() + at, text.data() + end, value);
    if (error != std::errc() || stop != text.data() + end || value < 0 || value > 255) {
      return fail(ErrorKind::kInvalidInput,
                  fmt::format("\"{}\" is no list of point classes; try 2, or 2,9, or all", text));
    }
    filter.set(static_cast<std::size_t>(value));
    at = end + 1;
  }
  return filter;
}

struct PointSource::Impl {
  PointOptions options;
  std::vector<Source> sources;  ///< Same order as PointSource::files.
  std::optional<VerticalShift> shift;
  bool crosses_180 = false;

  Result<void> settle_vertical(PointSource& m);
};

Result<void> PointSource::Impl::settle_vertical(PointSource& m) {
  const auto datum_of = [](const Source& s) {
    return s.crs && !s.crs->vertical_datum.empty() ? s.crs->vertical_datum : std::string("unknown");
  };
  const Source& first = sources.front();
  if (!shift) {
    m.vertical_datum = datum_of(first);
    if (first.crs) m.height_kind = first.crs->height_kind;
    for (const Source& s : sources) {
      if (datum_of(s) == m.vertical_datum) continue;
      m.notes.push_back(fmt::format("{}: its vertical datum differs from that of {}", s.info.name, first.info.name));
    }
    return {};
  }
  if (auto ok = shift->settle({(m.west_deg + m.east_deg) / 2, (m.south_deg + m.north_deg) / 2}); !ok) return ok;
  m.height_kind = "ellipsoidal";
  m.vertical_operation = shift->operation();
  m.vertical_datum =
      m.vertical_operation.empty() ? shift->datum() : fmt::format("WGS 84 ellipsoid, from {}", shift->datum());
  for (const Source& s : sources) {
    if (m.vertical_operation.empty() || !s.crs || s.crs->height_kind != "ellipsoidal") continue;
    m.notes.push_back(fmt::format("{}: its CRS says that its heights are ellipsoidal; {} shifts them all the same",
                                  s.info.name, options.geoid.empty() ? "--vertical-datum" : "--geoid"));
  }
  return {};
}

PointSource::PointSource(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PointSource::PointSource(PointSource&&) noexcept = default;
PointSource& PointSource::operator=(PointSource&&) noexcept = default;
PointSource::~PointSource() = default;

bool PointSource::is_point_file(const std::string& path) {
  return is_las(path) || has_ending(path, ".xyz") || has_ending(path, ".csv") || has_ending(path, ".txt");
}

Result<PointSource> PointSource::open(const std::vector<std::string>& paths, const PointOptions& options) {
  if (paths.empty()) return fail(ErrorKind::kInvalidInput, "no point file given");
  const auto is_bad = [](const std::optional<double>& v) { return v && (!std::isfinite(*v) || !(*v > 0)); };
  if (is_bad(options.metres_per_unit) || is_bad(options.spacing_m)) {
    return fail(ErrorKind::kInvalidInput, "metres per unit and the spacing must be positive numbers");
  }
  PointSource m(std::make_unique<Impl>());
  m.impl_->options = options;
  if (!options.vertical_datum.empty() || !options.geoid.empty()) {
    auto shift = VerticalShift::create(options.vertical_datum, options.geoid);
    if (!shift) return tl::unexpected(shift.error());
    m.impl_->shift = std::move(*shift);
  }
  auto& sources = m.impl_->sources;
  for (const std::string& path : paths) {
    auto source = inspect(path, options, m.impl_->shift ? m.impl_->shift->unit_m() : 1.0);
    if (!source) return tl::unexpected(source.error());
    sources.push_back(std::move(*source));
  }
  std::sort(sources.begin(), sources.end(), [](const Source& a, const Source& b) {
    return std::tie(a.info.sha256, a.info.name) < std::tie(b.info.sha256, b.info.name);
  });
  const auto same = [](const Source& a, const Source& b) { return a.info.sha256 == b.info.sha256; };
  if (const auto end = std::unique(sources.begin(), sources.end(), same); end != sources.end()) {
    m.notes.push_back(fmt::format("{} inputs given twice are used once", sources.end() - end));
    sources.erase(end, sources.end());
  }

  Tally all;
  LonBounds lon;
  OccupiedCells cells;
  m.south_deg = 90;
  m.north_deg = -90;
  for (Source& s : sources) {
    auto tally = read_points(s, options, [&](std::span<const GeoPoint> points) -> Result<void> {
      for (const GeoPoint& p : points) {
        lon.add(p.lon_deg);
        m.south_deg = std::min(m.south_deg, p.lat_deg);
        m.north_deg = std::max(m.north_deg, p.lat_deg);
        cells.add(p.lon_deg, p.lat_deg);
      }
      return {};
    });
    if (!tally) return tl::unexpected(tally.error());
    s.info.n_points = tally->seen;
    s.info.n_used = tally->used;
    all.add(*tally);
    m.files.push_back(s.info);
    m.notes.insert(m.notes.end(), s.notes.begin(), s.notes.end());
    if (tally->used == 0) m.notes.push_back(fmt::format("{}: none of its points is used", s.info.name));
  }
  const auto note = [&](std::uint64_t n, const char* what) {
    if (n > 0) m.notes.push_back(fmt::format("{} points {}", n, what));
  };
  note(all.withheld, "are marked as withheld and left out");
  note(all.not_finite, "have a coordinate that is no finite number and are left out");
  note(all.nowhere, "lie where their CRS has no longitude and latitude and are left out");
  note(all.implausible, "have heights beyond +-30000 m and are left out (--metres-per-unit?)");
  m.n_used = all.used;
  const Source& first = sources.front();
  if (all.used == 0) {
    const std::string found = all.classes();
    if (all.seen == 0) return bad(first, "holds no points");
    if (all.not_finite + all.nowhere + all.implausible == 0 && !found.empty()) {
      return bad(first, fmt::format("no point is of the wanted class; there are classes {}; choose with --class, for "
                                    "example --class all",
                                    found));
    }
    return bad(first, "no point can be used: " + (m.notes.empty() ? std::string("all are withheld") : m.notes.back()));
  }

  m.impl_->crosses_180 = lon.crosses_180();
  m.west_deg = m.impl_->crosses_180 ? lon.west_of_0 : lon.west;
  m.east_deg = m.impl_->crosses_180 ? lon.east_of_0 : lon.east;
  const double metres_per_degree = Ellipsoid().semi_major_m * std::numbers::pi / 180.0;
  const double cos_lat = std::cos((m.south_deg + m.north_deg) / 2 * std::numbers::pi / 180.0);
  if (options.spacing_m) {
    m.spacing_m = *options.spacing_m;
  } else {
    const double bounds_area =
        (m.east_deg - m.west_deg) * (m.north_deg - m.south_deg) * cos_lat * metres_per_degree * metres_per_degree;
    m.spacing_m =
        std::sqrt(std::min(cells.area_m2(m.n_used, metres_per_degree), bounds_area) / static_cast<double>(m.n_used));
    if (m.n_used < 3 || !(m.spacing_m >= kMinSpacingM)) {
      return bad(first,
                 fmt::format("{} points (all in one place or on one line, or fewer than 3) have no spacing of their "
                             "own; say what it is with --spacing M",
                             m.n_used));
    }
  }
  m.lat_spacing_deg = m.spacing_m / metres_per_degree;
  m.lon_spacing_deg = m.spacing_m / (metres_per_degree * cos_lat);
  if (auto ok = m.impl_->settle_vertical(m); !ok) return tl::unexpected(ok.error());
  return m;
}

Result<void> PointSource::read(const Sink& sink) const {
  std::vector<GeoPoint> moved;
  std::vector<Place> places;
  std::vector<float> heights_m;
  for (const Source& s : impl_->sources) {
    auto tally = read_points(s, impl_->options, [&](std::span<const GeoPoint> points) -> Result<void> {
      moved.assign(points.begin(), points.end());
      if (impl_->shift) {
        places.clear();
        heights_m.clear();
        for (const GeoPoint& p : points) {
          places.push_back({p.lon_deg, p.lat_deg});
          heights_m.push_back(p.height_m);
        }
        if (auto ok = impl_->shift->apply(places, heights_m.data()); !ok) return ok;
        for (std::size_t i = 0; i < moved.size(); ++i) moved[i].height_m = heights_m[i];
      }
      for (GeoPoint& p : moved) {
        if (impl_->crosses_180 && p.lon_deg < 0) p.lon_deg += 360.0;
      }
      return sink(moved);
    });
    if (!tally) return tl::unexpected(tally.error());
    if (tally->seen != s.info.n_points || tally->used != s.info.n_used) {
      return fail(ErrorKind::kIo, fmt::format("{}: changed while it was read; start again", s.info.path));
    }
  }
  return {};
}

}  // namespace tind
