// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/warp_plan.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <tuple>

#include <fmt/format.h>

namespace tind {
namespace {

/// Resolution is measured at this many positions along each side, the raster's rim among them.
constexpr int kSamples = 33;
/// Step of the difference quotients; 11 m at the equator.
constexpr double kStepDeg = 1e-4;
/// Share by which a post may be wider than a cell: what difference quotients leave of an exact spacing.
constexpr double kRounding = 1e-6;
/// The rim is walked in at most this many steps a side, and an extent whose rim leaves the globe in these from inside.
constexpr std::int64_t kMostRimSteps = 1 << 16, kInsideSteps = 512;
/// A pole this close to the rim lies on it.
constexpr double kRimCells = 1e-6, kPoleDeg = 90 - 1e-9;
/// 10^11 posts take 0.5 TB of scratch file; a real survey of that size is built in parts.
constexpr double kMostPosts = 1e11;
/// Cells of one raster; most of them must be off the globe if there are more than posts.
constexpr double kMostCells = 1e12;

bool is_finite(const Place& p) { return std::isfinite(p.x) && std::isfinite(p.y); }

/// The shorter way from longitude a to b, -180..180.
double short_way(double a, double b) { return std::remainder(b - a, 360.0); }

/// Longitudes that are covered, as arcs on the circle.
class Longitudes {
 public:
  void add(double from, double to, double margin = 0) {
    const double way = short_way(from, to), length = std::abs(way) + 2 * margin;
    double begin = std::fmod((way < 0 ? to : from) - margin, 360.0);
    if (begin < 0) begin += 360;
    arcs_.push_back({begin, begin + length});
  }
  /// West and width of the whole without its widest gap.
  std::pair<double, double> bounds() {
    std::sort(arcs_.begin(), arcs_.end(),
              [](const Arc& a, const Arc& b) { return std::tie(a.begin, a.end) < std::tie(b.begin, b.end); });
    double reach = 0;
    for (const Arc& a : arcs_) reach = std::max(reach, a.end);
    reach -= 360;  // what passes longitude 360 covers the beginning
    double widest = 0, west = -180;
    for (const Arc& a : arcs_) {
      if (a.begin - reach > widest) {
        widest = a.begin - reach;
        west = a.begin;
      }
      reach = std::max(reach, a.end);
    }
    return {west, 360 - widest};
  }

 private:
  struct Arc {
    double begin, end;
  };
  std::vector<Arc> arcs_;
};

struct Cover {
  Longitudes longitudes;
  double south = 90, north = -90;

