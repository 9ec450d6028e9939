// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <cassert>
#include <cstdint>
#include <utility>
#include <vector>

#include "core/drainage/flow_run.hpp"

namespace tind {

/// A place in or beside a block: (row - row_begin + 1) << 16 | (column - col_begin + 1), so the ring of posts around
/// the block has one, too.
using BlockPlace = std::uint32_t;

/// Square blocks of a grid that are visited, each once and then again for as long as other blocks hand posts over: a
/// few rows of blocks until they have nothing left, then the next ones, north and south in turn, so that what is looked
/// at again is still in memory. A step that works this way must have one answer whatever the order of visits. Blocks
/// that touch are never visited at the same time, so a visit may change its posts and those of the ring around them.
class BlockSchedule {
 public:
  struct Visit {
    std::int64_t row_begin = 0, row_end = 0, col_begin = 0, col_end = 0;
    bool first = false;              ///< The block's first visit.
    std::vector<BlockPlace> places;  ///< Handed over since the last visit; may repeat.

    /// Which of the schedule's blocks this is, below n_blocks().
    std::size_t block() const { return static_cast<std::size_t>(block_); }
    bool contains(std::int64_t row, std::int64_t col) const {
      return row >= row_begin && row < row_end && col >= col_begin && col < col_end;
    }
    bool contains(BlockPlace at) const {
      const std::int64_t r = at >> 16, c = at & 0xffff;
      return r >= 1 && r <= row_end - row_begin && c >= 1 && c <= col_end - col_begin;
    }
    BlockPlace place(std::int64_t row, std::int64_t col) const {
      return static_cast<BlockPlace>((row - row_begin + 1) << 16 | (col - col_begin + 1));
    }
    std::int64_t row(BlockPlace at) const { return row_begin + (at >> 16) - 1; }
    std::int64_t col(BlockPlace at) const { return col_begin + (at & 0xffff) - 1; }

    /// Hands a post of another block over to it.
    void hand_over(std::int64_t row, std::int64_t col) { handed_.emplace_back(row, col); }

   private:
    friend class BlockSchedule;
    std::int64_t block_ = 0;
    std::vector<std::pair<std::int64_t, std::int64_t>> handed_;
  };

  /// `wraps`: the last column lies beside the first. 1 <= side <= 32768; a last block is up to half as long again.
  BlockSchedule(std::int64_t n_rows, std::int64_t n_cols, bool wraps, std::int64_t side)
      : n_rows_(n_rows), n_cols_(n_cols), side_(side), rows_(count(n_rows, side)), cols_(count(n_cols, side)) {
    assert(side >= 1 && side <= 32768);
    blocks_.resize(static_cast<std::size_t>(rows_ * cols_));
    // Blocks of one colour do not touch, nor do the rings around them.
    const bool odd_ring = wraps && cols_ % 2 == 1;
    n_colours_ = odd_ring ? 6 : 4;
    n_queued_ = rows_ * cols_;
    for (std::int64_t b = 0; b < rows_ * cols_; ++b) {
      const std::int64_t col = b % cols_, across = odd_ring && col == cols_ - 1 ? 2 : col % 2;
      blocks_[static_cast<std::size_t>(b)].colour = static_cast<std::uint8_t>(2 * across + b / cols_ % 2);
    }
  }

  std::int64_t n_blocks() const { return rows_ * cols_; }

