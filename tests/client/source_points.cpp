// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/source_points.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <tuple>

#include "tests/client/source_crs.hpp"
#include "tests/client/source_raster.hpp"
#include "tests/client/xyz_points.hpp"

namespace tind::client {
namespace {

/// A position so close (lattice steps) to the middle between two may be rounded to either by another program.
constexpr double kEitherSide = 1e-4;
constexpr std::size_t kTransformedAtOnce = 1 << 16;
/// Text is held whole while it is read.
constexpr std::uintmax_t kLargestText = std::uintmax_t{1} << 32;

/// A point on the globe and where it rounds to.
struct Place {
  std::int64_t row = 0, column = 0;
  double lat_deg = 0, lon_deg = 0;
  double height_m = 0;
  bool near_middle = false;  ///< Of the kept ones: it depends on such a case whether they are kept.

  auto position() const { return std::tie(row, column); }
};

bool before(const Place& a, const Place& b) {
  return std::tie(a.row, a.column, a.height_m, a.lat_deg, a.lon_deg) <
         std::tie(b.row, b.column, b.height_m, b.lat_deg, b.lon_deg);
}

std::string extension_of(const std::string& path) {
  std::string extension = std::filesystem::path(path).extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  return extension;
}

/// What one file gives: columns of coordinates in its own system, and what these are.
struct FilePoints {
  std::vector<double> x, y, z;
  Crs crs;  ///< Empty: degrees.
  double unit_m = 1;
};

/// Metres in a unit that GeoTIFF names by number (EPSG's codes of lengths); nullopt for others.
std::optional<double> length_unit_m(int code) {
  switch (code) {
    case 9001:
      return 1.0;
    case 9002:
      return 0.3048;
    case 9003:
      return 1200.0 / 3937.0;
    default:
      return std::nullopt;
  }
}

/// VerticalUnitsGeoKey, when the file has one.
std::optional<double> vertical_key_unit_m(const GeoKeys& keys) {
  constexpr int kVerticalUnits = 4099;
  for (std::size_t k = 4; k + 3 < keys.directory.size(); k += 4) {
    if (keys.directory[k] == kVerticalUnits && keys.directory[k + 1] == 0) return length_unit_m(keys.directory[k + 3]);
  }
  return std::nullopt;
}

/// Metres in a unit of height: what the file states for heights, else the projection's unit (ASPRS), else what the
/// named datum counts in, else metres.
double height_unit_m(const Crs& crs, std::optional<double> stated, const SourceOptions& options) {
  if (const auto unit = crs.vertical_unit_m()) return *unit;
  if (stated) return *stated;
  if (!crs.empty() && !crs.is_geographic()) return crs.linear_unit_m();
  return datum_unit_m(options).value_or(1.0);
}

Outcome<Crs> crs_of(const LasPoints& las) {
  if (!las.wkt.empty()) return Crs::from_text(las.wkt);
  if (!las.keys.directory.empty()) return Crs::from_geo_keys(las.keys);
  return refuse("names no coordinate system: say which with --source-crs");
}

Outcome<FilePoints> read_las_file(const std::string& path, const SourceOptions& options) {
  std::ifstream file(path, std::ios::binary);
  std::error_code error;
  const auto size = std::filesystem::file_size(path, error);
  if (!file || error) return refuse("cannot be read");
  const auto read = [&](std::uint64_t offset, std::size_t n) {
    Blob bytes(n);
    file.clear();
    file.seekg(static_cast<std::streamoff>(offset));
    file.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(n));
    bytes.resize(static_cast<std::size_t>(std::max<std::streamsize>(0, file.gcount())));
    return bytes;
  };
  ClassFilter filter;
  if (options.classes) {
    for (const int c : *options.classes) {
      if (c >= 0 && c < 256) filter.set(static_cast<std::size_t>(c));
    }
  } else {
    filter.set();
  }
  auto las = read_las(read, size, filter);
  if (!las) return refuse(las.error());
  if (las->x.empty()) return refuse("has no point of the wanted class; " + describe_classes(*las));
  FilePoints points;
  auto crs = options.source_crs.empty() ? crs_of(*las) : Crs::from_text(options.source_crs);
  if (!crs) return refuse(crs.error());
  points.crs = std::move(*crs);
  points.unit_m = height_unit_m(points.crs, vertical_key_unit_m(las->keys), options);
  points.x = std::move(las->x);
  points.y = std::move(las->y);
  points.z = std::move(las->z);
  return points;
}

Outcome<FilePoints> read_text_file(const std::string& path, const SourceOptions& options) {
  std::ifstream file(path, std::ios::binary);
  std::error_code error;
  const auto size = std::filesystem::file_size(path, error);
  if (!file || error) return refuse("cannot be read");
  if (size > kLargestText) return refuse("is larger than 4 GiB: make it a LAS file");
  const std::string text((std::istreambuf_iterator<char>(file)), {});
  auto xyz = read_xyz(text);
  if (!xyz) return refuse(xyz.error());
  FilePoints points;
  if (!options.source_crs.empty()) {
    auto crs = Crs::from_text(options.source_crs);
    if (!crs) return refuse(crs.error());
    points.crs = std::move(*crs);
  } else {
    const auto beyond = [](const std::vector<double>& values, double limit) {
      return std::any_of(values.begin(), values.end(), [=](double v) { return std::abs(v) > limit; });
    };
    if (beyond(xyz->x, 360) || beyond(xyz->y, 90))
      return refuse("its coordinates are no degrees: say what they are with --source-crs");
  }
  points.unit_m = height_unit_m(points.crs, std::nullopt, options);
  points.x = std::move(xyz->x);
  points.y = std::move(xyz->y);
  points.z = std::move(xyz->z);
  return points;
}

/// Moves a file's points onto the globe and the lattice.
Outcome<void> place(FilePoints& from, double unit_m, const LatticeFrame& frame, std::vector<Place>& places) {
  std::optional<Transform> transform;
  if (!from.crs.empty()) {
    const auto globe = Crs::from_text("EPSG:4326");
    if (!globe) return refuse(globe.error());
    auto made = Transform::make(from.crs.horizontal(), *globe);
    if (!made) return refuse(made.error());
    transform = std::move(*made);
  }
  const double step = frame.step_deg();
  for (std::size_t first = 0; first < from.x.size(); first += kTransformedAtOnce) {
    const std::size_t end = std::min(from.x.size(), first + kTransformedAtOnce);
    std::vector<double> lon(from.x.begin() + static_cast<std::ptrdiff_t>(first),
                            from.x.begin() + static_cast<std::ptrdiff_t>(end));
    std::vector<double> lat(from.y.begin() + static_cast<std::ptrdiff_t>(first),
                            from.y.begin() + static_cast<std::ptrdiff_t>(end));
    if (transform) transform->apply(lon, lat);
    for (std::size_t k = 0; k < lon.size(); ++k) {
      const double z = from.z[first + k] * unit_m;
      if (!std::isfinite(lon[k]) || !std::isfinite(lat[k]) || !std::isfinite(z)) continue;
      if (std::abs(lat[k]) > 90 || std::abs(z) > kHighest) continue;
      Place p;
      p.lon_deg = lon[k] - 360 * std::floor((lon[k] + 180) / 360);
      p.lat_deg = lat[k];
      p.height_m = z;
      const double x = (p.lon_deg + 180) / step, y = (p.lat_deg + 90) / step;
      p.column = std::llround(x) % frame.width();
      p.row = std::llround(y);
      p.near_middle =
          std::abs(x - std::floor(x) - 0.5) < kEitherSide || std::abs(y - std::floor(y) - 0.5) < kEitherSide;
      places.push_back(p);
    }
  }
  return {};
}

/// `places` is sorted. True iff a point next to `p` may be rounded to its position, or p to that one's.
bool may_join_a_neighbour(const std::vector<Place>& places, const Place& p, const LatticeFrame& frame) {
  for (std::int64_t dr = -1; dr <= 1; ++dr) {
    for (std::int64_t dc = -1; dc <= 1; ++dc) {
      if (dr == 0 && dc == 0) continue;
      Place next;
      next.row = p.row + dr;
      next.column = (p.column + dc + frame.width()) % frame.width();
      next.height_m = -std::numeric_limits<double>::infinity();
      for (auto it = std::lower_bound(places.begin(), places.end(), next, before);
           it != places.end() && it->position() == next.position(); ++it) {
        if (p.near_middle || it->near_middle) return true;
      }
    }
  }
  return false;
}

/// Sorts the kept points by cells of a grid with some sixteen points each.
void index_points(std::vector<Place>& kept, SourcePosts& posts) {
  std::vector<double> lon;
  lon.reserve(kept.size());
  for (const Place& p : kept) lon.push_back(p.lon_deg);
  const double west = first_longitude(lon, nullptr);
  double south = 90, north = -90, east = west;
  for (Place& p : kept) {
    if (p.lon_deg < west) p.lon_deg += 360;
    east = std::max(east, p.lon_deg);
    south = std::min(south, p.lat_deg);
    north = std::max(north, p.lat_deg);
  }
  PointIndex& index = posts.index;
  index.west_deg = west;
  index.south_deg = south;
  const double area = std::max(east - west, 1e-9) * std::max(north - south, 1e-9);
  index.cell_deg =
      std::max({std::sqrt(16 * area / static_cast<double>(kept.size())), (east - west) / 4000, (north - south) / 4000});
  index.n_cols = static_cast<std::int64_t>((east - west) / index.cell_deg) + 1;
  index.n_rows = static_cast<std::int64_t>((north - south) / index.cell_deg) + 1;
  const auto cell_of = [&](const Place& p) {
    return static_cast<std::int64_t>((p.lat_deg - south) / index.cell_deg) * index.n_cols +
           static_cast<std::int64_t>((p.lon_deg - west) / index.cell_deg);
  };
  std::stable_sort(kept.begin(), kept.end(), [&](const Place& a, const Place& b) { return cell_of(a) < cell_of(b); });
  index.first.assign(static_cast<std::size_t>(index.n_rows * index.n_cols) + 1, 0);
  for (const Place& p : kept) ++index.first[static_cast<std::size_t>(cell_of(p)) + 1];
  for (std::size_t k = 1; k < index.first.size(); ++k) index.first[k] += index.first[k - 1];
}

}  // namespace

