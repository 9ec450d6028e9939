// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/drainage/flow.hpp"

#include <bit>
#include <cassert>
#include <cmath>
#include <functional>
#include <limits>
#include <queue>

#include "core/drainage/block_schedule.hpp"

namespace tind {
namespace {

constexpr std::uint32_t kFar = std::numeric_limits<std::uint32_t>::max();

/// Row and column of a post in its block, in one word: blocks are at most 2^15 posts a side.
std::uint32_t pack(const BlockSchedule::Visit& v, std::int64_t r, std::int64_t c) {
  return static_cast<std::uint32_t>((r - v.row_begin) << 16 | (c - v.col_begin));
}

struct Post {
  std::int64_t row = 0, col = 0;
};

Post unpack(const BlockSchedule::Visit& v, std::uint32_t at) {
  return {v.row_begin + (at >> 16), v.col_begin + (at & 0xffff)};
}

/// Calls f(index, direction) for the neighbours of (r, c) on the grid.
template <class F>
void for_neighbours(const FlowGrid& g, std::int64_t r, std::int64_t c, F&& f) {
  const std::int64_t i = r * g.n_cols + c;
  if (r > 0 && r + 1 < g.n_rows && c > 0 && c + 1 < g.n_cols) {
    for (int d = 0; d < 8; ++d) {
      const auto k = static_cast<std::size_t>(d);
      f(i + kStepRows[k] * g.n_cols + kStepCols[k], d);
    }
    return;
  }
  for (int d = 0; d < 8; ++d) {
    const std::int64_t n = g.neighbour(r, c, d);
    if (n >= 0) f(n, d);
  }
}

/// A queue of posts of a block; memory is kept between visits.
class PostQueue {
 public:
  bool empty() const { return head_ == posts_.size(); }
  void push(std::uint32_t at) { posts_.push_back(at); }
  std::uint32_t pop() {
    const std::uint32_t at = posts_[head_++];
    if (empty()) {
      posts_.clear();
      head_ = 0;
    }
    return at;
  }

 private:
  std::vector<std::uint32_t> posts_;
  std::size_t head_ = 0;
};

/// Orders (height, post) as one integer: the float's bits made monotone, then the post.
std::uint64_t heap_key(float height, std::uint32_t at) {
  const auto bits = std::bit_cast<std::uint32_t>(height);
  const std::uint32_t ordered = bits & 0x80000000u ? ~bits : bits | 0x80000000u;
  return std::uint64_t{ordered} << 32 | at;
}

/// Priority-Flood by blocks. A post reached from one that is not above it has its own height: that is final, needs no
/// priority (Zhou, Sun, Fu 2016, doi:10.1016/j.cageo.2016.02.021) and makes up nearly all posts. The others start
/// at the height of whoever reached them and are lowered when a lower way is found, in this block or from another.
class Flood {
 public:
  Flood(const FlowGrid& grid, std::int64_t block_side, float* filled_m)
      : g_(grid), schedule_(grid.n_rows, grid.n_cols, block_side), filled_(filled_m) {}

  void run() {
    for (std::int64_t i = 0; i < g_.size(); ++i) {
      const std::uint8_t mark = g_.marks[i];
      filled_[i] = !(mark & kInside) ? -std::numeric_limits<float>::infinity()
                   : mark & kOutlet  ? g_.heights_m[i]
                                     : std::numeric_limits<float>::infinity();
    }
    while (auto visit = schedule_.next()) {
      visit_ = std::move(*visit);
      if (visit_.first) seed();
      for (const std::int64_t i : visit_.posts) push_heap(i / g_.n_cols, i % g_.n_cols);
      drain();
    }
  }

 private:
  void push_heap(std::int64_t r, std::int64_t c) {
    heap_.push(heap_key(filled_[r * g_.n_cols + c], pack(visit_, r, c)));
  }

  void seed() {
    for (std::int64_t r = visit_.row_begin; r < visit_.row_end; ++r) {
      for (std::int64_t c = visit_.col_begin; c < visit_.col_end; ++c) {
        if (!(g_.marks[r * g_.n_cols + c] & kOutlet)) continue;
        bool inland = false;  // the open sea has nothing to flood
        for_neighbours(g_, r, c,
                       [&](std::int64_t n, int) { inland = inland || (g_.marks[n] & (kInside | kOutlet)) == kInside; });
        if (inland) push_heap(r, c);
      }
    }
  }

