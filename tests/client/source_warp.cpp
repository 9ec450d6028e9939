// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/source_warp.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace tind::client {
namespace {

/// A post so close (cells) to where a cell ends may lie on either side of it.
constexpr double kEitherSide = 1e-6;
/// Posts along a block, and the cells that one block may need before it is split.
constexpr std::int64_t kBlock = 256, kMostCells = std::int64_t{1} << 24;
/// Places along a raster's sides and across it at which its extent and scale are looked at.
constexpr int kAlongSide = 257, kAcross = 65;

double turned(double lon_deg) { return lon_deg - 360 * std::floor((lon_deg + 180) / 360); }

/// Ways between the globe and a raster's cells.
class CellMap {
 public:
  static Outcome<CellMap> make(const SourceRaster& raster) {
    const auto globe = Crs::from_text("EPSG:4326");
    if (!globe) return refuse(globe.error());
    const Crs own = raster.crs().empty() ? *globe : raster.crs().horizontal();
    auto there = Transform::make(*globe, own);
    auto back = Transform::make(own, *globe);
    if (!there) return refuse(raster.name() + ": " + there.error());
    if (!back) return refuse(raster.name() + ": " + back.error());
    CellMap map(raster, std::move(*there), std::move(*back));
    map.full_turn_ =
        own.is_geographic() ? 2 * std::acos(-1.0) / OSRGetAngularUnits(own.get(), nullptr) : map.cylinder_turn();
    return map;
  }

  /// Longitudes and latitudes become columns and rows in cells; NaN where there is no way.
  void to_cells(std::vector<double>& x, std::vector<double>& y) const {
    for (double& lon : x) lon = turned(lon);
    there_.apply(x, y);
    const auto& t = raster_->transform();
    const double determinant = t[1] * t[5] - t[2] * t[4];
    for (std::size_t k = 0; k < x.size(); ++k) {
      double px = x[k] - t[0];
      const double py = y[k] - t[3];
      // Where x repeats around the globe, the turn that the raster lies in.
      if (full_turn_ > 0 && t[2] == 0) {
        const double width = static_cast<double>(raster_->n_columns()) * t[1];
        px -= full_turn_ * std::floor((px - std::min(0.0, width)) / full_turn_);
      }
      x[k] = (px * t[5] - py * t[2]) / determinant;
      y[k] = (py * t[1] - px * t[4]) / determinant;
    }
  }
  /// Columns and rows become longitudes and latitudes.
  void to_globe(std::vector<double>& x, std::vector<double>& y) const {
    const auto& t = raster_->transform();
    for (std::size_t k = 0; k < x.size(); ++k) {
      const double column = x[k], row = y[k];
      x[k] = t[0] + column * t[1] + row * t[2];
      y[k] = t[3] + column * t[4] + row * t[5];
    }
    back_.apply(x, y);
  }
  const SourceRaster& raster() const { return *raster_; }
  bool inside(double column, double row, double slack) const {
    return column >= -slack && row >= -slack && column <= static_cast<double>(raster_->n_columns()) + slack &&
           row <= static_cast<double>(raster_->n_rows()) + slack;
  }

 private:
  /// x of a whole turn where the projection is a cylinder (x depends on longitude alone, and evenly); else 0.
  double cylinder_turn() const {
    std::vector<double> x, y;
    for (const double lat : {0.0, 40.0}) {
      for (const double lon : {-170.0, -100.0, -50.0, 10.0, 60.0, 130.0}) {
        for (const double ahead : {0.0, 0.5}) {
          x.push_back(lon + ahead);
          y.push_back(lat);
        }
      }
    }
    there_.apply(x, y);
    // The projection's own seam may fall into one of the six steps of a latitude.
    const double step = x[1] - x[0], other = x[3] - x[2];
    for (const double one : {step, other}) {
      int alike = 0;
      for (std::size_t k = 0; k < x.size(); k += 2)
        alike += std::abs(x[k + 1] - x[k] - one) <= 1e-9 * std::abs(one) ? 1 : 0;
      if (alike >= 10) return 720 * std::abs(one);
    }
    return 0;
  }

