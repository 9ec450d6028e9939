// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <vector>

#include "storage/report/source_grid.hpp"
#include "storage/report/surface_sampler.hpp"

namespace tind {

/// A coarser raster over a source's rectangle of posts, for comparison: its first and last rows and columns are those
/// of the rectangle, the others lie evenly between them, and each node has the height of the posts at its place
/// (bilinear; the post's own where it falls on one). Heights between nodes are bilinear.
class BilinearRaster {
 public:
  /// `rows`, `cols` >= 2 nodes.
  BilinearRaster(const SourceGrid& source, std::int64_t rows, std::int64_t cols);

  std::int64_t n_rows() const { return n_rows_; }
  std::int64_t n_cols() const { return n_cols_; }
  /// Nodes that have only posts of the source around them: the raster's points in the data.
  std::uint64_t n_data_nodes() const { return n_data_; }

  /// The error at the posts that carry the promise (source posts, or the points between interpolated ones) and have
  /// four data nodes around them. `heights_m`, if not null: the raster's height at every post of the rectangle that is
  /// source, interpolated or filled is written to that post of the field's grid (beside voids it rests on filled posts
  /// and falloff: water must find a surface there).
  SurfaceErrors measure(float* heights_m) const;

 private:
  SurfaceErrors measure_grid(float* heights_m) const;
  SurfaceErrors measure_points() const;

  const SourceGrid& source_;
  std::int64_t n_rows_, n_cols_;
  std::uint64_t n_data_ = 0;
  std::vector<float> nodes_m_;
  std::vector<std::uint8_t> is_data_;
};

/// Nodes of a comparison raster.
struct RasterShape {
  std::int64_t n_rows = 0, n_cols = 0;
};

/// Nodes every `row_step` rows and `col_step` columns (real numbers >= 1), rounded so that they fit the rectangle.
RasterShape shape_for_steps(const SourceGrid& source, double row_step, double col_step);

/// The shape with square steps (counted in posts) that has nearest to `n_points` nodes in the data.
RasterShape shape_for_points(const SourceGrid& source, std::uint64_t n_points);

}  // namespace tind
