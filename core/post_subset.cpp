// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/post_subset.hpp"

#include <cmath>

namespace tind {

void PostSubset::arrange() {
  first_.clear();
  if (posts_.empty()) return;
  Post low = posts_[0], high = posts_[0];
  for (const Post& p : posts_) {
    low = {std::min(low.row, p.row), std::min(low.col, p.col), 0};
    high = {std::max(high.row, p.row), std::max(high.col, p.col), 0};
  }
  all_ = {low.row, low.col, std::int64_t{high.row} - low.row + 1, std::int64_t{high.col} - low.col + 1};
  // About one post a bucket, wherever the posts are; sides are powers of two.
  const double n = static_cast<double>(posts_.size());
  const double rows = static_cast<double>(all_.n_rows), cols = static_cast<double>(all_.n_cols);
  const double side = std::max(std::sqrt(rows * cols / n), std::max(rows, cols) / n);
  bucket_bits_ = std::max(0, static_cast<int>(std::lround(std::log2(side))));
  n_bucket_rows_ = ((all_.n_rows - 1) >> bucket_bits_) + 1;
  n_bucket_cols_ = ((all_.n_cols - 1) >> bucket_bits_) + 1;
  const auto bucket_of = [this](const Post& p) {
    return static_cast<std::size_t>(bucket_row(p.row) * n_bucket_cols_ + bucket_col(p.col));
  };
  first_.assign(static_cast<std::size_t>(n_bucket_rows_ * n_bucket_cols_) + 1, 0);
  for (const Post& p : posts_) ++first_[bucket_of(p) + 1];
  for (std::size_t k = 1; k < first_.size(); ++k) first_[k] += first_[k - 1];
  next_.assign(first_.begin(), first_.end() - 1);
  unsorted_.swap(posts_);
  posts_.resize(unsorted_.size());
  for (const Post& p : unsorted_) posts_[next_[bucket_of(p)]++] = p;
}

const PostSubset::Post* PostSubset::find(std::int64_t row, std::int64_t col) const {
  if (!meets_posts({row, col, 1, 1})) return nullptr;
  const auto bucket = static_cast<std::size_t>(bucket_row(row) * n_bucket_cols_ + bucket_col(col));
  for (std::uint32_t k = first_[bucket]; k < first_[bucket + 1]; ++k) {
    if (posts_[k].row == row && posts_[k].col == col) return &posts_[k];
  }
  return nullptr;
}

}  // namespace tind