  CellMap(const SourceRaster& raster, Transform there, Transform back)
      : raster_(&raster), there_(std::move(there)), back_(std::move(back)) {}

  const SourceRaster* raster_;
  Transform there_, back_;
  double full_turn_ = 0;  ///< What x grows by in 360 degrees of longitude; 0: it does not repeat.
};

/// What of the globe a raster covers, and how densely.
struct Extent {
  bool whole_circle = false;
  double west_deg = 0, east_deg = 0, south_deg = 0, north_deg = 0;  ///< west in [-180, 180), east above it.
};

/// Cells per degree eastward (`east`) or northward at places on the globe; the densest one goes into `scale`. One-sided
/// steps: where the projection jumps (longitude 180 of a world map) the step that does not is right.
void measure_scale(const CellMap& map, const std::vector<double>& lon, const std::vector<double>& lat, bool east,
                   NativeScale& scale) {
  constexpr double kStepDeg = 1e-4;
  std::vector<double> x0 = lon, y0 = lat, x1 = lon, y1 = lat, x2 = lon, y2 = lat;
  for (std::size_t k = 0; k < lon.size(); ++k) {
    (east ? x1 : y1)[k] += kStepDeg;
    (east ? x2 : y2)[k] -= kStepDeg;
    if (y1[k] > 90) y1[k] = y2[k];
    if (y2[k] < -90) y2[k] = y1[k];
  }
  map.to_cells(x0, y0);
  map.to_cells(x1, y1);
  map.to_cells(x2, y2);
  for (std::size_t k = 0; k < lon.size(); ++k) {
    const double ahead = std::hypot(x1[k] - x0[k], y1[k] - y0[k]), behind = std::hypot(x2[k] - x0[k], y2[k] - y0[k]);
    const double cells = (std::isnan(ahead) ? behind : std::isnan(behind) ? ahead : std::min(ahead, behind)) / kStepDeg;
    if (cells > scale.cells_per_degree) scale = {cells, lon[k], lat[k]};
  }
}

Outcome<Extent> measure(const CellMap& map, const GridClaim& claim, std::array<NativeScale, 2>& native) {
  std::vector<double> x, y;
  const auto columns = static_cast<double>(map.raster().n_columns()), rows = static_cast<double>(map.raster().n_rows());
  const auto add = [&](double u, double v) {
    x.push_back(u * columns);
    y.push_back(v * rows);
  };
  for (int k = 0; k < kAlongSide; ++k) {
    const double along = static_cast<double>(k) / (kAlongSide - 1);
    add(along, 0);
    add(along, 1);
    add(0, along);
    add(1, along);
  }
  for (int r = 0; r < kAcross; ++r) {
    for (int c = 0; c < kAcross; ++c)
      add(static_cast<double>(c) / (kAcross - 1), static_cast<double>(r) / (kAcross - 1));
  }
  map.to_globe(x, y);
  std::vector<double> lon, lat;
  for (std::size_t k = 0; k < x.size(); ++k) {
    if (!std::isfinite(x[k]) || !std::isfinite(y[k]) || std::abs(y[k]) > 90 + 1e-9) continue;
    lon.push_back(turned(x[k]));
    lat.push_back(std::clamp(y[k], -90.0, 90.0));
  }
  if (lon.empty())
    return refuse(map.raster().name() + ": nothing of it lies on the globe: is its coordinate system right?");
  measure_scale(map, lon, lat, true, native[0]);
  measure_scale(map, lon, lat, false, native[1]);

  Extent e;
  double gap = 0;
  const double first = first_longitude(lon, &gap);
  const auto [south, north] = std::minmax_element(lat.begin(), lat.end());
  const double tall = (*north - *south) / 32 + 2 * claim.spacing_deg[1];
  e.south_deg = *south - tall;
  e.north_deg = *north + tall;
  double breadth = 0;
  for (const double at : lon) breadth = std::max(breadth, turned(at - first - 180) + 180);
  const double wide = breadth / 32 + 2 * claim.spacing_deg[0];
  e.west_deg = first - wide;
  e.east_deg = first + breadth + wide;
  // A pole within the raster, whichever way one comes to it, brings all longitudes along.
  for (const double pole : {-90.0, 90.0}) {
    std::vector<double> px, py;
    for (int k = 0; k < 8; ++k) {
      px.push_back(45.0 * k);
      py.push_back(pole);
    }
    map.to_cells(px, py);
    bool within = true;
    for (std::size_t k = 0; k < px.size(); ++k) within = within && map.inside(px[k], py[k], kEitherSide);
    if (!within) continue;
    e.whole_circle = true;
    (pole < 0 ? e.south_deg : e.north_deg) = pole;
  }
  e.whole_circle = e.whole_circle || gap < 12 || e.east_deg - e.west_deg >= 360;
  e.south_deg = std::max(e.south_deg, -90.0);
  e.north_deg = std::min(e.north_deg, 90.0);
  return e;
}

/// Posts of the grid that a raster may reach: multiples of the spacing.
struct Reach {
  std::int64_t column0 = 0, n_columns = 0, row0 = 0, n_rows = 0;
};

/// Fills a block of posts, or four smaller ones where the block needs too many cells.
class BlockWarp {
 public:
  BlockWarp(const CellMap& map, const GridClaim& claim, std::int64_t column0, std::int64_t row0, std::int64_t period,
            SourcePosts& posts)
      : map_(map), claim_(claim), column0_(column0), row0_(row0), period_(period), posts_(posts) {}

