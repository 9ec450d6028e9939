// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <cassert>
#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

namespace tind {

/// Square blocks of a grid that are visited, each once and then again for as long as other blocks hand posts over.
/// A step that works this way must have one answer whatever the order of visits.
class BlockSchedule {
 public:
  struct Visit {
    std::int64_t row_begin = 0, row_end = 0, col_begin = 0, col_end = 0;
    bool first = false;               ///< The block's first visit.
    std::vector<std::int64_t> posts;  ///< Indices handed over since the last visit; may repeat.

    bool contains(std::int64_t row, std::int64_t col) const {
      return row >= row_begin && row < row_end && col >= col_begin && col < col_end;
    }
  };

  BlockSchedule(std::int64_t n_rows, std::int64_t n_cols, std::int64_t side)
      : n_rows_(n_rows), n_cols_(n_cols), side_(side), blocks_per_row_((n_cols + side - 1) / side) {
    assert(side >= 1 && side <= 32768);
    const std::int64_t n = blocks_per_row_ * ((n_rows + side - 1) / side);
    blocks_.resize(static_cast<std::size_t>(n));
    for (std::int64_t b = 0; b < n; ++b) queue_.push_back(b);
  }

  /// Hands a post over to its block.
  void hand_over(std::int64_t row, std::int64_t col) {
    const std::int64_t b = row / side_ * blocks_per_row_ + col / side_;
    Block& block = blocks_[static_cast<std::size_t>(b)];
    block.posts.push_back(row * n_cols_ + col);
    if (!block.queued) {
      block.queued = true;
      queue_.push_back(b);
    }
  }

  std::optional<Visit> next() {
    if (queue_.empty()) return std::nullopt;
    const std::int64_t b = queue_.front();
    queue_.pop_front();
    Block& block = blocks_[static_cast<std::size_t>(b)];
    Visit visit;
    visit.row_begin = b / blocks_per_row_ * side_;
    visit.row_end = std::min(n_rows_, visit.row_begin + side_);
    visit.col_begin = b % blocks_per_row_ * side_;
    visit.col_end = std::min(n_cols_, visit.col_begin + side_);
    visit.first = !block.visited;
    visit.posts.swap(block.posts);
    block.visited = true;
    block.queued = false;
    return visit;
  }

 private:
  struct Block {
    std::vector<std::int64_t> posts;
    bool queued = true;
    bool visited = false;
  };
  std::int64_t n_rows_, n_cols_, side_, blocks_per_row_;
  std::vector<Block> blocks_;
  std::deque<std::int64_t> queue_;
};

}  // namespace tind
