// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/post_blocks.hpp"

#include <array>
#include <atomic>
#include <cassert>
#include <cmath>
#include <cstring>
#include <limits>

#include "core/drainage/flow_run.hpp"
#include "core/height_field.hpp"
#include "core/registers.hpp"

namespace tind {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
/// Share of the size of a plane's terms by which two double evaluations of a residual may differ, with room to spare:
/// each makes at most four roundings of 2^-53.
constexpr double kSlack = 0x1p-48;

float float_below(double v) {
  const auto f = static_cast<float>(v);
  return static_cast<double>(f) > v ? std::nextafter(f, -kInfinity) : f;
}

float float_above(double v) {
  const auto f = static_cast<float>(v);
  return static_cast<double>(f) < v ? std::nextafter(f, kInfinity) : f;
}

/// Sum of (k - mean)^2 for k = 0 .. n - 1.
double spread(std::int64_t n) {
  const auto v = static_cast<double>(n);
  return v * (v * v - 1) / 12;
}

/// The posts of a block as a product of two axes, counted from its centre.
struct Shape {
  double n, centre_col, centre_row;
  double cols2, rows2;  ///< Sum over all posts of column^2 and of row^2.

  explicit Shape(const PostBlocks::Extent& e)
      : n(static_cast<double>(e.n_posts())),
        centre_col(static_cast<double>(e.n_cols - 1) / 2),
        centre_row(static_cast<double>(e.n_rows - 1) / 2),
        cols2(spread(e.n_cols) * static_cast<double>(e.n_rows)),
        rows2(spread(e.n_rows) * static_cast<double>(e.n_cols)) {}