  void add(const Place& a, const Place& b, double margin_x = 0, double margin_y = 0) {
    // A pole has no longitude.
    if (std::abs(a.y) < kPoleDeg && std::abs(b.y) < kPoleDeg) longitudes.add(a.x, b.x, margin_x);
    south = std::min({south, a.y - margin_y, b.y - margin_y});
    north = std::max({north, a.y + margin_y, b.y + margin_y});
  }
};

/// The rim of the raster as longitudes and latitudes, once around; empty when some of it is not on the globe.
std::vector<Place> walk_rim(const RasterFile& file, const PixelTransform& transform) {
  const auto w = static_cast<double>(file.info.n_cols), h = static_cast<double>(file.info.n_rows);
  const auto n_x = std::min(file.info.n_cols, kMostRimSteps), n_y = std::min(file.info.n_rows, kMostRimSteps);
  std::vector<Place> rim;
  for (std::int64_t k = 0; k < n_x; ++k) rim.push_back({w * static_cast<double>(k) / static_cast<double>(n_x), 0});
  for (std::int64_t k = 0; k < n_y; ++k) rim.push_back({w, h * static_cast<double>(k) / static_cast<double>(n_y)});
  for (std::int64_t k = n_x; k > 0; --k) rim.push_back({w * static_cast<double>(k) / static_cast<double>(n_x), h});
  for (std::int64_t k = n_y; k > 0; --k) rim.push_back({0, h * static_cast<double>(k) / static_cast<double>(n_y)});
  transform.to_globe(rim);
  if (!std::all_of(rim.begin(), rim.end(), is_finite)) return {};
  rim.push_back(rim.front());
  return rim;
}

/// Whether all meridians meet the pole inside the raster, not just on its rim.
bool holds_pole(const RasterFile& file, const PixelTransform& transform, double latitude) {
  std::array<Place, 12> places;
  for (std::size_t k = 0; k < places.size(); ++k) places[k] = {-180.0 + 30.0 * static_cast<double>(k), latitude};
  transform.to_cells(places);
  const auto w = static_cast<double>(file.info.n_cols), h = static_cast<double>(file.info.n_rows);
  return std::all_of(places.begin(), places.end(), [&](const Place& p) {
    return p.x > kRimCells && p.x < w - kRimCells && p.y > kRimCells && p.y < h - kRimCells;
  });
}

/// Covers what lies between neighbouring positions inside the raster, and as much again around it.
void cover_inside(const RasterFile& file, const PixelTransform& transform, Cover& cover) {
  const auto n_x = std::min(file.info.n_cols, kInsideSteps), n_y = std::min(file.info.n_rows, kInsideSteps);
  const auto w = static_cast<double>(file.info.n_cols), h = static_cast<double>(file.info.n_rows);
  std::vector<Place> before, row;
  for (std::int64_t r = 0; r <= n_y; ++r) {
    row.clear();
    for (std::int64_t c = 0; c <= n_x; ++c)
      row.push_back({w * static_cast<double>(c) / static_cast<double>(n_x),
                     h * static_cast<double>(r) / static_cast<double>(n_y)});
    transform.to_globe(row);
    const auto join = [&](const Place& a, const Place& b) {
      if (is_finite(a) && is_finite(b)) cover.add(a, b, std::abs(short_way(a.x, b.x)), std::abs(a.y - b.y));
    };
    for (std::size_t c = 0; c + 1 < row.size(); ++c) join(row[c], row[c + 1]);
    for (std::size_t c = 0; c < before.size(); ++c) join(before[c], row[c]);
    before = row;
  }
  cover.south = std::max(cover.south, -90.0);
  cover.north = std::min(cover.north, 90.0);
}

/// Cells along one degree from `at`, the way (dx, dy): the shorter of both directions, because a seam of the projection
/// may lie in one of them. Not finite: nothing there.
double cells_per_degree(const PixelTransform& transform, const Place& at, double dx, double dy) {
  std::array<Place, 3> p{Place{at.x - dx * kStepDeg, at.y - dy * kStepDeg}, at,
                         Place{at.x + dx * kStepDeg, at.y + dy * kStepDeg}};
  for (Place& q : p) {
    if (std::abs(q.y) > 90) q.y = INFINITY;
  }
  transform.to_cells(p);
  const auto length = [&](const Place& a, const Place& b) {
    double least = std::hypot(a.x - b.x, a.y - b.y);
    if (!transform.turn()) return least;
    const Place turn = *transform.turn();
    for (const double k : {-1.0, 1.0})
      least = std::min(least, std::hypot(a.x - b.x + k * turn.x, a.y - b.y + k * turn.y));
    return least;
  };
  const double back = length(p[0], p[1]), forth = length(p[1], p[2]);
  return (std::isfinite(back) && std::isfinite(forth) ? std::min(back, forth)
          : std::isfinite(back)                       ? back
                                                      : forth) /
         kStepDeg;
}

}  // namespace

Result<WarpExtent> measure_extent(const RasterFile& file, const PixelTransform& transform) {
  WarpExtent extent;
  for (int r = 0; r < kSamples; ++r) {
    for (int c = 0; c < kSamples; ++c) {
      std::array<Place, 1> p{Place{static_cast<double>(file.info.n_cols) * c / (kSamples - 1),
                                   static_cast<double>(file.info.n_rows) * r / (kSamples - 1)}};
      transform.to_globe(p);
      if (!is_finite(p[0])) continue;
      const double east = cells_per_degree(transform, p[0], 1, 0), north = cells_per_degree(transform, p[0], 0, 1);
      if (std::isfinite(east)) extent.cells_per_degree_east = std::max(extent.cells_per_degree_east, east);
      if (std::isfinite(north)) extent.cells_per_degree_north = std::max(extent.cells_per_degree_north, north);
    }
  }
  Cover cover;
  const std::vector<Place> rim = walk_rim(file, transform);
  for (std::size_t i = 0; i + 1 < rim.size(); ++i) cover.add(rim[i], rim[i + 1]);
  if (rim.empty()) cover_inside(file, transform, cover);
  if (!(extent.cells_per_degree_east > 0 && extent.cells_per_degree_north > 0) || cover.north < cover.south) {
    return bad_raster(file, fmt::format("nothing of it lies on the globe by its CRS \"{}\" and its geotransform; check "
                                        "them with gdalinfo",
                                        file.info.crs));
  }
  std::tie(extent.west_deg, extent.width_deg) = cover.longitudes.bounds();
  extent.south_deg = std::max(cover.south, -90.0);
  extent.north_deg = std::min(cover.north, 90.0);
  for (const double pole : {-90.0, 90.0}) {
    if (!holds_pole(file, transform, pole)) continue;
    (pole < 0 ? extent.south_deg : extent.north_deg) = pole;
    extent.west_deg = -180;
    extent.width_deg = 360;
  }
  return extent;
}

Result<WarpGrid> plan_warp(const std::vector<WarpExtent>& extents, const std::vector<RasterFile>& files) {
  double east = 0, north = 0;
  for (std::size_t i = 0; i < extents.size(); ++i) {
    east = std::max(east, extents[i].cells_per_degree_east);
    north = std::max(north, extents[i].cells_per_degree_north);
    const double columns = std::ceil(extents[i].width_deg * east),
                 rows = std::ceil((extents[i].north_deg - extents[i].south_deg) * north);
    const double cells = static_cast<double>(files[i].info.n_cols) * static_cast<double>(files[i].info.n_rows);
    if (cells > kMostCells)
      return bad_raster(files[i], fmt::format("{:.3g} cells are more than 1e12; cut it into parts", cells));
    if (!(columns * rows <= kMostPosts) || !(east * 360 < 1e15) || !(north * 180 < 1e15)) {
      return bad_raster(files[i],
                        fmt::format("warped to posts no coarser than the finest source it takes {:.3g} x {:.3g} posts, "
                                    "more than 1e11; check its CRS and geotransform with gdalinfo, or build coarse and "
                                    "fine sources apart",
                                    columns, rows));
    }
  }
  WarpGrid grid;
  const auto parts = [](double cells) -> std::int64_t {
    return std::max(1LL, std::llround(std::ceil(cells * (1 - kRounding))));
  };
  grid.lon_per_degree = parts(east);
  grid.lat_per_degree = parts(north);
  const auto per_lon = static_cast<double>(grid.lon_per_degree), per_lat = static_cast<double>(grid.lat_per_degree);
  const std::int64_t around = 360 * grid.lon_per_degree, pole = 90 * grid.lat_per_degree;
  for (const WarpExtent& e : extents) {
    WarpWindow w;
    w.first_col = std::llround(std::floor(e.west_deg * per_lon));
    w.n_cols = std::llround(std::ceil((e.west_deg + e.width_deg) * per_lon)) - w.first_col + 1;
    if (w.n_cols >= around) {
      w.first_col = -around / 2;
      w.n_cols = around;
    }
    w.first_row = std::max(-pole, std::int64_t{std::llround(std::floor(e.south_deg * per_lat))});
    const auto last_row = std::min(pole, std::int64_t{std::llround(std::ceil(e.north_deg * per_lat))});
    w.n_rows = last_row - w.first_row + 1;
    grid.windows.push_back(w);
  }
  return grid;
}

}  // namespace tind