  void drain() {
    while (!heap_.empty()) {
      const std::uint64_t top = heap_.top();
      heap_.pop();
      const auto at = static_cast<std::uint32_t>(top);
      const Post p = unpack(visit_, at);
      if (heap_key(filled_[p.row * g_.n_cols + p.col], at) != top) continue;  // lowered since: it comes again
      expand(p, true);
      while (!level_.empty() || !slope_.empty()) {
        if (!level_.empty()) {
          expand(unpack(visit_, level_.pop()), true);
        } else {
          const Post q = unpack(visit_, slope_.pop());
          if (expand(q, false)) push_heap(q.row, q.col);
        }
      }
    }
  }

  /// Carries the water level of p on to its neighbours. Without `downward` only to those that are not below it: then
  /// true iff there are others which it would lower.
  bool expand(Post p, bool downward) {
    const float level = filled_[p.row * g_.n_cols + p.col];
    bool left = false;
    for_neighbours(g_, p.row, p.col, [&](std::int64_t n, int d) {
      const float own = g_.heights_m[n];
      if (!(filled_[n] > level)) return;
      const bool below = own < level;
      if (below && !downward) {
        left = true;
        return;
      }
      const float filled = below ? level : own;
      if (!(filled < filled_[n])) return;
      filled_[n] = filled;
      const Post q{p.row + kStepRows[static_cast<std::size_t>(d)], n % g_.n_cols};
      if (!visit_.contains(q.row, q.col)) {
        schedule_.hand_over(q.row, q.col);
      } else {
        (below ? level_ : slope_).push(pack(visit_, q.row, q.col));
      }
    });
    return left;
  }