  /// Height of a plane at the centre.
  double centre_of(const PostPlane& p) const { return p.at(centre_col, centre_row); }
};

/// Rounds the least-squares plane with these moments (sums of h, h * column, h * row about the centre) into a block.
void set_plane(PostBlock& block, const Shape& shape, double sum, double sum_cols, double sum_rows) {
  block.per_col_m = shape.cols2 > 0 ? static_cast<float>(sum_cols / shape.cols2) : 0;
  block.per_row_m = shape.rows2 > 0 ? static_cast<float>(sum_rows / shape.rows2) : 0;
  block.origin_m = static_cast<float>(sum / shape.n - static_cast<double>(block.per_col_m) * shape.centre_col -
                                      static_cast<double>(block.per_row_m) * shape.centre_row);
}

/// Sum of (r + d)^2 over a block's posts for a plane d.
double squares(const Shape& shape, const PostBlockSums& s, const PostPlane& d) {
  const double centre = shape.centre_of(d);
  const double cross = centre * static_cast<double>(s.residual_m) +
                       d.per_col_m * static_cast<double>(s.residual_cols_m) +
                       d.per_row_m * static_cast<double>(s.residual_rows_m);
  return s.residual2_m2 + 2 * cross + shape.n * centre * centre + shape.cols2 * d.per_col_m * d.per_col_m +
         shape.rows2 * d.per_row_m * d.per_row_m;
}

PostPlane minus(const PostPlane& a, const PostPlane& b) {
  return {a.origin_m - b.origin_m, a.per_col_m - b.per_col_m, a.per_row_m - b.per_row_m};
}

/// The heights of a level 0 block and the sums that a full row of eight gives at once.
struct LeafSums {
  double sum = 0, sum_cols = 0, sum_rows = 0;  ///< Columns and rows about the centre.
  float low = kInfinity, high = -kInfinity;
};

/// Sums over the rows of a block, column by column.
struct ColumnSums {
  std::array<double, PostBlocks::kSide> heights{}, weighted{};
  std::array<float, PostBlocks::kSide> low{}, high{};
};
struct ColumnResiduals {
  std::array<double, PostBlocks::kSide> low{}, high{}, squares{};
};

ColumnSums sums_of_columns(const float* heights, std::int64_t stride, std::int64_t n_rows, std::int64_t n_cols) {
  ColumnSums s;
  s.low.fill(kInfinity);
  s.high.fill(-kInfinity);
  const double centre_row = static_cast<double>(n_rows - 1) / 2;
  for (std::int64_t r = 0; r < n_rows; ++r) {
    const float* row = heights + r * stride;
    const double weight = static_cast<double>(r) - centre_row;
    for (std::int64_t c = 0; c < n_cols; ++c) {
      const auto k = static_cast<std::size_t>(c);
      const auto h = static_cast<double>(row[c]);
      s.heights[k] += h;
      s.weighted[k] += weight * h;
      s.low[k] = row[c] < s.low[k] ? row[c] : s.low[k];
      s.high[k] = row[c] > s.high[k] ? row[c] : s.high[k];
    }
  }
  return s;
}

/// From the plane `p`, counted from the block's south-western post.
ColumnResiduals residuals_of_columns(const float* heights, std::int64_t stride, std::int64_t n_rows,
                                     std::int64_t n_cols, const PostPlane& p) {
  ColumnResiduals s;
  s.low.fill(std::numeric_limits<double>::infinity());
  s.high.fill(-std::numeric_limits<double>::infinity());
  for (std::int64_t r = 0; r < n_rows; ++r) {
    const float* row = heights + r * stride;
    const double north = p.per_row_m * static_cast<double>(r);
    for (std::int64_t c = 0; c < n_cols; ++c) {
      const auto k = static_cast<std::size_t>(c);
      const double residual = static_cast<double>(row[c]) - (p.origin_m + p.per_col_m * static_cast<double>(c) + north);
      s.low[k] = residual < s.low[k] ? residual : s.low[k];
      s.high[k] = residual > s.high[k] ? residual : s.high[k];
      s.squares[k] += residual * residual;
    }
  }
  return s;
}

#define TIND_LOOPS "core/post_blocks_loops.inc"
#include "core/register_widths.inc"

LeafSums sums_of_leaf(const float* heights, std::int64_t stride, std::int64_t n_rows, std::int64_t n_cols) {
  const bool whole = n_cols == PostBlocks::kSide;
  const auto [by_col, weighted, low, high] = !whole    ? sums_of_columns(heights, stride, n_rows, n_cols)
                                             : kIsWide ? wide::sums_of_columns(heights, stride, n_rows)
                                                       : narrow::sums_of_columns(heights, stride, n_rows);
  LeafSums s;
  const double centre_col = static_cast<double>(n_cols - 1) / 2;
  // Columns in pairs about the centre: a level block has slopes of exactly zero.
  for (std::int64_t c = 0; 2 * c < n_cols; ++c) {
    const auto k = static_cast<std::size_t>(c), other = static_cast<std::size_t>(n_cols - 1 - c);
    s.sum += k == other ? by_col[k] : by_col[k] + by_col[other];
    s.sum_cols += (centre_col - static_cast<double>(c)) * (by_col[other] - by_col[k]);
  }
  for (std::int64_t c = 0; c < n_cols; ++c) {
    const auto k = static_cast<std::size_t>(c);
    s.sum_rows += weighted[k];
    s.low = std::min(s.low, low[k]);
    s.high = std::max(s.high, high[k]);
  }
  return s;
}

struct LeafResiduals {
  double low, high, squares;
};

LeafResiduals residuals_of_leaf(const float* heights, std::int64_t stride, std::int64_t n_rows, std::int64_t n_cols,
                                const PostPlane& p) {
  const bool whole = n_cols == PostBlocks::kSide;
  const auto [low, high, squares] = !whole    ? residuals_of_columns(heights, stride, n_rows, n_cols, p)
                                    : kIsWide ? wide::residuals_of_columns(heights, stride, n_rows, p)
                                              : narrow::residuals_of_columns(heights, stride, n_rows, p);
  LeafResiduals all{low[0], high[0], 0};
  for (std::int64_t c = 0; c < n_cols; ++c) {
    const auto k = static_cast<std::size_t>(c);
    all.low = std::min(all.low, low[k]);
    all.high = std::max(all.high, high[k]);
    all.squares += squares[k];
  }
  return all;
}

/// Which origins n_rows x n_cols posts have, and how many are of the source.
void set_origins(PostBlock& block, PostBlockSums& sums, const PostOrigin* origins, std::int64_t stride,
                 const PostBlocks::Extent& e) {
  constexpr std::uint64_t kEight = 0x0101010101010101u * static_cast<std::uint64_t>(PostOrigin::kSource);
  for (std::int64_t r = 0; r < e.n_rows; ++r) {
    const PostOrigin* row = origins + r * stride;
    std::uint64_t eight = 0;
    if (e.n_cols == sizeof eight) std::memcpy(&eight, row, sizeof eight);
    if (eight == kEight) {
      block.origins |= 1 << static_cast<int>(PostOrigin::kSource);
      sums.n_source += sizeof eight;
      continue;
    }
    for (std::int64_t c = 0; c < e.n_cols; ++c) {
      block.origins = static_cast<std::uint8_t>(block.origins | 1 << static_cast<int>(row[c]));
      sums.n_source += row[c] == PostOrigin::kSource;
    }
  }
}

}  // namespace

