// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/drainage/stream_links.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <span>

namespace tind {
namespace {

constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();

// What a post above the threshold is for the streams.
constexpr std::uint8_t kStream = 1;       // a stream runs over it
constexpr std::uint8_t kWater = 2;        // of a lake or the sea: streams may end or begin here
constexpr std::uint8_t kDeepPost = 4;     // filled too deep to condition
constexpr std::uint8_t kStep = 8;         // the step to the next post is drawn
constexpr std::uint8_t kNode = 16;        // links end and begin here
constexpr std::uint8_t kOtherLevel = 32;  // reached from a post that another level begins to draw

class LinkFinder {
 public:
  LinkFinder(const FlowGrid& grid, const std::uint8_t* directions, const std::uint64_t* accumulation,
             const StreamOptions& options, const FlowRun& run)
      : g_(grid), directions_(directions), accumulation_(accumulation), options_(options), run_(run) {}

  Result<StreamNetwork> find(const ScratchAllocator& scratch, const std::function<void(const StreamLink&)>& take) {
    count();
    if (row_begin_.back() >= kNone) {
      return fail(ErrorKind::kInvalidInput,
                  "drainage: more than 4 billion posts carry streams; let a stream drain more cells");
    }
    if (row_begin_.back() == 0 || run_.stopped()) return std::move(network_);
    if (!allocate(static_cast<std::size_t>(row_begin_.back()), scratch)) {
      return fail(ErrorKind::kIo,
                  "drainage: no room for the streams' posts (32 bytes each); free disk space, or let a stream drain "
                  "more cells");
    }
    collect();
    run_.report(1, 6);
    go_down();
    run_.report(2, 6);
    order_streams();
    find_nodes();
    run_.report(3, 6);
    condition();
    run_.report(4, 6);
    if (!run_.stopped()) trace(take);
    return std::move(network_);
  }

 private:
  // ---- posts above the threshold, ascending by index
  // -----------------------------------------------------------------

  void count() {
    const std::uint64_t least = options_.thresholds.back();
    row_begin_.assign(static_cast<std::size_t>(g_.n_rows) + 1, 0);
    for_row_bands(quiet(), g_.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
      for (std::int64_t r = row_begin; r < row_end; ++r) {
        std::int64_t n = 0;
        for (std::int64_t i = r * g_.n_cols; i < (r + 1) * g_.n_cols; ++i) n += accumulation_[i] >= least ? 1 : 0;
        row_begin_[static_cast<std::size_t>(r) + 1] = n;
      }
    });
    for (std::size_t r = 0; r + 1 < row_begin_.size(); ++r) row_begin_[r + 1] += row_begin_[r];
  }

  bool allocate(std::size_t n, const ScratchAllocator& scratch) {
    const auto take = [&]<class T>(std::span<T>& array) {
      void* const memory = scratch(n * sizeof(T));
      if (memory == nullptr) return false;
      array = {static_cast<T*>(memory), n};
      return true;
    };
    return take(index_) && take(next_) && take(least_above_) && take(most_below_) && take(flags_) && take(level_) &&
           take(strahler_) && take(n_inflows_) && take(n_highest_) && take(downward_) && take(link_of_);
  }

