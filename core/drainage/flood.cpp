// SPDX-License-Identifier: GPL-3.0-or-later
#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "core/drainage/block_schedule.hpp"
#include "core/drainage/flow.hpp"

namespace tind {
namespace {

/// Posts of a block that wait for their turn, by roughly ascending level: in buckets of like level. The flood has one
/// answer whatever the order; an order that is nearly right saves visiting posts again.
class LevelQueue {
 public:
  struct Entry {
    BlockPlace at = 0;
    float level = 0;
  };

  /// Empties the queue. Levels to come are expected in [low, high]; what lies beyond waits with the first or last.
  void start(float low, float high) {
    low_ = low;
    per_metre_ = high > low ? static_cast<float>(kBuckets - 1) / (high - low) : 0;
    first_.fill(kEnd);
    entries_.clear();
    free_ = kEnd;
    now_ = 0;
  }
  void push(BlockPlace at, float level) {
    const float bucket = (level - low_) * per_metre_;
    const std::size_t k = !(bucket > 0) ? 0 : bucket < kBuckets - 1 ? static_cast<std::size_t>(bucket) : kBuckets - 1;
    std::uint32_t slot = free_;
    if (slot == kEnd) {
      slot = static_cast<std::uint32_t>(entries_.size());
      entries_.push_back({{at, level}, first_[k]});
    } else {
      free_ = entries_[slot].next;
      entries_[slot] = {{at, level}, first_[k]};
    }
    first_[k] = slot;
    now_ = std::min(now_, k);
  }
  /// Takes the next one; false when there is none.
  bool pop(Entry& entry) {
    while (now_ < kBuckets && first_[now_] == kEnd) ++now_;
    if (now_ == kBuckets) return false;
    const std::uint32_t slot = first_[now_];
    entry = entries_[slot].entry;
    first_[now_] = entries_[slot].next;
    entries_[slot].next = free_;
    free_ = slot;
    return true;
  }

 private:
  static constexpr std::size_t kBuckets = 2048;
  static constexpr std::uint32_t kEnd = std::numeric_limits<std::uint32_t>::max();
  struct Slot {
    Entry entry;
    std::uint32_t next = kEnd;
  };
  float low_ = 0, per_metre_ = 0;
  std::array<std::uint32_t, kBuckets> first_{};
  std::vector<Slot> entries_;
  std::uint32_t free_ = kEnd;
  std::size_t now_ = 0;
};

/// Priority-Flood in one block at a time. A post reached from one that is not above it has its own height: that is
/// final, needs no priority (Zhou, Sun, Fu 2016, doi:10.1016/j.cageo.2016.02.021) and makes up nearly all posts. The
/// others start at the height of whoever reached them and are lowered when a lower way is found, in this block or from
/// another.
class FloodWorker {
 public:
  using Range = std::pair<float, float>;

  /// `ranges`: one for each block, kept by the caller from its first visit on, shared by all workers.
  FloodWorker(const FlowGrid& grid, float* filled_m, std::span<Range> ranges)
      : g_(grid), filled_(filled_m), ranges_(ranges) {
    for (std::size_t k = 0; k < 8; ++k) {
      index_step_[k] = kStepRows[k] * g_.n_cols + kStepCols[k];
      place_step_[k] = static_cast<BlockPlace>(kStepRows[k] * 65536 + kStepCols[k]);
    }
  }

  /// Returns how many posts the water reached for the first time.
  std::int64_t flood(BlockSchedule::Visit& visit) {
    visit_ = &visit;
    n_reached_ = 0;
    Range& range = ranges_[visit.block()];
    if (visit.first) range = range_of_block();  // later visits need not see the whole block
    queue_.start(range.first, range.second);
    if (visit.first) seed();
    for (const BlockPlace at : visit.places) push(at);
    LevelQueue::Entry next;
    while (queue_.pop(next)) {
      if (filled_[index(next.at)] != next.level) continue;  // lowered since: it comes again
      expand<true>(next.at);
      while (!level_.empty() || !slope_.empty()) {
        if (!level_.empty()) {
          expand<true>(pop(level_));
        } else {
          const BlockPlace q = pop(slope_);
          if (expand<false>(q)) push(q);
        }
      }
    }
    return n_reached_;
  }

 private:
  static BlockPlace pop(std::vector<BlockPlace>& stack) {
    const BlockPlace at = stack.back();
    stack.pop_back();
    return at;
  }

  std::int64_t index(BlockPlace at) const { return visit_->row(at) * g_.n_cols + visit_->col(at); }
  void push(BlockPlace at) { queue_.push(at, filled_[index(at)]); }

  /// Lowest and highest post of the block.
  Range range_of_block() const {
    float low = std::numeric_limits<float>::infinity(), high = -low;
    for (std::int64_t r = visit_->row_begin; r < visit_->row_end; ++r) {
      for (std::int64_t i = r * g_.n_cols + visit_->col_begin; i < r * g_.n_cols + visit_->col_end; ++i) {
        const bool inside = g_.marks[i] & kInside;
        low = inside && g_.heights_m[i] < low ? g_.heights_m[i] : low;
        high = inside && g_.heights_m[i] > high ? g_.heights_m[i] : high;
      }
    }
    return {low, high};
  }