std::uint64_t PostBlocks::n_bytes(std::int64_t n_rows, std::int64_t n_cols) {
  std::uint64_t bytes = 0;
  for (std::int64_t side = kSide;; side *= 2) {
    const std::int64_t rows = (n_rows + side - 1) / side, cols = (n_cols + side - 1) / side;
    bytes += static_cast<std::uint64_t>(rows) * static_cast<std::uint64_t>(cols) *
             (sizeof(PostBlock) + sizeof(PostBlockSums));
    if ((rows == 1 && cols == 1) || side == kMaxSide) return bytes;
  }
}

void PostBlocks::fit_leaf(const HeightField& field, std::int64_t i, std::int64_t j) const {
  static_assert(sizeof(PostBlock) == 24 && sizeof(PostBlockSums) == 32);
  const Extent e = extent(0, i, j);
  const Shape shape(e);
  const auto [heights, origins, stride] = field.posts_from(e.row, e.col);
  PostBlock block;
  PostBlockSums sums;
  const LeafSums s = sums_of_leaf(heights, stride, e.n_rows, e.n_cols);
  set_plane(block, shape, s.sum, s.sum_cols, s.sum_rows);
  const PostPlane p = block.plane();
  const LeafResiduals all = residuals_of_leaf(heights, stride, e.n_rows, e.n_cols, p);
  const double size = std::abs(p.origin_m) + kSide * (std::abs(p.per_col_m) + std::abs(p.per_row_m)) +
                      std::max(std::abs(static_cast<double>(s.low)), std::abs(static_cast<double>(s.high)));
  block.low_m = float_below(all.low - kSlack * size);
  block.high_m = float_above(all.high + kSlack * size);
  sums.residual2_m2 = all.squares;
  sums.residual_m = static_cast<float>(s.sum - shape.n * shape.centre_of(p));
  sums.residual_cols_m = static_cast<float>(s.sum_cols - shape.cols2 * p.per_col_m);
  sums.residual_rows_m = static_cast<float>(s.sum_rows - shape.rows2 * p.per_row_m);
  sums.min_height_m = s.low;
  sums.max_height_m = s.high;
  set_origins(block, sums, origins, stride, e);
  const Level& level = at(0);
  level.blocks[i * level.n_cols + j] = block;
  level.sums[i * level.n_cols + j] = sums;
}