  Outcome<void> fill(const Reach& block) {
    const auto n = static_cast<std::size_t>(block.n_columns * block.n_rows);
    std::vector<double> x(n), y(n);
    for (std::size_t k = 0; k < n; ++k) {
      const auto i = static_cast<std::int64_t>(k);
      x[k] = static_cast<double>(block.column0 + i % block.n_columns) * claim_.spacing_deg[0];
      y[k] = std::clamp(static_cast<double>(block.row0 + i / block.n_columns) * claim_.spacing_deg[1], -90.0, 90.0);
    }
    map_.to_cells(x, y);
    double low_x = 1e300, high_x = -1e300, low_y = 1e300, high_y = -1e300;
    for (std::size_t k = 0; k < n; ++k) {
      if (!map_.inside(x[k], y[k], 1)) continue;
      low_x = std::min(low_x, x[k]);
      high_x = std::max(high_x, x[k]);
      low_y = std::min(low_y, y[k]);
      high_y = std::max(high_y, y[k]);
    }
    if (low_x > high_x) return {};
    CellWindow window;
    window.column0 = static_cast<std::int64_t>(std::floor(low_x)) - 3;
    window.row0 = static_cast<std::int64_t>(std::floor(low_y)) - 3;
    window.n_columns = static_cast<std::int64_t>(std::floor(high_x)) + 4 - window.column0;
    window.n_rows = static_cast<std::int64_t>(std::floor(high_y)) + 4 - window.row0;
    if (window.n_columns * window.n_rows > kMostCells && n > 1) return split(block);
    if (auto ok = map_.raster().read(window); !ok) return ok;
    for (double& cell : window.heights_m) cell = static_cast<double>(static_cast<float>(cell));
    for (std::size_t k = 0; k < n; ++k) {
      if (!map_.inside(x[k], y[k], 1)) continue;
      bool uncertain = false;
      const double height = interpolate_cells(window, x[k], y[k], claim_.cubic, uncertain);
      if (std::isnan(height)) continue;
      const auto i = static_cast<std::int64_t>(k);
      const std::int64_t column = (block.column0 + i % block.n_columns - column0_) % period_;
      const std::int64_t at = (block.row0 + i / block.n_columns - row0_) * posts_.n_cols + column;
      posts_.add_value(at, height);
      if (uncertain) posts_.either.insert(at);
    }
    return {};
  }

