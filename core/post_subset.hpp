// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/post_blocks.hpp"
#include "core/triangle_rows.hpp"

namespace tind {

/// Some posts of a window of the grid: boxes, and single ones with their heights, found by where they lie. Storage is
/// kept from one window to the next. Const access is thread safe.
class PostSubset {
 public:
  struct Post {
    std::int32_t row = 0, col = 0;
    float height_m = 0;
    std::uint32_t vertex = 0;  ///< A number of the caller's.
  };

  void clear() {
    boxes_.clear();
    posts_.clear();
    first_.clear();
  }
  void add_box(const PostBlocks::Extent& box) { boxes_.push_back(box); }
  void add_post(const Post& post) { posts_.push_back(post); }
  /// To be called once all are added.
  void arrange();

  const std::vector<PostBlocks::Extent>& boxes() const { return boxes_; }

  /// Calls box(extent) and single(post) for parts of boxes and for posts that are between them the subset's in `part`;
  /// of single ones those beyond the columns that columns_of(first_row, last_row) gives, a pair of numbers, may be left
  /// out.
  template <class Columns, class Box, class Single>
  void visit(const PostBlocks::Extent& part, Columns columns_of, Box box, Single single) const;
  /// The single post at a place; null: there is none.
  const Post* find(std::int64_t row, std::int64_t col) const;

 private:
  bool meets_posts(const PostBlocks::Extent& part) const {
    return !first_.empty() && part.n_rows > 0 && part.n_cols > 0 && part.row + part.n_rows > all_.row &&
           part.col + part.n_cols > all_.col && part.row < all_.row + all_.n_rows && part.col < all_.col + all_.n_cols;
  }
  std::int64_t bucket_row(std::int64_t row) const {
    return std::clamp<std::int64_t>((row - all_.row) >> bucket_bits_, 0, n_bucket_rows_ - 1);
  }
  std::int64_t bucket_col(std::int64_t col) const {
    return std::clamp<std::int64_t>((col - all_.col) >> bucket_bits_, 0, n_bucket_cols_ - 1);
  }

  std::vector<PostBlocks::Extent> boxes_;
  std::vector<Post> posts_, unsorted_;  // by buckets, which are a regular grid over `all_`
  PostBlocks::Extent all_;
  int bucket_bits_ = 0;  // of a bucket's side
  std::int64_t n_bucket_rows_ = 0, n_bucket_cols_ = 0;
  std::vector<std::uint32_t> first_, next_;  // per bucket, and the end
};

template <class Columns, class Box, class Single>
void PostSubset::visit(const PostBlocks::Extent& part, Columns columns_of, Box box, Single single) const {
  const std::int64_t row_end = part.row + part.n_rows, col_end = part.col + part.n_cols;
  for (const PostBlocks::Extent& b : boxes_) {
    const std::int64_t row = std::max(part.row, b.row), n_rows = std::min(row_end, b.row + b.n_rows) - row;
    const std::int64_t col = std::max(part.col, b.col), n_cols = std::min(col_end, b.col + b.n_cols) - col;
    if (n_rows > 0 && n_cols > 0) box(PostBlocks::Extent{row, col, n_rows, n_cols});
  }
  if (!meets_posts(part)) return;
  const std::int64_t i_last = bucket_row(row_end - 1);
  for (std::int64_t i = bucket_row(part.row); i <= i_last; ++i) {
    // The buckets of a row lie together.
    const std::int64_t first_row = all_.row + (i << bucket_bits_), n_rows = std::int64_t{1} << bucket_bits_;
    const auto [west, east] = columns_of(static_cast<double>(first_row), static_cast<double>(first_row + n_rows - 1));
    if (west > east + 2) continue;
    // A post more to either side, for rounding.
    const std::int64_t j_first = bucket_col(std::max(part.col, floor_of(west) - 1));
    const std::int64_t j_last = bucket_col(std::min(col_end - 1, ceil_of(east) + 1));
    const auto begin = static_cast<std::size_t>(i * n_bucket_cols_ + j_first);
    const auto end = static_cast<std::size_t>(i * n_bucket_cols_ + j_last) + 1;
    for (std::uint32_t k = first_[begin]; begin < end && k < first_[end]; ++k) {
      const Post& p = posts_[k];
      if (p.row >= part.row && p.row < row_end && p.col >= part.col && p.col < col_end) single(p);
    }
  }
}

}  // namespace tind