  /// Calls visit(worker, Visit&) until no block has anything left; worker < max(1, run.threads). `settled()` is called
  /// between visits, on the calling thread. False iff the run was stopped.
  template <class F, class G>
  bool run(const FlowRun& run, F&& visit, G&& settled) {
    FlowRun rings_apart = run;
    if (side_ < 2) rings_apart.threads = 1;
    rings_apart.progress = nullptr;
    // Rows of blocks that are settled together: enough to keep the threads busy with a colour.
    const std::int64_t window = std::max<std::int64_t>(2, 16 * rings_apart.threads / cols_);
    const std::int64_t n_windows = (rows_ + window - 1) / window;
    for (bool north = true; n_queued_ > 0; north = !north) {
      for (std::int64_t k = 0; k < n_windows; ++k) {
        const std::int64_t first = (north ? k : n_windows - 1 - k) * window * cols_;
        const std::int64_t end = std::min(first + window * cols_, rows_ * cols_);
        for (bool any = true; any;) {
          any = false;
          for (std::uint8_t colour = 0; colour < n_colours_; ++colour) {
            const std::vector<std::int64_t> now = queued(first, end, colour);
            any = any || !now.empty();
            if (!visit_all(rings_apart, now, visit, settled)) return false;
          }
        }
      }
    }
    return true;
  }

 private:
  struct Block {
    std::vector<BlockPlace> places;
    std::uint8_t colour = 0;
    bool queued = true;
    bool visited = false;
  };

  // A short rest makes no block of its own, so that two blocks have one of two posts or more between them.
  static std::int64_t count(std::int64_t n, std::int64_t side) {
    const std::int64_t whole = n / side, rest = n % side;
    return std::max<std::int64_t>(1, whole + (rest >= std::max<std::int64_t>(2, side / 2) ? 1 : 0));
  }

  // Blocks of a colour among [first, end) that are to be visited.
  std::vector<std::int64_t> queued(std::int64_t first, std::int64_t end, std::uint8_t colour) const {
    std::vector<std::int64_t> found;
    for (std::int64_t b = first; b < end; ++b) {
      const Block& block = blocks_[static_cast<std::size_t>(b)];
      if (block.queued && block.colour == colour) found.push_back(b);
    }
    return found;
  }

  // Visits blocks of one colour, as many at a time as keep the threads busy: more would hold all their posts.
  template <class F, class G>
  bool visit_all(const FlowRun& run, const std::vector<std::int64_t>& blocks, F&& visit, G&& settled) {
    const std::size_t batch = static_cast<std::size_t>(run.threads) * 4;
    for (std::size_t begin = 0; begin < blocks.size(); begin += batch) {
      std::vector<Visit> visits;
      for (std::size_t k = begin; k < std::min(blocks.size(), begin + batch); ++k) visits.push_back(start(blocks[k]));
      for_each_job(run, static_cast<std::int64_t>(visits.size()),
                   [&](int worker, std::int64_t k) { visit(worker, visits[static_cast<std::size_t>(k)]); });
      if (run.stopped()) return false;
      for (Visit& v : visits) finish(v);
      settled();
    }
    return true;
  }

  Visit start(std::int64_t b) {
    Block& block = blocks_[static_cast<std::size_t>(b)];
    const std::int64_t row = b / cols_, col = b % cols_;
    Visit v;
    v.block_ = b;
    v.row_begin = row * side_;
    v.row_end = row + 1 == rows_ ? n_rows_ : v.row_begin + side_;
    v.col_begin = col * side_;
    v.col_end = col + 1 == cols_ ? n_cols_ : v.col_begin + side_;
    v.first = !block.visited;
    v.places.swap(block.places);
    block.visited = true;
    block.queued = false;
    --n_queued_;
    return v;
  }

  void finish(const Visit& v) {
    for (const auto& [row, col] : v.handed_) {
      const std::int64_t r = std::min(row / side_, rows_ - 1), c = std::min(col / side_, cols_ - 1);
      const std::int64_t b = r * cols_ + c;
      Block& block = blocks_[static_cast<std::size_t>(b)];
      block.places.push_back(static_cast<BlockPlace>((row - r * side_ + 1) << 16 | (col - c * side_ + 1)));
      if (!block.queued) {
        block.queued = true;
        ++n_queued_;
      }
    }
  }

  std::int64_t n_rows_, n_cols_, side_, rows_, cols_;
  std::vector<Block> blocks_;
  std::uint8_t n_colours_ = 4;
  std::int64_t n_queued_ = 0;
};

}  // namespace tind