 private:
  Outcome<void> split(const Reach& block) {
    const std::int64_t half_c = block.n_columns / 2, half_r = block.n_rows / 2;
    for (int q = 0; q < 4; ++q) {
      Reach part;
      part.column0 = block.column0 + ((q & 1) != 0 ? half_c : 0);
      part.n_columns = (q & 1) != 0 ? block.n_columns - half_c : half_c;
      part.row0 = block.row0 + ((q & 2) != 0 ? half_r : 0);
      part.n_rows = (q & 2) != 0 ? block.n_rows - half_r : half_r;
      if (part.n_columns == 0 || part.n_rows == 0) continue;
      if (auto ok = fill(part); !ok) return ok;
    }
    return {};
  }

  const CellMap& map_;
  const GridClaim& claim_;
  std::int64_t column0_, row0_, period_;
  SourcePosts& posts_;
};

/// Bilinear with what there is of four centres.
double bilinear(const CellWindow& window, double gx, double gy) {
  const auto i = static_cast<std::int64_t>(std::floor(gx)), j = static_cast<std::int64_t>(std::floor(gy));
  const double tx = gx - static_cast<double>(i), ty = gy - static_cast<double>(j);
  double sum = 0, weights = 0;
  for (int corner = 0; corner < 4; ++corner) {
    const int a = corner & 1, b = corner >> 1;
    const double h = window.at(i + a, j + b);
    const double w = (a != 0 ? tx : 1 - tx) * (b != 0 ? ty : 1 - ty);
    if (std::isnan(h)) continue;
    sum += w * h;
    weights += w;
  }
  return weights > 0 ? sum / weights : CellWindow::kVoid;
}

/// Keys' weights (a = -0.5) of the centres at -1, 0, 1, 2 for a place t in [0, 1).
std::array<double, 4> keys_weights(double t) {
  const auto near = [](double s) { return (1.5 * s - 2.5) * s * s + 1; };
  const auto far = [](double s) { return ((-0.5 * s + 2.5) * s - 4) * s + 2; };
  return {far(1 + t), near(t), near(1 - t), far(2 - t)};
}

/// NaN where one of sixteen centres is void.
double bicubic(const CellWindow& window, std::int64_t i, std::int64_t j, double tx, double ty) {
  const auto wx = keys_weights(tx), wy = keys_weights(ty);
  double sum = 0;
  for (std::int64_t b = 0; b < 4; ++b) {
    for (std::int64_t a = 0; a < 4; ++a) {
      sum += wx[static_cast<std::size_t>(a)] * wy[static_cast<std::size_t>(b)] * window.at(i + a - 1, j + b - 1);
    }
  }
  return sum;
}

}  // namespace

double interpolate_cells(const CellWindow& window, double column, double row, bool cubic, bool& uncertain) {
  const auto cell = [](double v) { return static_cast<std::int64_t>(std::floor(v)); };
  const bool valid = !std::isnan(window.at(cell(column), cell(row)));
  for (const double dx : {-kEitherSide, kEitherSide}) {
    for (const double dy : {-kEitherSide, kEitherSide}) {
      if (std::isnan(window.at(cell(column + dx), cell(row + dy))) == valid) uncertain = true;
    }
  }
  if (!valid && !uncertain) return CellWindow::kVoid;
  const double gx = column - 0.5, gy = row - 0.5;
  if (!cubic) return bilinear(window, gx, gy);
  const double value = bicubic(window, cell(gx), cell(gy), gx - std::floor(gx), gy - std::floor(gy));
  for (const double dx : {-kEitherSide, kEitherSide}) {
    for (const double dy : {-kEitherSide, kEitherSide}) {
      if (std::isnan(bicubic(window, cell(gx + dx), cell(gy + dy), 0.5, 0.5)) != std::isnan(value)) uncertain = true;
    }
  }
  return std::isnan(value) ? bilinear(window, gx, gy) : value;
}