void PostBlocks::merge_children(int level, std::int64_t i, std::int64_t j) const {
  const Level &own = at(level), &finer = at(level - 1);
  const Extent e = extent(level, i, j);
  const Shape shape(e);
  PostBlock block;
  PostBlockSums sums;
  sums.min_height_m = kInfinity;
  sums.max_height_m = -kInfinity;
  const auto for_children = [&](auto visit) {
    for (std::int64_t ci = 2 * i; ci < std::min(2 * i + 2, finer.n_rows); ++ci) {
      for (std::int64_t cj = 2 * j; cj < std::min(2 * j + 2, finer.n_cols); ++cj) {
        const Extent child = extent(level - 1, ci, cj);
        const auto k = static_cast<std::size_t>(ci * finer.n_cols + cj);
        visit(child, Shape(child), finer.blocks[k], finer.sums[k]);
      }
    }
  };
  double sum = 0, sum_cols = 0, sum_rows = 0;
  for_children([&](const Extent& c, const Shape& s, const PostBlock& b, const PostBlockSums& bs) {
    const PostPlane q = b.plane();
    const double heights = s.n * s.centre_of(q) + static_cast<double>(bs.residual_m);
    const double east = static_cast<double>(c.col - e.col) + s.centre_col - shape.centre_col;
    const double north = static_cast<double>(c.row - e.row) + s.centre_row - shape.centre_row;
    sum += heights;
    sum_cols += heights * east + s.cols2 * q.per_col_m + static_cast<double>(bs.residual_cols_m);
    sum_rows += heights * north + s.rows2 * q.per_row_m + static_cast<double>(bs.residual_rows_m);
    sums.min_height_m = std::min(sums.min_height_m, bs.min_height_m);
    sums.max_height_m = std::max(sums.max_height_m, bs.max_height_m);
    sums.n_source += bs.n_source;
    block.origins = static_cast<std::uint8_t>(block.origins | b.origins);
  });
  set_plane(block, shape, sum, sum_cols, sum_rows);
  const PostPlane p = block.plane();
  const double size =
      std::abs(p.origin_m) + static_cast<double>(side(level)) * (std::abs(p.per_col_m) + std::abs(p.per_row_m)) +
      std::max(std::abs(static_cast<double>(sums.min_height_m)), std::abs(static_cast<double>(sums.max_height_m)));
  double low = std::numeric_limits<double>::infinity(), high = -low;
  double residual = 0, residual_cols = 0, residual_rows = 0;
  for_children([&](const Extent& c, const Shape& s, const PostBlock& b, const PostBlockSums& bs) {
    // How far the child's plane is above the parent's, counted from the child's own post.
    PostPlane from_child = p;
    from_child.origin_m = p.at(static_cast<double>(c.col - e.col), static_cast<double>(c.row - e.row));
    const PostPlane d = minus(b.plane(), from_child);
    for (const std::int64_t col : {std::int64_t{0}, c.n_cols - 1}) {
      for (const std::int64_t row : {std::int64_t{0}, c.n_rows - 1}) {
        const double above = d.at(static_cast<double>(col), static_cast<double>(row));
        low = std::min(low, above + static_cast<double>(b.low_m));
        high = std::max(high, above + static_cast<double>(b.high_m));
      }
    }
    sums.residual2_m2 += squares(s, bs, d);
    const double moved = s.n * s.centre_of(d) + static_cast<double>(bs.residual_m);
    const double east = static_cast<double>(c.col - e.col) + s.centre_col - shape.centre_col;
    const double north = static_cast<double>(c.row - e.row) + s.centre_row - shape.centre_row;
    residual += moved;
    residual_cols += moved * east + s.cols2 * d.per_col_m + static_cast<double>(bs.residual_cols_m);
    residual_rows += moved * north + s.rows2 * d.per_row_m + static_cast<double>(bs.residual_rows_m);
  });
  block.low_m = float_below(low - kSlack * size);
  block.high_m = float_above(high + kSlack * size);
  sums.residual_m = static_cast<float>(residual);
  sums.residual_cols_m = static_cast<float>(residual_cols);
  sums.residual_rows_m = static_cast<float>(residual_rows);
  own.blocks[i * own.n_cols + j] = block;
  own.sums[i * own.n_cols + j] = sums;
}

std::uint64_t PostBlocks::n_coarse_bytes() const {
  std::uint64_t bytes = 0;
  for (std::size_t k = PostBlockPage::kLevels; k < levels_.size(); ++k) {
    bytes +=
        static_cast<std::uint64_t>(levels_[k].n_rows * levels_[k].n_cols) * (sizeof(PostBlock) + sizeof(PostBlockSums));
  }
  return bytes;
}