  void collect() {
    const std::uint64_t least = options_.thresholds.back();
    for_row_bands(quiet(), g_.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
      for (std::int64_t r = row_begin; r < row_end; ++r) {
        auto k = static_cast<std::size_t>(row_begin_[static_cast<std::size_t>(r)]);
        if (k == static_cast<std::size_t>(row_begin_[static_cast<std::size_t>(r) + 1])) continue;
        for (std::int64_t i = r * g_.n_cols; i < (r + 1) * g_.n_cols; ++i) {
          if (accumulation_[i] >= least) begin(k++, i);
        }
      }
    });
    for_row_bands(quiet(), g_.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
      for (std::int64_t r = row_begin; r < row_end; ++r) find_next(r);
    });
  }

  void begin(std::size_t k, std::int64_t i) {
    const std::uint8_t mark = g_.marks[i];
    index_[k] = i;
    flags_[k] = 0;
    if (!(mark & (kSea | kLake | kVoid | kBasin))) flags_[k] |= kStream;
    if ((mark & (kSea | kLake)) && !(mark & (kVoid | kBasin))) flags_[k] |= kWater;
    if (mark & kDeep) flags_[k] |= kDeepPost;
    std::uint8_t level = 0;
    while (accumulation_[i] < options_.thresholds[level]) ++level;
    level_[k] = level;
    least_above_[k] = most_below_[k] = g_.heights_m[i];
    strahler_[k] = n_highest_[k] = n_inflows_[k] = 0;
    link_of_[k] = kNone;
  }

  // Positions of the posts that those of a row flow into: in this row or one beside it, about as far along.
  void find_next(std::int64_t r) {
    std::array<std::int64_t, 3> cursors{};
    const auto begin_of = [&](std::int64_t row) { return row_begin_[static_cast<std::size_t>(row)]; };
    for (std::int64_t k = 0; k < 3; ++k) {
      cursors[static_cast<std::size_t>(k)] = begin_of(std::clamp<std::int64_t>(r + k - 1, 0, g_.n_rows));
    }
    for (auto k = static_cast<std::size_t>(begin_of(r)); k < static_cast<std::size_t>(begin_of(r + 1)); ++k) {
      next_[k] = kNone;
      const int d = directions_[index_[k]] & kDirection;
      if (d >= 8) continue;
      const std::int64_t c = index_[k] - r * g_.n_cols, n = g_.neighbour(r, c, d), row = n / g_.n_cols;
      std::int64_t& cursor = cursors[static_cast<std::size_t>(row - r + 1)];
      if (std::abs(n - row * g_.n_cols - c) > 1) {  // across the seam
        const auto first = index_.begin() + begin_of(row), last = index_.begin() + begin_of(row + 1);
        next_[k] = static_cast<std::uint32_t>(std::lower_bound(first, last, n) - index_.begin());
        continue;
      }
      while (index_[static_cast<std::size_t>(cursor)] < row * g_.n_cols + c - 1) ++cursor;
      auto at = static_cast<std::size_t>(cursor);
      while (index_[at] < n) ++at;
      next_[k] = static_cast<std::uint32_t>(at);
    }
  }

  // An order that goes down every stream.
  void go_down() {
    for (const std::uint32_t n : next_) {
      pause_now_and_then();
      if (n != kNone) ++n_inflows_[n];
    }
    constexpr std::uint8_t kListed = 255;
    std::size_t n_listed = 0;
    for (std::size_t first = 0; first < next_.size(); ++first) {
      for (auto k = static_cast<std::uint32_t>(first); k != kNone && n_inflows_[k] == 0; k = next_[k]) {
        pause_now_and_then();
        n_inflows_[k] = kListed;
        downward_[n_listed++] = k;
        if (next_[k] != kNone) --n_inflows_[next_[k]];
      }
    }
    downward_ = downward_.first(n_listed);
    std::fill(n_inflows_.begin(), n_inflows_.end(), std::uint8_t{0});
  }

  // ---- streams
  // -------------------------------------------------------------------------------------------------------

  bool is(std::size_t k, std::uint8_t flag) const { return (flags_[k] & flag) != 0; }
  double own_height_m(std::size_t k) const { return static_cast<double>(g_.heights_m[index_[k]]); }

  void order_streams() {
    for (const std::uint32_t k : downward_) {
      pause_now_and_then();
      if (strahler_[k] == 0) {
        strahler_[k] = 1;
      } else if (n_highest_[k] > 1) {
        ++strahler_[k];
      }
      const std::uint32_t n = next_[k];
      if (n == kNone) continue;
      // Until its turn comes the next one's holds the highest of its inflows.
      if (strahler_[k] > strahler_[n]) {
        strahler_[n] = strahler_[k];
        n_highest_[n] = 0;
      }
      if (strahler_[k] == strahler_[n]) ++n_highest_[n];
    }
  }

  // Where a lake runs out, several of its posts may flow into one: the outflow is the one that carries most.
  bool is_outflow(std::size_t k) const {
    const std::int64_t i = index_[k], to = index_[next_[k]];
    if (g_.marks[i] & kSea) return false;
    for (int d = 0; d < 8; ++d) {
      const std::int64_t n = g_.neighbour(to / g_.n_cols, to % g_.n_cols, d);
      if (n < 0 || n == i || (directions_[n] & kDirection) != (d + 4) % 8) continue;
      if ((g_.marks[n] & (kLake | kSea | kVoid | kBasin)) != kLake) continue;
      if (accumulation_[n] > accumulation_[i] || (accumulation_[n] == accumulation_[i] && n < i)) return false;
    }
    return true;
  }

  void find_nodes() {
    for (std::size_t k = 0; k < next_.size(); ++k) {
      const std::uint32_t n = next_[k];
      pause_now_and_then();
      if (n == kNone) continue;
      const bool step = is(k, kStream) ? is(n, kStream | kWater) : is(n, kStream) && is(k, kWater) && is_outflow(k);
      if (!step) continue;
      flags_[k] |= kStep;
      ++n_inflows_[n];
      if (level_[n] != level_[k]) flags_[n] |= kOtherLevel;
    }
    for (std::size_t k = 0; k < next_.size(); ++k) {
      if (n_inflows_[k] != 1 || !is(k, kStep) || !is(k, kStream) || is(k, kOtherLevel)) flags_[k] |= kNode;
    }
  }

  double change_m(std::size_t k) const {
    return (static_cast<double>(most_below_[k]) + static_cast<double>(least_above_[k])) / 2 - own_height_m(k);
  }

  double conditioned_m(std::size_t k) const {
    if (!is(k, kStream) || is(k, kDeepPost)) return own_height_m(k);
    return own_height_m(k) + std::clamp(change_m(k), -options_.max_change_m, options_.max_change_m);
  }

  void condition() {
    StreamCounts& counts = network_.counts;
    counts.channel_posts = static_cast<std::int64_t>(next_.size());
    counts.deviations_above.assign(options_.deviation_limits_m.size(), 0);
    const auto passes = [&](std::size_t k) { return is(k, kStep) && !is(k, kDeepPost) && !is(next_[k], kDeepPost); };
    const auto own = [&](std::size_t k) { return g_.heights_m[index_[k]]; };
    for (const std::uint32_t k : downward_) {
      pause_now_and_then();
      if (!passes(k)) continue;
      float& below = least_above_[next_[k]];
      below = std::min(below, is(k, kStream) ? least_above_[k] : own(k));
    }
    for (auto k = downward_.rbegin(); k != downward_.rend(); ++k) {
      pause_now_and_then();
      if (!passes(*k)) continue;
      const std::uint32_t n = next_[*k];
      most_below_[*k] = std::max(most_below_[*k], is(n, kStream) ? most_below_[n] : own(n));
    }
    for (std::size_t k = 0; k < next_.size(); ++k) {
      if (!is(k, kStream)) continue;
      ++counts.stream_posts;
      if (is(k, kDeepPost)) {
        ++counts.deep_posts;
        continue;
      }
      const double change = std::abs(change_m(k));
      counts.largest_deviation_m = std::max(counts.largest_deviation_m, change);
      for (std::size_t n = 0; n < options_.deviation_limits_m.size(); ++n) {
        if (change > options_.deviation_limits_m[n]) ++counts.deviations_above[n];
      }
      if (change > options_.max_change_m) ++counts.clamped;
    }
    for (std::size_t k = 0; k < next_.size(); ++k) {
      pause_now_and_then();
      if (!is(k, kStep)) continue;
      const double rise = conditioned_m(next_[k]) - conditioned_m(k);
      if (rise <= 0) continue;
      ++counts.uphill_steps;
      counts.largest_uphill_m = std::max(counts.largest_uphill_m, rise);
    }
  }

  void trace(const std::function<void(const StreamLink&)>& take) {
    std::vector<std::uint32_t> end_of;  // per link
    StreamLink link;
    for (std::size_t first = 0; first < next_.size(); ++first) {
      if (!is(first, kStep) || !is(first, kNode)) continue;
      link.first_level = level_[first];
      link.strahler = strahler_[first];
      link.posts.clear();
      link.heights_m.clear();
      std::size_t k = first;
      const auto add = [&] {
        link.posts.push_back(index_[k]);
        link.heights_m.push_back(conditioned_m(k));
      };
      add();
      do {
        pause_now_and_then();
        link_of_[k] = static_cast<std::uint32_t>(end_of.size());
        link.accumulation = accumulation_[index_[k]];
        k = next_[k];
        add();
      } while (!is(k, kNode));
      end_of.push_back(static_cast<std::uint32_t>(k));
      take(link);
    }
    // Where no drawn step goes on, the water does: on to the next drawn one.
    for (auto k = downward_.rbegin(); k != downward_.rend(); ++k) {
      pause_now_and_then();
      if (link_of_[*k] == kNone && next_[*k] != kNone) link_of_[*k] = link_of_[next_[*k]];
    }
    for (const std::uint32_t end : end_of) {
      network_.downstream.push_back(link_of_[end] == kNone ? -1 : std::int64_t{link_of_[end]});
    }
  }

  FlowRun quiet() const { return run_.quiet(); }
  // In a loop over posts that lie anywhere: each may bring in some pages of several arrays, with others around them.
  void pause_now_and_then() {
    if ((++n_steps_ & 127) == 0) run_.pause();
  }

  const FlowGrid& g_;
  const std::uint8_t* directions_;
  const std::uint64_t* accumulation_;
  const StreamOptions& options_;
  const FlowRun& run_;
  std::uint32_t n_steps_ = 0;
  std::vector<std::int64_t> row_begin_;  // n_rows + 1: position of a row's first post
  std::span<std::int64_t> index_;
  std::span<std::uint32_t> next_;  // position of the post downstream; kNone where the water leaves
  std::span<float> least_above_, most_below_;
  std::span<std::uint8_t> flags_, level_, strahler_, n_inflows_, n_highest_;
  std::span<std::uint32_t> downward_, link_of_;
  StreamNetwork network_;
};

}  // namespace

Result<StreamNetwork> find_streams(const FlowGrid& grid, const std::uint8_t* directions,
                                   const std::uint64_t* accumulation, const StreamOptions& options,
                                   const ScratchAllocator& scratch, const FlowRun& run,
                                   const std::function<void(const StreamLink&)>& take) {
  return LinkFinder(grid, directions, accumulation, options, run).find(scratch, take);
}

}  // namespace tind
