// SPDX-License-Identifier: GPL-3.0-or-later
#include <algorithm>
#include <array>
#include <atomic>
#include <cstring>
#include <limits>
#include <vector>

#include "core/drainage/block_schedule.hpp"
#include "core/drainage/flow.hpp"
#include "core/registers.hpp"

namespace tind {
namespace {

constexpr float kOutside = -std::numeric_limits<float>::infinity();  // of the filled surface
constexpr std::int64_t kChunk = 64;                                  // posts that are directed at a time

/// Reciprocal distances to the neighbours of a row's posts; 0 beyond the grid.
std::array<double, 8> reciprocal_steps(const FlowGrid& g, std::int64_t r) {
  std::array<double, 8> per_metre{};
  for (int d = 0; d < 8; ++d) {
    const std::int64_t rr = r + kStepRows[static_cast<std::size_t>(d)];
    if (rr >= 0 && rr < g.n_rows) per_metre[static_cast<std::size_t>(d)] = 1 / g.step_m(r, d);
  }
  return per_metre;
}

/// Direction of the steepest descent on the filled surface; kNoFlow when no neighbour is lower.
std::uint8_t steepest(const FlowGrid& g, const float* filled_m, std::int64_t r, std::int64_t c,
                      const std::array<double, 8>& per_metre) {
  const double level = static_cast<double>(filled_m[r * g.n_cols + c]);
  std::uint8_t best = kNoFlow;
  double best_slope = 0;
  for (const int d : kTieOrder) {
    const std::int64_t n = g.neighbour(r, c, d);
    if (n < 0 || filled_m[n] == kOutside) continue;
    const double slope = (level - static_cast<double>(filled_m[n])) * per_metre[static_cast<std::size_t>(d)];
    if (slope > best_slope) {
      best_slope = slope;
      best = static_cast<std::uint8_t>(d);
    }
  }
  return best;
}

/// As steepest for kChunk posts from `filled` on, all of whose neighbours are on the grid and take part.
TIND_WIDE_OR_MASKED void steepest_of_chunk(const float* filled, std::int64_t n_cols,
                                           const std::array<double, 8>& per_metre, std::uint8_t* best) {
  std::array<double, kChunk> slope{}, direction;
  direction.fill(kNoFlow);
  for (const int d : kTieOrder) {
    const auto k = static_cast<std::size_t>(d);
    const float* const beside = filled + kStepRows[k] * n_cols + kStepCols[k];
    const double per = per_metre[k], code = d;
    for (std::size_t c = 0; c < kChunk; ++c) {
      const double s = (static_cast<double>(filled[c]) - static_cast<double>(beside[c])) * per;
      direction[c] = s > slope[c] ? code : direction[c];
      slope[c] = s > slope[c] ? s : slope[c];
    }
  }
  for (std::size_t c = 0; c < kChunk; ++c) best[c] = static_cast<std::uint8_t>(static_cast<int>(direction[c]));
}

/// True iff no post of rows r - 1 .. r + 1 and columns c - 1 .. c + kChunk is kOutside; they are all on the grid.
bool all_take_part(const FlowGrid& g, const float* filled_m, std::int64_t r, std::int64_t c) {
  bool outside = false;
  for (std::int64_t rr = r - 1; rr <= r + 1; ++rr) {
    const float* const row = filled_m + rr * g.n_cols + c - 1;
    for (std::int64_t k = 0; k < kChunk + 2; ++k) outside |= row[k] == kOutside;
  }
  return !outside;
}

/// The first index in [begin, end) whose direction is kNoFlow, else `end`.
std::int64_t next_without_flow(const std::uint8_t* directions, std::int64_t begin, std::int64_t end) {
  const void* const found = std::memchr(directions + begin, kNoFlow, static_cast<std::size_t>(end - begin));
  return found == nullptr ? end : static_cast<const std::uint8_t*>(found) - directions;
}

/// Directs the posts of a row that have a lower neighbour, marks those of flats. Returns the number of these.
std::int64_t direct_row(const FlowGrid& g, const float* filled_m, std::int64_t r, std::uint8_t* directions) {
  const std::array<double, 8> per_metre = reciprocal_steps(g, r);
  const std::int64_t row = r * g.n_cols;
  for (std::int64_t c = 0; c < g.n_cols;) {
    if (r > 0 && r + 1 < g.n_rows && c > 0 && c + kChunk < g.n_cols && all_take_part(g, filled_m, r, c)) {
      steepest_of_chunk(filled_m + row + c, g.n_cols, per_metre, directions + row + c);
      c += kChunk;
      continue;
    }
    for (const std::int64_t end = std::min(g.n_cols, c + (c == 0 ? 1 : kChunk)); c < end; ++c) {
      directions[row + c] = filled_m[row + c] == kOutside ? kNoFlow : steepest(g, filled_m, r, c, per_metre);
    }
  }
  const std::int64_t end = row + g.n_cols;
  for (std::int64_t i = row; i < end; ++i) g.marks[i] &= static_cast<std::uint8_t>(~kInFlat);
  for (std::int64_t i = next_marked(g.marks, row, end, kSea); i < end; i = next_marked(g.marks, i + 1, end, kSea)) {
    if (g.marks[i] & kInside) directions[i] = kLeaves;
  }
  std::int64_t n_flat = 0;
  for (std::int64_t i = next_without_flow(directions, row, end); i < end;
       i = next_without_flow(directions, i + 1, end)) {
    const std::uint8_t mark = g.marks[i];
    if (!(mark & kInside)) continue;
    if (mark & kOutlet) {
      directions[i] = kLeaves;
    } else {
      g.marks[i] |= kInFlat;
      ++n_flat;
    }
  }
  return n_flat;
}

/// Calls f(row, column, index) for the posts of a row that are of flats.
template <class F>
void for_flat_posts(const FlowGrid& g, std::int64_t r, std::int64_t col_begin, std::int64_t col_end, F&& f) {
  const std::int64_t row = r * g.n_cols, end = row + col_end;
  for (std::int64_t i = next_marked(g.marks, row + col_begin, end, kInFlat); i < end;
       i = next_marked(g.marks, i + 1, end, kInFlat)) {
    f(i - row, i);
  }
}

// Two distances of a post in one word (FlatSteps).
struct TowardLower {
  static constexpr std::uint32_t kMost = FlatSteps::kFarToward;
  static std::uint32_t get(FlatSteps s) { return s.toward_lower(); }
  static FlatSteps set(FlatSteps s, std::uint32_t steps) { return {steps, s.away_from_higher()}; }
};
struct AwayFromHigher {
  static constexpr std::uint32_t kMost = FlatSteps::kFarAway;
  static std::uint32_t get(FlatSteps s) { return s.away_from_higher(); }
  static FlatSteps set(FlatSteps s, std::uint32_t steps) { return {s.toward_lower(), steps}; }
};

/// Steps from the seeds of a flat (those at distance 1) to every post of it, breadth first in one block at a time: what
/// other blocks handed over joins the queue at its distance. Posts of flats that touch belong to one flat.
template <class Distance>
class Spread {
 public:
  Spread(const FlowGrid& grid, FlatSteps* steps) : g_(grid), steps_(steps) {}

