// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/source_posts.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "tests/client/source_crs.hpp"
#include "tests/client/source_points.hpp"
#include "tests/client/source_raster.hpp"
#include "tests/client/source_warp.hpp"

namespace tind::client {
namespace {

/// Grids may be shifted against each other by this share of a post.
constexpr double kAlignment = 1e-3;
/// A spacing or position is what it is but for the decimals of a header when no post moves by more than this share.
constexpr double kDecimals = 1e-4;
/// Columns that miss closing around the globe by less than this share of a post close.
constexpr double kClosing = 0.1;

/// A raster whose cells' centres are posts.
struct PlainGrid {
  const SourceRaster* raster = nullptr;
  double west_deg = 0, south_deg = 0, dx_deg = 0, dy_deg = 0;  ///< Of its first post.
  bool north_up = true;
};

/// `spacing` as a whole part of a degree if that is what a header meant over `n` posts.
double whole_part(double spacing, std::int64_t n) {
  const double part = 1 / std::round(1 / spacing);
  return std::isfinite(part) && std::abs(part - spacing) * static_cast<double>(n) < kDecimals * spacing ? part
                                                                                                        : spacing;
}

/// A position at a whole or half multiple of the spacing if that is what a header meant.
double whole_position(double position, double spacing) {
  const double halves = std::round(2 * position / spacing);
  const double whole = halves * spacing / 2;
  return std::abs(whole - position) < kDecimals * spacing ? whole : position;
}

PlainGrid plain_grid(const SourceRaster& raster) {
  const auto& t = raster.transform();
  const auto n_columns = raster.n_columns(), n_rows = raster.n_rows();
  PlainGrid g;
  g.raster = &raster;
  g.north_up = t[5] < 0;
  const double first_x = t[0] + 0.5 * t[1];
  const double first_y = g.north_up ? t[3] + (static_cast<double>(n_rows) - 0.5) * t[5] : t[3] + 0.5 * t[5];
  g.dx_deg = whole_part(t[1], n_columns);
  g.dy_deg = whole_part(std::abs(t[5]), n_rows);
  for (const std::int64_t n : {n_columns, n_columns - 1}) {
    if (n > 1 && std::abs(static_cast<double>(n) * t[1] - 360) < kClosing * t[1])
      g.dx_deg = 360 / static_cast<double>(n);
  }
  g.west_deg = whole_position(first_x, g.dx_deg);
  g.south_deg = whole_position(first_y, g.dy_deg);
  return g;
}

bool on_one_grid(const PlainGrid& a, const PlainGrid& b) {
  const auto off = [](double distance, double spacing) {
    const double steps = distance / spacing;
    return std::abs(steps - std::round(steps));
  };
  return std::abs(a.dx_deg - b.dx_deg) * static_cast<double>(a.raster->n_columns()) <= kAlignment * b.dx_deg &&
         std::abs(a.dy_deg - b.dy_deg) * static_cast<double>(a.raster->n_rows()) <= kAlignment * b.dy_deg &&
         off(a.west_deg - b.west_deg, b.dx_deg) <= kAlignment && off(a.south_deg - b.south_deg, b.dy_deg) <= kAlignment;
}

Outcome<void> read_into(const PlainGrid& g, SourcePosts& posts) {
  const auto column0 = std::llround((g.west_deg - posts.west_deg) / posts.lon_spacing_deg);
  const auto row0 = std::llround((g.south_deg - posts.south_deg) / posts.lat_spacing_deg);
  // The columns close around the globe when this many make 360 degrees.
  const double around = 360.0 / posts.lon_spacing_deg;
  const auto period = std::abs(around - std::round(around)) < kAlignment ? std::llround(around) : 0;
  for (std::int64_t r = 0; r < g.raster->n_rows(); ++r) {
    if (row0 + r < 0 || row0 + r >= posts.n_rows) continue;  // beyond a pole
    CellWindow line;
    line.row0 = g.north_up ? g.raster->n_rows() - 1 - r : r;
    line.n_rows = 1;
    line.n_columns = g.raster->n_columns();
    if (auto ok = g.raster->read(line); !ok) return refuse(ok.error());
    for (std::int64_t c = 0; c < line.n_columns; ++c) {
      std::int64_t column = column0 + c;
      if (period > 0) column %= period;
      posts.add_value((row0 + r) * posts.n_cols + column, line.heights_m[static_cast<std::size_t>(c)]);
    }
  }
  return {};
}

/// A pole is one point: every post on it has the values of all.
void share_pole_rows(SourcePosts& posts) {
  for (const std::int64_t row : {std::int64_t{0}, posts.n_rows - 1}) {
    if (90 - std::abs(posts.latitude_of(row * posts.n_cols)) > 1e-9) continue;
    float low = std::numeric_limits<float>::infinity(), high = -low;
    for (std::int64_t at = row * posts.n_cols; at < (row + 1) * posts.n_cols; ++at) {
      if (!posts.has(at)) continue;
      low = std::min(low, posts.heights_m[static_cast<std::size_t>(at)]);
      high = std::max(high, posts.heights_m[static_cast<std::size_t>(at)]);
    }
    if (!(low < high)) continue;
    posts.disagreement_m = std::max(posts.disagreement_m, static_cast<double>(high) - static_cast<double>(low));
    for (std::int64_t at = row * posts.n_cols; at < (row + 1) * posts.n_cols; ++at) {
      if (!posts.has(at)) continue;
      auto& others = posts.other_values[at];
      others.push_back(low);
      others.push_back(high);
    }
  }
}

Outcome<SourcePosts> read_plain(const std::vector<PlainGrid>& grids) {
  SourcePosts posts;
  posts.lon_spacing_deg = grids[0].dx_deg;
  posts.lat_spacing_deg = grids[0].dy_deg;
  double west = grids[0].west_deg, south = grids[0].south_deg, east = west, north = south;
  for (const PlainGrid& g : grids) {
    west = std::min(west, g.west_deg);
    south = std::min(south, g.south_deg);
    east = std::max(east, g.west_deg + static_cast<double>(g.raster->n_columns() - 1) * g.dx_deg);
    north = std::max(north, g.south_deg + static_cast<double>(g.raster->n_rows() - 1) * g.dy_deg);
    posts.names.push_back(g.raster->name());
  }
  while (south < -90 - kAlignment * posts.lat_spacing_deg) south += posts.lat_spacing_deg;
  while (north > 90 + kAlignment * posts.lat_spacing_deg) north -= posts.lat_spacing_deg;
  posts.west_deg = west;
  posts.south_deg = south;
  posts.n_cols = std::llround((east - west) / posts.lon_spacing_deg) + 1;
  posts.n_rows = std::llround((north - south) / posts.lat_spacing_deg) + 1;
  if (auto ok = posts.allocate(); !ok) return refuse(ok.error());
  for (const PlainGrid& g : grids) {
    if (auto ok = read_into(g, posts); !ok) return refuse(ok.error());
  }
  return posts;
}

/// Adds the geoid's height to every post.
Outcome<void> lift(SourcePosts& posts, const GeoidShift& shift) {
  constexpr std::int64_t kAtOnce = 1 << 14;
  const auto n = static_cast<std::int64_t>(posts.heights_m.size());
  std::vector<std::int64_t> at;
  std::vector<double> lon, lat;
  const auto flush = [&]() -> Outcome<void> {
    const auto undulation = shift.undulation_m(lon, lat);
    if (!undulation) return refuse(undulation.error());
    for (std::size_t k = 0; k < at.size(); ++k) {
      const auto add = [&](float& h) { h = static_cast<float>(static_cast<double>(h) + (*undulation)[k]); };
      add(posts.heights_m[static_cast<std::size_t>(at[k])]);
      if (const auto it = posts.other_values.find(at[k]); it != posts.other_values.end()) {
        for (float& other : it->second) add(other);
      }
    }
    at.clear();
    lon.clear();
    lat.clear();
    return {};
  };
  for (std::int64_t k = 0; k < n; ++k) {
    if (!posts.has(k)) continue;
    at.push_back(k);
    lon.push_back(posts.longitude_of(k));
    lat.push_back(posts.latitude_of(k));
    if (static_cast<std::int64_t>(at.size()) < kAtOnce) continue;
    if (auto ok = flush(); !ok) return ok;
  }
  posts.rounded = true;
  return at.empty() ? Outcome<void>{} : flush();
}

Outcome<SourcePosts> read_rasters(const std::vector<std::string>& paths, const SourceOptions& options,
                                  const GridClaim& claim) {
  std::vector<SourceRaster> rasters;
  for (const auto& path : paths) {
    auto raster = SourceRaster::open(path, options);
    if (!raster) return refuse(raster.error());
    rasters.push_back(std::move(*raster));
  }
  std::vector<PlainGrid> grids;
  for (const auto& raster : rasters) {
    if (raster.is_plain_grid()) grids.push_back(plain_grid(raster));
  }
  const bool plain = grids.size() == rasters.size() && std::all_of(grids.begin(), grids.end(), [&](const PlainGrid& g) {
                       return on_one_grid(g, grids[0]);
                     });
  auto posts = plain ? read_plain(grids) : read_warped(rasters, claim);
  if (posts && posts->n_posts == 0) return refuse(paths[0] + ": no post has a height");
  return posts;
}

}  // namespace

const char* name_of(SourceKind kind) {
  return kind == SourceKind::kRaster ? "raster" : kind == SourceKind::kWarped ? "warped" : "points";
}

Outcome<void> SourcePosts::allocate() {
  constexpr double kMost = 2147483648.0;
  if (!(static_cast<double>(n_cols) * static_cast<double>(n_rows) <= kMost)) {
    return refuse("the sources span more than 2^31 posts");
  }
  heights_m.assign(static_cast<std::size_t>(n_cols * n_rows), std::numeric_limits<float>::quiet_NaN());
  return {};
}

void SourcePosts::add_value(std::int64_t at, double metres) {
  if (std::isnan(metres)) return;
  const auto height = static_cast<float>(metres);
  rounded = rounded || static_cast<double>(height) != metres;
  float& first = heights_m[static_cast<std::size_t>(at)];
  if (std::isnan(first)) {
    first = height;
    ++n_posts;
    return;
  }
  if (first == height) return;
  auto& others = other_values[at];
  if (std::find(others.begin(), others.end(), height) != others.end()) return;
  double widest = std::abs(static_cast<double>(height) - static_cast<double>(first));
  for (const float other : others) {
    widest = std::max(widest, std::abs(static_cast<double>(height) - static_cast<double>(other)));
  }
  disagreement_m = std::max(disagreement_m, widest);
  others.push_back(height);
}

double first_longitude(const std::vector<double>& lon_deg, double* gap_deg) {
  constexpr std::size_t kBuckets = 3600;
  std::vector<double> lowest(kBuckets, 1e9);
  const auto turned = [](double lon) { return lon - 360 * std::floor((lon + 180) / 360); };
  for (const double lon : lon_deg) {
    if (!std::isfinite(lon)) continue;
    const double at = turned(lon);
    const auto bucket = std::min(kBuckets - 1, static_cast<std::size_t>((at + 180) * 10));
    lowest[bucket] = std::min(lowest[bucket], at);
  }
  // The longest run of empty buckets, going round once more than needed.
  std::size_t run = 0, best = 0, behind = 0;
  for (std::size_t k = 0; k < 2 * kBuckets; ++k) {
    if (lowest[k % kBuckets] < 1e8) {
      if (run > best || best == 0) {
        best = std::max<std::size_t>(run, 1);
        behind = k % kBuckets;
      }
      run = 0;
    } else {
      ++run;
    }
  }
  if (gap_deg != nullptr) *gap_deg = static_cast<double>(std::min(best, kBuckets)) / 10;
  return lowest[behind] < 1e8 ? lowest[behind] : -180;
}

Outcome<SourcePosts> read_source_posts(const std::vector<std::string>& paths, const SourceOptions& options,
                                       const GridClaim& claim) {
  if (paths.empty()) return refuse("no source");
  const auto n_point_files = std::count_if(paths.begin(), paths.end(), is_point_file);
  if (n_point_files > 0 && static_cast<std::size_t>(n_point_files) < paths.size()) {
    return refuse("the sources are rasters and points: a pyramid is built from one kind");
  }
  auto posts = n_point_files > 0 ? read_points(paths, options, claim) : read_rasters(paths, options, claim);
  if (!posts) return posts;
  if (!options.geoid.empty() || !options.vertical_datum.empty()) {
    const auto shift =
        options.geoid.empty() ? GeoidShift::from_datum(options.vertical_datum) : GeoidShift::from_grid(options.geoid);
    if (!shift) return refuse(shift.error());
    if (auto ok = lift(*posts, *shift); !ok) return refuse(ok.error());
  }
  if (posts->kind != SourceKind::kPoints) share_pole_rows(*posts);
  return posts;
}

}  // namespace tind::client