  const FlowGrid& g_;
  BlockSchedule schedule_;
  BlockSchedule::Visit visit_;
  float* filled_;
  std::priority_queue<std::uint64_t, std::vector<std::uint64_t>, std::greater<>> heap_;
  PostQueue level_, slope_;
};

/// Steps from the seeds of a flat to every post of it, by blocks. `member`: FlatSteps member to fill.
void spread(const FlowGrid& g, std::int64_t block_side, const float* filled_m, std::uint32_t FlatSteps::*member,
            FlatSteps* steps) {
  BlockSchedule schedule(g.n_rows, g.n_cols, block_side);
  PostQueue queue;
  while (auto visit = schedule.next()) {
    if (visit->first) {
      for (std::int64_t r = visit->row_begin; r < visit->row_end; ++r) {
        for (std::int64_t c = visit->col_begin; c < visit->col_end; ++c) {
          const std::int64_t i = r * g.n_cols + c;
          if ((g.marks[i] & kInFlat) && steps[i].*member == 1) queue.push(pack(*visit, r, c));
        }
      }
    }
    for (const std::int64_t i : visit->posts) queue.push(pack(*visit, i / g.n_cols, i % g.n_cols));
    while (!queue.empty()) {
      const Post p = unpack(*visit, queue.pop());
      const std::int64_t i = p.row * g.n_cols + p.col;
      const std::uint32_t next = steps[i].*member + 1;
      for_neighbours(g, p.row, p.col, [&](std::int64_t n, int d) {
        if (!(g.marks[n] & kInFlat) || filled_m[n] != filled_m[i] || steps[n].*member <= next) return;
        steps[n].*member = next;
        const Post q{p.row + kStepRows[static_cast<std::size_t>(d)], n % g.n_cols};
        if (visit->contains(q.row, q.col)) {
          queue.push(pack(*visit, q.row, q.col));
        } else {
          schedule.hand_over(q.row, q.col);
        }
      });
    }
  }
}

/// Direction of the steepest descent on the filled surface; kNoFlow when no neighbour is lower.
std::uint8_t steepest(const FlowGrid& g, const float* filled_m, std::int64_t r, std::int64_t c,
                      const std::array<double, 8>& per_metre) {
  const double level = static_cast<double>(filled_m[r * g.n_cols + c]);
  std::array<double, 8> slopes{};
  for_neighbours(g, r, c, [&](std::int64_t n, int d) {
    const auto k = static_cast<std::size_t>(d);
    if (g.marks[n] & kInside) slopes[k] = (level - static_cast<double>(filled_m[n])) * per_metre[k];
  });
  std::uint8_t best = kNoFlow;
  double best_slope = 0;
  for (const int d : kTieOrder) {
    if (slopes[static_cast<std::size_t>(d)] > best_slope) {
      best_slope = slopes[static_cast<std::size_t>(d)];
      best = static_cast<std::uint8_t>(d);
    }
  }
  return best;
}

/// Direction of a post of a flat.
std::uint8_t across_flat(const FlowGrid& g, const float* filled_m, const FlatSteps* steps, std::int64_t r,
                         std::int64_t c) {
  constexpr std::int64_t kDrains = std::numeric_limits<std::int64_t>::min(),
                         kNever = std::numeric_limits<std::int64_t>::max();
  const std::int64_t i = r * g.n_cols + c;
  std::array<std::int64_t, 8> heads;
  heads.fill(kNever);
  for_neighbours(g, r, c, [&](std::int64_t n, int d) {
    if (!(g.marks[n] & kInside) || filled_m[n] != filled_m[i]) return;
    const FlatSteps& s = steps[n];
    // Where a flat touches no higher ground all of it is as far away.
    const std::int64_t away = s.away_from_higher == kFar ? 0 : s.away_from_higher;
    heads[static_cast<std::size_t>(d)] = g.marks[n] & kInFlat ? 2 * std::int64_t{s.toward_lower} - away : kDrains;
  });
  std::uint8_t best = kNoFlow;
  std::int64_t least = kNever;
  for (const int d : kTieOrder) {
    if (heads[static_cast<std::size_t>(d)] < least) {
      least = heads[static_cast<std::size_t>(d)];
      best = static_cast<std::uint8_t>(d);
    }
  }
  return best;
}

constexpr int kCountShift = 4;        // inflows still to come, above the direction
constexpr std::uint8_t kDone = 0xf0;  // no post has 15 inflows
constexpr std::uint8_t kOneInflow = std::uint8_t{1} << kCountShift;

}  // namespace

void fill_depressions(const FlowGrid& grid, std::int64_t block_side, float* filled_m) {
  Flood(grid, block_side, filled_m).run();
}

std::int64_t direct_flow(const FlowGrid& g, std::int64_t block_side, const float* filled_m, FlatSteps* steps,
                         std::uint8_t* directions) {
  std::int64_t n_flat = 0;
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    std::array<double, 8> per_metre{};
    for (int d = 0; d < 8; ++d) {
      const std::int64_t rr = r + kStepRows[static_cast<std::size_t>(d)];
      if (rr >= 0 && rr < g.n_rows) per_metre[static_cast<std::size_t>(d)] = 1 / g.step_m(r, d);
    }
    for (std::int64_t c = 0; c < g.n_cols; ++c) {
      const std::int64_t i = r * g.n_cols + c;
      g.marks[i] &= static_cast<std::uint8_t>(~kInFlat);
      if (!(g.marks[i] & kInside)) {
        directions[i] = kNoFlow;
        continue;
      }
      directions[i] = g.marks[i] & kSea ? kLeaves : steepest(g, filled_m, r, c, per_metre);
      if (directions[i] != kNoFlow) continue;
      if (g.marks[i] & kOutlet) {
        directions[i] = kLeaves;
      } else {
        g.marks[i] |= kInFlat;
        ++n_flat;
      }
    }
  }
  if (n_flat == 0) return 0;
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    for (std::int64_t c = 0; c < g.n_cols; ++c) {
      const std::int64_t i = r * g.n_cols + c;
      if (!(g.marks[i] & kInFlat)) continue;
      steps[i] = {kFar, kFar};
      for_neighbours(g, r, c, [&](std::int64_t n, int) {
        if (!(g.marks[n] & kInside)) return;
        if (filled_m[n] > filled_m[i]) steps[i].away_from_higher = 1;
        if (filled_m[n] == filled_m[i] && !(g.marks[n] & kInFlat)) steps[i].toward_lower = 1;
      });
    }
  }
  spread(g, block_side, filled_m, &FlatSteps::toward_lower, steps);
  spread(g, block_side, filled_m, &FlatSteps::away_from_higher, steps);
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    for (std::int64_t c = 0; c < g.n_cols; ++c) {
      const std::int64_t i = r * g.n_cols + c;
      if (g.marks[i] & kInFlat) directions[i] = across_flat(g, filled_m, steps, r, c);
    }
  }
  return n_flat;
}

