// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/report/bilinear_raster.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "storage/builder/tile_posts.hpp"

namespace tind {
namespace {

/// A position on one axis: between index `low` and low + 1 (or on `low`, when `part` is 0).
struct AxisPlace {
  std::int64_t low = 0;
  double part = 0;

  std::int64_t high() const { return part > 0 ? low + 1 : low; }
};

/// Where index `i` of an axis with `n_from` evenly spread places lies on one with `n_to` over the same stretch.
/// Integers decide whether it falls on one.
AxisPlace place_on(std::int64_t i, std::int64_t n_from, std::int64_t n_to) {
  const std::int64_t scaled = i * (n_to - 1), per = n_from - 1;
  return {scaled / per, static_cast<double>(scaled % per) / static_cast<double>(per)};
}

double mix(double a, double b, double part) { return a + part * (b - a); }

}  // namespace

BilinearRaster::BilinearRaster(const SourceGrid& source, std::int64_t rows, std::int64_t cols)
    : source_(source),
      n_rows_(rows),
      n_cols_(cols),
      nodes_m_(static_cast<std::size_t>(rows * cols)),
      is_data_(static_cast<std::size_t>(rows * cols)) {
  assert(rows >= 2 && cols >= 2 && source.n_rows >= 2 && source.n_cols >= 2);
  const HeightField& field = source.field();
  std::vector<AxisPlace> on_cols;
  for (std::int64_t j = 0; j < cols; ++j) on_cols.push_back(place_on(j, cols, source.n_cols));
  for (std::int64_t i = 0; i < rows; ++i) {
    const AxisPlace row = place_on(i, rows, source.n_rows);
    const std::int64_t south = source.first_row + row.low, north = source.first_row + row.high();
    for (std::int64_t j = 0; j < cols; ++j) {
      const AxisPlace& col = on_cols[static_cast<std::size_t>(j)];
      const std::int64_t west = source.first_col + col.low, east = source.first_col + col.high();
      const double height = mix(mix(field.height_at(south, west), field.height_at(south, east), col.part),
                                mix(field.height_at(north, west), field.height_at(north, east), col.part), row.part);
      const bool data = is_of_source(field.origin_at(south, west)) && is_of_source(field.origin_at(south, east)) &&
                        is_of_source(field.origin_at(north, west)) && is_of_source(field.origin_at(north, east));
      const auto at = static_cast<std::size_t>(i * cols + j);
      nodes_m_[at] = static_cast<float>(height);
      is_data_[at] = data;
      n_data_ += data;
    }
  }
}

SurfaceErrors BilinearRaster::measure(float* heights_m) const {
  const SurfaceErrors of_grid = measure_grid(heights_m);
  return source_.field().points.empty() ? of_grid : measure_points();
}

SurfaceErrors BilinearRaster::measure_points() const {
  const HeightField& field = source_.field();
  const double width = static_cast<double>(field.lattice.width());
  const double rows_a_post = static_cast<double>(n_rows_ - 1) / static_cast<double>(source_.n_rows - 1);
  const double cols_a_post = static_cast<double>(n_cols_ - 1) / static_cast<double>(source_.n_cols - 1);
  SurfaceErrors errors;
  for (std::int64_t b = 0; b < field.points.n_rows * field.points.n_cols; ++b) {
    SurfaceErrors of_block;
    for (const PointPost& p : field.points.block(b / field.points.n_cols, b % field.points.n_cols)) {
      const double east = p.x < field.x0 ? p.x + width - field.x0 : p.x - field.x0;
      const double v = ((p.y - field.y0) / field.dy - static_cast<double>(source_.first_row)) * rows_a_post;
      const double u = (east / field.dx - static_cast<double>(source_.first_col)) * cols_a_post;
      const auto i = static_cast<std::int64_t>(std::floor(v)), j = static_cast<std::int64_t>(std::floor(u));
      if (i < 0 || j < 0 || i + 1 >= n_rows_ || j + 1 >= n_cols_) continue;
      const auto sw = static_cast<std::size_t>(i * n_cols_ + j), nw = sw + static_cast<std::size_t>(n_cols_);
      if (!is_data_[sw] || !is_data_[sw + 1] || !is_data_[nw] || !is_data_[nw + 1]) continue;
      const double part = u - static_cast<double>(j);
      const double height = mix(mix(double{nodes_m_[sw]}, double{nodes_m_[sw + 1]}, part),
                                mix(double{nodes_m_[nw]}, double{nodes_m_[nw + 1]}, part), v - static_cast<double>(i));
      of_block.add(height - static_cast<double>(p.height_m));
    }
    errors.add(of_block);
  }
  return errors;
}

SurfaceErrors BilinearRaster::measure_grid(float* heights_m) const {
  const HeightField& field = source_.field();
  std::vector<AxisPlace> on_cols;
  for (std::int64_t c = 0; c < source_.n_cols; ++c) on_cols.push_back(place_on(c, source_.n_cols, n_cols_));
  SurfaceErrors errors;
  for (std::int64_t r = 0; r < source_.n_rows; ++r) {
    const AxisPlace row = place_on(r, source_.n_rows, n_rows_);
    const std::int64_t grid_row = source_.first_row + r;
    SurfaceErrors of_row;  // summed by rows: a long sum of small squares keeps its digits
    for (std::int64_t c = 0; c < source_.n_cols; ++c) {
      const std::int64_t grid_col = source_.first_col + c;
      const PostOrigin origin = field.origin_at(grid_row, grid_col);
      if (!is_of_source(origin) && origin != PostOrigin::kFilled) continue;
      const AxisPlace& col = on_cols[static_cast<std::size_t>(c)];
      const auto at = [&](std::int64_t i, std::int64_t j) { return static_cast<std::size_t>(i * n_cols_ + j); };
      const std::size_t sw = at(row.low, col.low), se = at(row.low, col.high());
      const std::size_t nw = at(row.high(), col.low), ne = at(row.high(), col.high());
      const double height = mix(mix(double{nodes_m_[sw]}, double{nodes_m_[se]}, col.part),
                                mix(double{nodes_m_[nw]}, double{nodes_m_[ne]}, col.part), row.part);
      if (heights_m) heights_m[grid_row * field.n_cols + grid_col] = static_cast<float>(height);
      if (is_of_source(origin) && is_data_[sw] && is_data_[se] && is_data_[nw] && is_data_[ne]) {
        of_row.add(height - field.height_at(grid_row, grid_col));
      }
    }
    errors.add(of_row);
  }
  return errors;
}

RasterShape shape_for_steps(const SourceGrid& source, double row_step, double col_step) {
  const auto nodes = [](std::int64_t n, double step) {
    const auto whole = std::llround(static_cast<double>(n - 1) / std::max(step, 1.0)) + 1;
    return std::clamp<std::int64_t>(whole, 2, n);
  };
  return {nodes(source.n_rows, row_step), nodes(source.n_cols, col_step)};
}

RasterShape shape_for_points(const SourceGrid& source, std::uint64_t n_points) {
  const auto rows = static_cast<double>(source.n_rows - 1), cols = static_cast<double>(source.n_cols - 1);
  const double share = static_cast<double>(source.n_grid_posts) /
                       (static_cast<double>(source.n_rows) * static_cast<double>(source.n_cols));
  // More steps, fewer nodes: halve the interval until it is a double wide.
  double low = 1, high = std::max(rows, cols);
  for (int i = 0; i < 64; ++i) {
    const double step = (low + high) / 2;
    const double nodes = (rows / step + 1) * (cols / step + 1) * share;
    (nodes > static_cast<double>(n_points) ? low : high) = step;
  }
  return shape_for_steps(source, high, high);
}

}  // namespace tind