  void visit(BlockSchedule::Visit& visit) {
    seeds_.clear();
    queue_.clear();
    if (visit.first) {
      for (std::int64_t r = visit.row_begin; r < visit.row_end; ++r) {
        for_flat_posts(g_, r, visit.col_begin, visit.col_end, [&](std::int64_t c, std::int64_t i) {
          if (Distance::get(steps_[i]) == 1) queue_.push_back(visit.place(r, c));
        });
      }
    }
    for (const BlockPlace at : visit.places) {
      const std::int64_t i = visit.row(at) * g_.n_cols + visit.col(at);
      seeds_.push_back(std::uint64_t{Distance::get(steps_[i])} << 32 | at);
    }
    std::sort(seeds_.begin(), seeds_.end());
    std::size_t next = 0, next_seed = 0;
    std::uint32_t last = 0;  // distance of the queue's front, a lower bound
    while (next < queue_.size() || next_seed < seeds_.size()) {
      if (next < queue_.size()) last = Distance::get(steps_[index(visit, queue_[next])]);
      if (next_seed < seeds_.size() && (next == queue_.size() || seeds_[next_seed] >> 32 <= last)) {
        expand(visit, static_cast<BlockPlace>(seeds_[next_seed++]));
      } else {
        expand(visit, queue_[next++]);
      }
    }
  }

 private:
  std::int64_t index(const BlockSchedule::Visit& visit, BlockPlace at) const {
    return visit.row(at) * g_.n_cols + visit.col(at);
  }