Outcome<SourcePosts> read_warped(const std::vector<SourceRaster>& rasters, const GridClaim& claim) {
  const double dx = claim.spacing_deg[0], dy = claim.spacing_deg[1];
  if (!(dx > 0 && dy > 0 && dx <= 90 && dy <= 90)) {
    return refuse(rasters[0].name() +
                  ": is projected, rotated or on a grid of its own: its posts depend on the manifest's grid, which "
                  "gives no spacing");
  }
  SourcePosts posts;
  posts.kind = SourceKind::kWarped;
  posts.rounded = true;
  posts.lon_spacing_deg = dx;
  posts.lat_spacing_deg = dy;
  const std::int64_t period = std::llround(360 / dx);
  std::vector<CellMap> maps;
  std::vector<Reach> reaches;
  std::vector<double> covered;
  for (const auto& raster : rasters) {
    posts.names.push_back(raster.name());
    auto map = CellMap::make(raster);
    if (!map) return refuse(map.error());
    const auto extent = measure(*map, claim, posts.native);
    if (!extent) return refuse(extent.error());
    Reach reach;
    reach.column0 = static_cast<std::int64_t>(std::ceil(extent->whole_circle ? -180 / dx : extent->west_deg / dx));
    reach.n_columns =
        extent->whole_circle
            ? period
            : std::min(period, static_cast<std::int64_t>(std::floor(extent->east_deg / dx)) - reach.column0 + 1);
    reach.row0 = static_cast<std::int64_t>(std::ceil(extent->south_deg / dy - 1e-9));
    reach.n_rows = static_cast<std::int64_t>(std::floor(extent->north_deg / dy + 1e-9)) - reach.row0 + 1;
    const double end = static_cast<double>(reach.column0 + reach.n_columns - 1) * dx;
    for (double lon = static_cast<double>(reach.column0) * dx; lon < end; lon += 0.05) covered.push_back(lon);
    covered.push_back(end);
    maps.push_back(std::move(*map));
    reaches.push_back(reach);
  }
  // The westernmost column is the first behind the widest gap that all rasters together leave.
  const double first = first_longitude(covered, nullptr);
  const auto west = static_cast<std::int64_t>(std::floor(first / dx)) - 1;
  std::int64_t south = reaches[0].row0, north = south;
  for (Reach& reach : reaches) {
    reach.column0 = west + ((reach.column0 - west) % period + period) % period;
    posts.n_cols = std::min(period, std::max(posts.n_cols, reach.column0 - west + reach.n_columns));
    south = std::min(south, reach.row0);
    north = std::max(north, reach.row0 + reach.n_rows - 1);
  }
  posts.n_rows = north - south + 1;
  posts.west_deg = static_cast<double>(west) * dx;
  posts.south_deg = static_cast<double>(south) * dy;
  if (auto ok = posts.allocate(); !ok) return refuse(ok.error());
  for (std::size_t s = 0; s < rasters.size(); ++s) {
    BlockWarp warp(maps[s], claim, west, south, period, posts);
    const Reach& reach = reaches[s];
    for (std::int64_t r = 0; r < reach.n_rows; r += kBlock) {
      for (std::int64_t c = 0; c < reach.n_columns; c += kBlock) {
        const Reach block{reach.column0 + c, std::min(kBlock, reach.n_columns - c), reach.row0 + r,
                          std::min(kBlock, reach.n_rows - r)};
        if (auto ok = warp.fill(block); !ok) return refuse(ok.error());
      }
    }
  }
  posts.n_posts -= posts.either.size();
  return posts;
}

}  // namespace tind::client