  void seed() {
    for (std::int64_t r = visit_->row_begin; r < visit_->row_end; ++r) {
      const std::int64_t row = r * g_.n_cols, end = row + visit_->col_end;
      for (std::int64_t i = next_marked(g_.marks, row + visit_->col_begin, end, kOutlet); i < end;
           i = next_marked(g_.marks, i + 1, end, kOutlet)) {
        bool inland = false;  // the open sea has nothing to flood
        for (int d = 0; d < 8 && !inland; ++d) {
          const std::int64_t n = g_.neighbour(r, i - row, d);
          inland = n >= 0 && (g_.marks[n] & (kInside | kOutlet)) == kInside;
        }
        if (inland) push(visit_->place(r, i - row));
      }
    }
  }

  /// Carries the water level of a post on to its neighbours. Without kDownward only to those that are not below it:
  /// then true iff there are others which it would lower.
  template <bool kDownward>
  bool expand(BlockPlace at) {
    const std::int64_t r = visit_->row(at), c = visit_->col(at), i = r * g_.n_cols + c;
    const float level = filled_[i];
    bool left = false;
    const bool inner = r > 0 && r + 1 < g_.n_rows && c > 0 && c + 1 < g_.n_cols;
    // Which neighbours it lowers is found without a branch each: few are, and none can tell which.
    std::uint32_t lowered = 0;
    if (inner) {
      const float *const heights = g_.heights_m + i, *const filled = filled_ + i;
      for (std::size_t k = 0; k < 8; ++k) {
        const bool lower = std::max(heights[index_step_[k]], level) < filled[index_step_[k]];
        lowered |= static_cast<std::uint32_t>(lower) << k;
      }
    } else {
      for (std::size_t k = 0; k < 8; ++k) {
        const std::int64_t n = g_.neighbour(r, c, static_cast<int>(k));
        const bool lower = n >= 0 && std::max(g_.heights_m[n], level) < filled_[n];
        lowered |= static_cast<std::uint32_t>(lower) << k;
      }
    }
    for (; lowered != 0; lowered &= lowered - 1) {
      const auto k = static_cast<std::size_t>(std::countr_zero(lowered));
      const std::int64_t n = inner ? i + index_step_[k] : g_.neighbour(r, c, static_cast<int>(k));
      const float own = g_.heights_m[n];
      const bool below = own < level;
      if (!kDownward && below) {
        left = true;
        continue;
      }
      if (filled_[n] == std::numeric_limits<float>::infinity()) ++n_reached_;
      filled_[n] = below ? level : own;
      BlockPlace q = at + place_step_[k];
      if (!inner || !visit_->contains(q)) {
        const std::int64_t row = r + kStepRows[k], col = n - row * g_.n_cols;
        if (!visit_->contains(row, col)) {
          visit_->hand_over(row, col);
          continue;
        }
        q = visit_->place(row, col);
      }
      (below ? level_ : slope_).push_back(q);
    }
    return left;
  }

  const FlowGrid& g_;
  float* filled_;
  std::span<Range> ranges_;
  std::array<std::int64_t, 8> index_step_{};
  std::array<BlockPlace, 8> place_step_{};
  BlockSchedule::Visit* visit_ = nullptr;
  LevelQueue queue_;
  std::vector<BlockPlace> level_, slope_;  // in no order that matters
  std::int64_t n_reached_ = 0;
};

}  // namespace

void fill_depressions(const FlowGrid& g, std::int64_t block_side, float* filled_m, const FlowRun& run) {
  std::atomic<std::int64_t> n_dry{0}, n_reached{0};
  for_row_bands(run.quiet(), g.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
    std::int64_t n = 0;
    for (std::int64_t i = row_begin * g.n_cols; i < row_end * g.n_cols; ++i) {
      const std::uint8_t mark = g.marks[i];
      const bool dry = (mark & (kInside | kOutlet)) == kInside;
      const float beside = mark & kInside ? g.heights_m[i] : -std::numeric_limits<float>::infinity();
      filled_m[i] = dry ? std::numeric_limits<float>::infinity() : beside;
      n += dry ? 1 : 0;
    }
    n_dry += n;
  });
  BlockSchedule schedule(g.n_rows, g.n_cols, g.wraps, block_side);
  std::vector<FloodWorker::Range> ranges(static_cast<std::size_t>(schedule.n_blocks()));
  std::vector<FloodWorker> workers(static_cast<std::size_t>(std::max(1, run.threads)),
                                   FloodWorker(g, filled_m, ranges));
  schedule.run(
      run,
      [&](int worker, BlockSchedule::Visit& visit) {
        n_reached += workers[static_cast<std::size_t>(worker)].flood(visit);
      },
      [&] { run.report(n_reached, n_dry); });
}

}  // namespace tind
