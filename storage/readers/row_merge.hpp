// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/height_field.hpp"
#include "core/result.hpp"
#include "storage/readers/cancel.hpp"
#include "storage/readers/gdal_raster.hpp"
#include "storage/readers/height_grid.hpp"

namespace tind {

/// Makes rows of the extended grid of the rows of a mosaic's sources: a post that one source has is that source's, one
/// that several have is their mean. One thread at a time; several of them may work on one mosaic that
/// reads_in_parallel().
class RowMerge {
 public:
  /// Rows of the grid have `n_grid_cols` posts, the mosaic's from `west_col` on. The mosaic must live as long.
  RowMerge(const RasterMosaic& mosaic, std::int64_t n_grid_cols, std::int64_t west_col, CancelFlag cancel)
      : mosaic_(&mosaic), n_grid_cols_(n_grid_cols), west_col_(west_col), cancel_(cancel) {}

  /// Merges rows [begin, end) of the mosaic. False: no source has any of them. As RasterMosaic::read_rows;
  /// kInterrupted.
  Result<bool> merge(std::int64_t begin, std::int64_t end);
  /// Whether one source has all posts of the mosaic as they are, so that plain() may be asked.
  bool has_one_source() const;
  /// Posts of rows one after the other: row r begins at `first + r * stride`.
  struct Plain {
    const float* first = nullptr;
    std::int64_t stride = 0;
  };
  /// Reads the same rows as they are in the mosaic's one source. Null: there is a void. Valid until the next call. As
  /// merge().
  Result<Plain> plain(std::int64_t begin, std::int64_t end);
  /// The rows that were merged last: voids have height 0.
  std::span<const float> heights_m() const { return heights_m_; }
  std::span<const PostOrigin> origins() const { return origins_; }

  /// Of all rows merged so far.
  const HeightGridCounts& counts() const { return counts_; }
  double disagreement_m() const { return disagreement_m_; }

 private:
  /// Columns of the mosaic that a source has, from column `source_col` of its own on.
  struct Piece {
    std::size_t source;
    std::int64_t begin, end, source_col;
  };
  /// Columns of the mosaic that the same pieces have.
  struct Stretch {
    std::int64_t begin, end;
    std::int64_t n_pieces;
  };
  /// What sources have at the posts of the rows, as far as several do.
  struct Shared {
    std::vector<double> sum;
    std::vector<float> low, high;
    std::vector<std::uint16_t> count;

    void add(std::size_t i, float height);
  };

  /// Finds pieces_ and stretches_ of the sources that have some of the rows. False: none has.
  bool lay_out(std::int64_t begin, std::int64_t end);
  void clear(std::int64_t first, std::int64_t n);
  void take(const float* from, std::int64_t n, std::int64_t at, bool has_void);
  void take_source(std::size_t source, std::int64_t from, std::int64_t to, std::int64_t begin, std::int64_t end);
  void take_mean(std::int64_t n_rows, const Stretch& stretch);

  const RasterMosaic* mosaic_;
  std::int64_t n_grid_cols_, west_col_;
  CancelFlag cancel_;
  SourceRows rows_;
  std::vector<Piece> pieces_;       // by source
  std::vector<Stretch> stretches_;  // all columns, from west to east
  Shared shared_;                   // rows of the mosaic's width
  std::vector<float> heights_m_;
  std::vector<PostOrigin> origins_;
  HeightGridCounts counts_;
  double disagreement_m_ = 0;
};

}  // namespace tind