  void expand(BlockSchedule::Visit& visit, BlockPlace at) {
    const std::int64_t r = visit.row(at), c = visit.col(at), i = r * g_.n_cols + c;
    const std::uint32_t next = Distance::get(steps_[i]) + 1;
    if (next >= Distance::kMost) return;
    const bool inner = r > 0 && r + 1 < g_.n_rows && c > 0 && c + 1 < g_.n_cols;
    for (std::size_t k = 0; k < 8; ++k) {
      const std::int64_t n =
          inner ? i + kStepRows[k] * g_.n_cols + kStepCols[k] : g_.neighbour(r, c, static_cast<int>(k));
      if (n < 0 || !(g_.marks[n] & kInFlat) || Distance::get(steps_[n]) <= next) continue;
      steps_[n] = Distance::set(steps_[n], next);
      const std::int64_t row = r + kStepRows[k], col = n - row * g_.n_cols;
      if (visit.contains(row, col)) {
        queue_.push_back(visit.place(row, col));
      } else {
        visit.hand_over(row, col);
      }
    }
  }

  const FlowGrid& g_;
  FlatSteps* steps_;
  std::vector<BlockPlace> queue_;
  std::vector<std::uint64_t> seeds_;  // distance, place
};

template <class Distance>
bool spread(const FlowGrid& g, std::int64_t block_side, FlatSteps* steps, const FlowRun& run) {
  std::vector<Spread<Distance>> workers(static_cast<std::size_t>(std::max(1, run.threads)), {g, steps});
  BlockSchedule schedule(g.n_rows, g.n_cols, g.wraps, block_side);
  return schedule.run(
      run, [&](int worker, BlockSchedule::Visit& visit) { workers[static_cast<std::size_t>(worker)].visit(visit); },
      [] {});
}

/// The distances that are known at once: 1 or far.
void seed_flat(const FlowGrid& g, const float* filled_m, std::int64_t r, FlatSteps* steps) {
  for_flat_posts(g, r, 0, g.n_cols, [&](std::int64_t c, std::int64_t i) {
    bool higher = false, drains = false;
    for (int d = 0; d < 8; ++d) {
      const std::int64_t n = g.neighbour(r, c, d);
      if (n < 0 || !(g.marks[n] & kInside)) continue;
      higher = higher || filled_m[n] > filled_m[i];
      drains = drains || (filled_m[n] == filled_m[i] && !(g.marks[n] & kInFlat));
    }
    steps[i] = {drains ? 1 : FlatSteps::kFarToward, higher ? 1 : FlatSteps::kFarAway};
  });
}

/// Direction of a post of a flat.
std::uint8_t across_flat(const FlowGrid& g, const float* filled_m, const FlatSteps* steps, std::int64_t r,
                         std::int64_t c) {
  const std::int64_t i = r * g.n_cols + c;
  if (steps[i].toward_lower() == FlatSteps::kFarToward) return kLeaves;
  std::uint8_t best = kNoFlow;
  std::int64_t least = std::numeric_limits<std::int64_t>::max();
  for (const int d : kTieOrder) {
    const std::int64_t n = g.neighbour(r, c, d);
    if (n < 0 || !(g.marks[n] & kInside) || filled_m[n] != filled_m[i]) continue;
    if (!(g.marks[n] & kInFlat)) return static_cast<std::uint8_t>(d);  // it drains
    const std::int64_t head = 2 * std::int64_t{steps[n].toward_lower()} - steps[n].away_from_higher();
    if (head < least) {
      least = head;
      best = static_cast<std::uint8_t>(d);
    }
  }
  return best;
}

}  // namespace

std::int64_t direct_flow(const FlowGrid& g, std::int64_t block_side, const float* filled_m, FlatSteps* steps,
                         std::uint8_t* directions, const FlowRun& run) {
  const FlowRun quiet = run.quiet();
  std::atomic<std::int64_t> n_flat{0};
  for_row_bands(quiet, g.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
    std::int64_t n = 0;
    for (std::int64_t r = row_begin; r < row_end; ++r) n += direct_row(g, filled_m, r, directions);
    n_flat += n;
  });
  run.report(1, 3);
  if (n_flat == 0) return 0;
  for_row_bands(quiet, g.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
    for (std::int64_t r = row_begin; r < row_end; ++r) seed_flat(g, filled_m, r, steps);
  });
  if (!spread<AwayFromHigher>(g, block_side, steps, quiet)) return n_flat;
  run.report(2, 3);
  if (!spread<TowardLower>(g, block_side, steps, quiet)) return n_flat;
  for_row_bands(quiet, g.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
    for (std::int64_t r = row_begin; r < row_end; ++r) {
      for_flat_posts(g, r, 0, g.n_cols,
                     [&](std::int64_t c, std::int64_t i) { directions[i] = across_flat(g, filled_m, steps, r, c); });
    }
  });
  return n_flat;
}

}  // namespace tind