bool is_point_file(const std::string& path) {
  const std::string extension = extension_of(path);
  return extension == ".las" || extension == ".laz" || extension == ".xyz" || extension == ".csv" ||
         extension == ".txt";
}

Outcome<SourcePosts> read_points(const std::vector<std::string>& paths, const SourceOptions& options,
                                 const GridClaim& claim) {
  SourcePosts posts;
  posts.kind = SourceKind::kPoints;
  std::vector<Place> places;
  for (const auto& path : paths) {
    posts.names.push_back(path);
    const std::string extension = extension_of(path);
    auto file =
        extension == ".las" || extension == ".laz" ? read_las_file(path, options) : read_text_file(path, options);
    if (!file) return refuse(path + ": " + file.error());
    if (auto ok = place(*file, options.metres_per_unit.value_or(file->unit_m), claim.frame, places); !ok) {
      return refuse(path + ": " + ok.error());
    }
  }
  if (places.empty()) return refuse(paths[0] + ": no point lies on the globe");
  if (places.size() > std::numeric_limits<std::uint32_t>::max())
    return refuse("the sources have more than 2^32 points");
  std::sort(places.begin(), places.end(), before);
  std::vector<Place> kept;
  for (std::size_t k = 0; k < places.size(); ++k) {
    const bool above = k > 0 && places[k].position() == places[k - 1].position();
    if (above && !places[k].near_middle) continue;
    kept.push_back(places[k]);
    kept.back().near_middle = above || may_join_a_neighbour(places, places[k], claim.frame);
  }
  index_points(kept, posts);
  posts.rounded = true;
  for (const Place& p : kept) {
    if (p.near_middle) {
      posts.either.insert(static_cast<std::int64_t>(posts.heights_m.size()));
    } else {
      ++posts.n_posts;
    }
    posts.longitudes_deg.push_back(p.lon_deg);
    posts.latitudes_deg.push_back(p.lat_deg);
    posts.heights_m.push_back(static_cast<float>(p.height_m));
  }
  if (kept.size() < places.size()) {
    posts.notes.push_back(fmt::format("of {} points {} round to a position that a lower one has", places.size(),
                                      places.size() - kept.size()));
  }
  return posts;
}

}  // namespace tind::client