PostBlocks PostBlocks::in_pages(const PostBlockPages& pages, std::span<std::byte> memory) const {
  assert(memory.size() >= n_coarse_bytes());
  PostBlocks result = *this;
  result.pages_ = &pages;
  std::byte* next = memory.data();
  for (std::size_t k = 0; k < levels_.size(); ++k) {
    const Level& from = levels_[k];
    Level& to = result.levels_[k];
    to.blocks = nullptr;
    to.sums = nullptr;
    if (k < PostBlockPage::kLevels) continue;
    const auto n = static_cast<std::size_t>(from.n_rows * from.n_cols);
    to.blocks = reinterpret_cast<PostBlock*>(next);
    next += n * sizeof(PostBlock);
    to.sums = reinterpret_cast<PostBlockSums*>(next);
    next += n * sizeof(PostBlockSums);
    std::copy_n(from.blocks, n, to.blocks);
    std::copy_n(from.sums, n, to.sums);
  }
  return result;
}

PostBlocks PostBlocks::lay_out(const HeightField& field, std::span<std::byte> memory) {
  assert(memory.size() >= n_bytes(field.n_rows, field.n_cols));
  PostBlocks result;
  result.n_rows_ = field.n_rows;
  result.n_cols_ = field.n_cols;
  std::byte* next = memory.data();
  for (std::int64_t s = kSide;; s *= 2) {
    Level level;
    level.n_rows = (field.n_rows + s - 1) / s;
    level.n_cols = (field.n_cols + s - 1) / s;
    const auto n = static_cast<std::size_t>(level.n_rows * level.n_cols);
    level.blocks = reinterpret_cast<PostBlock*>(next);
    next += n * sizeof(PostBlock);
    level.sums = reinterpret_cast<PostBlockSums*>(next);
    next += n * sizeof(PostBlockSums);
    result.levels_.push_back(level);
    if (n == 1 || s == kMaxSide) return result;
  }
}

PostBlocks PostBlocks::build(const HeightField& field, std::span<std::byte> memory, int threads,
                             const std::atomic<bool>* cancel,
                             const std::function<void(const void*, std::size_t)>& done) {
  assert(threads >= 1);
  PostBlocks result = lay_out(field, memory);
  for (int level = 0; level < result.n_levels(); ++level) {
    const Level& own = result.at(level);
    for_each_job({threads, cancel, {}}, own.n_rows, [&](int, std::int64_t i) {
      for (std::int64_t j = 0; j < own.n_cols; ++j) {
        if (level == 0) {
          result.fit_leaf(field, i, j);
        } else {
          result.merge_children(level, i, j);
        }
      }
      if (!done) return;
      const auto row = [&](int of, std::int64_t first, std::int64_t n_rows) {
        const Level& l = result.at(of);
        const auto n = static_cast<std::size_t>(n_rows * l.n_cols);
        done(l.blocks + first * l.n_cols, n * sizeof(PostBlock));
        done(l.sums + first * l.n_cols, n * sizeof(PostBlockSums));
      };
      row(level, i, 1);
      if (level > 0) {
        row(level - 1, 2 * i, std::min<std::int64_t>(2, result.at(level - 1).n_rows - 2 * i));
        return;
      }
      const std::int64_t first = i * kSide, n_rows = std::min(kSide, field.n_rows - first);
      const auto n = static_cast<std::size_t>(n_rows * field.n_cols);
      done(field.heights_m + first * field.n_cols, n * sizeof(float));
      done(field.origins + first * field.n_cols, n * sizeof(PostOrigin));
    });
  }
  return result;
}

double PostBlocks::squared_distance_m2(int level, std::int64_t i, std::int64_t j, const PostPlane& p) const {
  // Not below zero by a rounding.
  return std::max(0.0, squares(Shape(extent(level, i, j)), sums(level, i, j), minus(block(level, i, j).plane(), p)));
}

}  // namespace tind
