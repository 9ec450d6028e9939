// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/mosaic_layout.hpp"

#include <algorithm>
#include <cmath>
#include <tuple>

#include <fmt/format.h>

namespace tind {
namespace {

auto canonical_key(const RasterFile& s) {
  return std::tie(s.south, s.west, s.info.n_rows, s.info.n_cols, s.info.sha256, s.info.name);
}

/// Columns between two meridians that lie on one grid. The same meridian has two names near longitude 180: the one that
/// lies on the grid is taken.
double columns_between(double west, double from_west, double dx) {
  double col = (west - from_west) / dx;
  for (const double turn : {-360.0, 360.0}) {
    const double other = (west - from_west + turn) / dx;
    if (std::abs(other - std::round(other)) < std::abs(col - std::round(col)) - kAlignPosts) col = other;
  }
  return col;
}

/// The number of columns around the globe, if it is whole.
std::optional<std::int64_t> columns_around(double dx) {
  const double around = std::round(360.0 / dx);
  if (std::abs(360.0 / dx - around) > kAlignPosts || around < 2) return std::nullopt;
  return static_cast<std::int64_t>(around);
}

}  // namespace

std::size_t sort_sources(std::vector<RasterFile>& files) {
  std::sort(files.begin(), files.end(),
            [](const RasterFile& a, const RasterFile& b) { return canonical_key(a) < canonical_key(b); });
  const auto same = [](const RasterFile& a, const RasterFile& b) {
    return std::tie(a.south, a.west, a.info.sha256) == std::tie(b.south, b.west, b.info.sha256);
  };
  const auto end = std::unique(files.begin(), files.end(), same);
  const auto n = static_cast<std::size_t>(files.end() - end);
  files.erase(end, files.end());
  return n;
}

std::optional<std::string> why_warp(const std::vector<RasterFile>& files) {
  for (const RasterFile& s : files) {
    if (!s.has_own_grid) return s.why_not_own;
  }
  const RasterFile& first = files.front();
  const auto around = columns_around(first.dx);
  const double dx = around ? 360.0 / static_cast<double>(*around) : first.dx;
  double low = 0, high = 0;
  for (const RasterFile& s : files) {
    const double cols_off = std::abs(s.dx / dx - 1) * static_cast<double>(s.info.n_cols);
    const double rows_off = std::abs(s.dy / first.dy - 1) * static_cast<double>(s.info.n_rows);
    if (cols_off > kAlignPosts || rows_off > kAlignPosts) {
      return fmt::format("the posts of {} are {} x {} degrees apart, those of {} {} x {}", s.info.name, s.dx, s.dy,
                         first.info.name, dx, first.dy);
    }
    const double row = (s.south - first.south) / first.dy, col = columns_between(s.west, first.west, dx);
    if (std::abs(row - std::round(row)) > kAlignPosts || std::abs(col - std::round(col)) > kAlignPosts)
      return fmt::format("the posts of {} do not lie on the grid of {}", s.info.name, first.info.name);
    low = std::min(low, col);
    high = std::max(high, col + static_cast<double>(s.info.n_cols));
  }
  if (!around && high - low > 360.0 / dx) {
    return fmt::format("{} reaches around the globe, but 360 degrees are not a whole number of posts", first.info.name);
  }
  return std::nullopt;
}

void place_sources(RasterMosaic& m, std::vector<RasterFile>& sources) {
  const RasterFile& first = sources.front();
  const auto around = columns_around(first.dx);
  const std::int64_t n_around = around.value_or(0);
  const double dx = around ? 360.0 / static_cast<double>(n_around) : first.dx;

  std::int64_t last_row = 0;
  for (RasterFile& s : sources) {
    const double row = (s.south - first.south) / first.dy;
    s.info.grid_row = std::llround(row);
    s.info.grid_col = std::llround(columns_between(s.west, first.west, dx));
    last_row = std::max(last_row, s.info.grid_row + s.info.n_used_rows);
  }
  m.lat_spacing_deg = first.dy;
  m.lon_spacing_deg = dx;
  m.south_deg = first.south;  // the canonical order starts with the southernmost
  m.n_rows = last_row;

  if (!around) {
    std::int64_t low = 0, high = 0;
    for (const RasterFile& s : sources) {
      low = std::min(low, s.info.grid_col);
      high = std::max(high, s.info.grid_col + s.info.n_used_cols);
    }
    for (RasterFile& s : sources) s.info.grid_col -= low;
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
    for (RasterFile& s : sources) {
      if (s.info.n_used_cols > n_around) {
        s.notes.push_back(
            fmt::format("{}: {} columns repeat others after 360 degrees; posts that differ get their mean", s.info.name,
                        s.info.n_used_cols - n_around));
      }
      auto col = (s.info.grid_col - static_cast<std::int64_t>(start)) % n_around;
      s.info.grid_col = col < 0 ? col + n_around : col;
      arcs.push_back({s.info.grid_col, s.info.grid_col + std::min(s.info.n_used_cols, n_around)});
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
    for (RasterFile& s : sources) s.info.grid_col = (s.info.grid_col - west_col + n_around) % n_around;
    m.west_deg = zero_deg + static_cast<double>(west_col) * dx;
  }
  m.west_deg = snap_origin(m.west_deg, dx);
  if (m.west_deg >= 180.0) m.west_deg -= 360.0;
  if (m.west_deg < -180.0) m.west_deg += 360.0;
}

}  // namespace tind
