// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/row_merge.hpp"

#include <algorithm>
#include <cmath>

namespace tind {

void RowMerge::Shared::add(std::size_t i, float height) {
  if (count[i] == 0) {
    sum[i] = height;
    low[i] = high[i] = height;
  } else {
    sum[i] += height;
    low[i] = std::min(low[i], height);
    high[i] = std::max(high[i], height);
  }
  ++count[i];
}

bool RowMerge::lay_out(std::int64_t begin, std::int64_t end) {
  const std::int64_t n_cols = mosaic_->n_cols;
  pieces_.clear();
  std::vector<std::int64_t> cuts = {0, n_cols};
  for (std::size_t s = 0; s < mosaic_->sources.size(); ++s) {
    const RasterSource& source = mosaic_->sources[s];
    if (source.grid_row >= end || source.grid_row + source.n_used_rows <= begin) continue;
    // Columns that pass the mosaic's eastern end go on at its western one.
    for (std::int64_t done = 0, col = source.grid_col; done < source.n_used_cols; col = 0) {
      const std::int64_t n = std::min(source.n_used_cols - done, n_cols - col);
      pieces_.push_back({s, col, col + n, done});
      cuts.insert(cuts.end(), {col, col + n});
      done += n;
    }
  }
  if (pieces_.empty()) return false;
  std::sort(cuts.begin(), cuts.end());
  cuts.erase(std::unique(cuts.begin(), cuts.end()), cuts.end());
  stretches_.clear();
  for (std::size_t k = 0; k + 1 < cuts.size(); ++k) {
    const auto n = std::count_if(pieces_.begin(), pieces_.end(), [&](const Piece& piece) {
      return piece.begin <= cuts[k] && cuts[k + 1] <= piece.end;
    });
    stretches_.push_back({cuts[k], cuts[k + 1], n});
  }
  return true;
}

void RowMerge::clear(std::int64_t first, std::int64_t n) {
  std::fill_n(heights_m_.begin() + first, n, 0.0f);
  std::fill_n(origins_.begin() + first, n, PostOrigin::kBase);
}

// `n` posts of a source, for those from index `at` on.
void RowMerge::take(const float* from, std::int64_t n, std::int64_t at, bool has_void) {
  float* __restrict heights = heights_m_.data() + at;
  PostOrigin* __restrict origins = origins_.data() + at;
  if (!has_void) {
    std::copy_n(from, n, heights);
    std::fill_n(origins, n, PostOrigin::kSource);
    counts_.source += static_cast<std::uint64_t>(n);
    return;
  }
  std::uint32_t n_voids = 0;
  for (std::int64_t c = 0; c < n; ++c) {
    const bool is_void = std::isnan(from[c]);
    heights[c] = is_void ? 0 : from[c];
    origins[c] = is_void ? PostOrigin::kBase : PostOrigin::kSource;
    n_voids += is_void ? 1u : 0u;
  }
  counts_.source += static_cast<std::uint64_t>(n) - n_voids;
}

// Rows [from, to) of the mosaic, which rows_ has, out of [begin, end).
void RowMerge::take_source(std::size_t source, std::int64_t from, std::int64_t to, std::int64_t begin,
                           std::int64_t end) {
  for (const Piece& piece : pieces_) {
    if (piece.source != source) continue;
    for (const Stretch& stretch : stretches_) {
      if (stretch.begin < piece.begin || stretch.end > piece.end) continue;
      const std::int64_t n = stretch.end - stretch.begin, col = piece.source_col + stretch.begin - piece.begin;
      if (stretch.n_pieces == 1) {
        for (std::int64_t r = begin; r < end; ++r) {
          const std::int64_t at = (r - begin) * n_grid_cols_ + west_col_ + stretch.begin;
          if (r < from || r >= to) {
            clear(at, n);
          } else {
            take(rows_.row(r - from) + col, n, at, rows_.has_void);
          }
        }
        continue;
      }
      for (std::int64_t r = from; r < to; ++r) {
        const float* row = rows_.row(r - from) + col;
        const auto at = static_cast<std::size_t>((r - begin) * mosaic_->n_cols + stretch.begin);
        for (std::int64_t c = 0; c < n; ++c) {
          if (!std::isnan(row[c])) shared_.add(at + static_cast<std::size_t>(c), row[c]);
        }
      }
    }
  }
}

void RowMerge::take_mean(std::int64_t n_rows, const Stretch& stretch) {
  for (std::int64_t r = 0; r < n_rows; ++r) {
    for (std::int64_t c = stretch.begin; c < stretch.end; ++c) {
      const auto i = static_cast<std::size_t>(r * mosaic_->n_cols + c),
                 o = static_cast<std::size_t>(r * n_grid_cols_ + west_col_ + c);
      if (shared_.count[i] == 0) continue;
      const auto height = static_cast<float>(shared_.sum[i] / shared_.count[i]);
      heights_m_[o] = height;
      origins_[o] = PostOrigin::kSource;
      ++counts_.source;
      if (shared_.count[i] < 2) continue;
      ++counts_.overlapping;
      if (shared_.low[i] == shared_.high[i]) continue;
      ++counts_.disagreeing;
      const double mean = height, low = shared_.low[i], high = shared_.high[i];
      disagreement_m_ = std::max({disagreement_m_, high - mean, mean - low});
    }
  }
}

bool RowMerge::has_one_source() const {
  const RasterSource& s = mosaic_->sources.front();
  return mosaic_->reads_in_parallel() && mosaic_->sources.size() == 1 && s.grid_row == 0 && s.grid_col == 0 &&
         s.n_used_rows == mosaic_->n_rows && s.n_used_cols == mosaic_->n_cols;
}

Result<RowMerge::Plain> RowMerge::plain(std::int64_t begin, std::int64_t end) {
  if (is_set(cancel_)) return interrupted();
  if (auto read = mosaic_->read_rows(0, begin, end - begin, rows_, counts_.implausible); !read) {
    return tl::unexpected(read.error());
  }
  if (rows_.has_void) return Plain{};
  counts_.source += static_cast<std::uint64_t>((end - begin) * rows_.n_cols);
  return Plain{rows_.row(0), rows_.northernmost_first ? -rows_.n_cols : rows_.n_cols};
}

Result<bool> RowMerge::merge(std::int64_t begin, std::int64_t end) {
  if (!lay_out(begin, end)) return false;
  const std::int64_t n_rows = end - begin, n_cols = mosaic_->n_cols;
  const auto n_posts = static_cast<std::size_t>(n_rows * n_grid_cols_);
  // Beside the mosaic they are voids at first, and nothing is ever written there.
  heights_m_.resize(n_posts);
  origins_.resize(n_posts);
  // What one source alone has, its rows fill.
  for (const Stretch& stretch : stretches_) {
    if (stretch.n_pieces == 1) continue;
    for (std::int64_t r = 0; r < n_rows; ++r)
      clear(r * n_grid_cols_ + west_col_ + stretch.begin, stretch.end - stretch.begin);
    if (stretch.n_pieces == 0) continue;
    const auto n_shared = static_cast<std::size_t>(n_rows * n_cols);
    if (shared_.count.size() < n_shared) {
      shared_.sum.resize(n_shared);
      shared_.low.resize(n_shared);
      shared_.high.resize(n_shared);
      shared_.count.resize(n_shared);
    }
    for (std::int64_t r = 0; r < n_rows; ++r)
      std::fill_n(shared_.count.begin() + r * n_cols + stretch.begin, stretch.end - stretch.begin, std::uint16_t{0});
  }
  for (std::size_t k = 0; k < pieces_.size(); ++k) {
    const std::size_t s = pieces_[k].source;
    if (k > 0 && pieces_[k - 1].source == s) continue;
    if (is_set(cancel_)) return interrupted();
    const RasterSource& source = mosaic_->sources[s];
    const std::int64_t from = std::max(begin, source.grid_row),
                       to = std::min(end, source.grid_row + source.n_used_rows);
    if (auto read = mosaic_->read_rows(s, from - source.grid_row, to - from, rows_, counts_.implausible); !read) {
      return tl::unexpected(read.error());
    }
    take_source(s, from, to, begin, end);
  }
  for (const Stretch& stretch : stretches_) {
    if (stretch.n_pieces > 1) take_mean(n_rows, stretch);
  }
  return true;
}

}  // namespace tind