void accumulate_flow(const FlowGrid& g, std::int64_t block_side, std::uint8_t* directions,
                     std::uint64_t* accumulation) {
  const auto downstream = [&](std::int64_t r, std::int64_t c) {
    const int d = directions[r * g.n_cols + c] & kDirection;
    return d < 8 ? g.neighbour(r, c, d) : -1;
  };
  for (std::int64_t i = 0; i < g.size(); ++i) directions[i] &= kDirection;
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    for (std::int64_t c = 0; c < g.n_cols; ++c) {
      const std::int64_t i = r * g.n_cols + c;
      accumulation[i] = directions[i] % kOneInflow == kNoFlow ? 0 : g.share[static_cast<std::size_t>(r)];
      const std::int64_t n = downstream(r, c);
      if (n >= 0) directions[n] = static_cast<std::uint8_t>(directions[n] + kOneInflow);
    }
  }
  BlockSchedule schedule(g.n_rows, g.n_cols, block_side);
  while (auto visit = schedule.next()) {
    // A post whose inflows are all in passes its sum on; so does the next one, for as long as that completes it.
    const auto walk = [&](std::int64_t r, std::int64_t c) {
      std::int64_t i = r * g.n_cols + c;
      while (directions[i] >> kCountShift == 0) {
        const std::int64_t n = downstream(r, c);
        directions[i] |= kDone;
        if (n < 0) return;
        accumulation[n] += accumulation[i];
        directions[n] = static_cast<std::uint8_t>(directions[n] - kOneInflow);
        i = n;
        r = n / g.n_cols;
        c = n % g.n_cols;
        if (!visit->contains(r, c)) {
          if (directions[n] >> kCountShift == 0) schedule.hand_over(r, c);
          return;
        }
      }
    };
    if (visit->first) {
      for (std::int64_t r = visit->row_begin; r < visit->row_end; ++r) {
        for (std::int64_t c = visit->col_begin; c < visit->col_end; ++c) walk(r, c);
      }
    }
    for (const std::int64_t i : visit->posts) walk(i / g.n_cols, i % g.n_cols);
  }
  for (std::int64_t i = 0; i < g.size(); ++i) directions[i] &= kDirection;
}

Flow flow_of(const float* heights_m, std::int64_t n_rows, std::int64_t n_cols, double east_m, double north_m) {
  Flow flow;
  flow.n_rows = n_rows;
  flow.n_cols = n_cols;
  const auto n = static_cast<std::size_t>(n_rows * n_cols);
  std::vector<std::uint8_t> marks(n);
  const FlowGrid g = make_flow_grid(heights_m, n_rows, n_cols, east_m, north_m, marks.data());
  mark_outlets(g);
  flow.filled_m.resize(n);
  fill_depressions(g, kBlockSide, flow.filled_m.data());
  flow.directions.resize(n);
  {
    std::vector<FlatSteps> steps(n);
    direct_flow(g, kBlockSide, flow.filled_m.data(), steps.data(), flow.directions.data());
  }
  std::vector<std::uint64_t> accumulation(n);
  accumulate_flow(g, kBlockSide, flow.directions.data(), accumulation.data());
  flow.cells.resize(n);
  flow.in_flat.resize(n);
  flow.raised.resize(n);
  for (std::size_t i = 0; i < n; ++i) {
    flow.cells[i] = static_cast<double>(accumulation[i]) / double{kCell};
    flow.in_flat[i] = marks[i] & kInFlat ? 1 : 0;
    flow.raised[i] = (marks[i] & kInside) && flow.filled_m[i] > heights_m[i] ? 1 : 0;
  }
  return flow;
}

std::vector<std::uint8_t> channel_mask(const Flow& flow, double min_cells) {
  std::vector<std::uint8_t> mask(flow.cells.size());
  for (std::size_t i = 0; i < mask.size(); ++i) mask[i] = flow.cells[i] > 0 && flow.cells[i] >= min_cells ? 1 : 0;
  return mask;
}

}  // namespace tind
