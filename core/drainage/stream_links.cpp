// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/drainage/stream_links.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace tind {
namespace {

/// What a post above the threshold is for the streams.
struct ChannelPost {
  std::int64_t index = 0;
  std::int64_t next = -1;  ///< Position of the post downstream in the list; -1 where the water leaves.
  std::uint64_t accumulation = 0;
  double height_m = 0;  ///< The post's own; conditioned later.
  int level = 0;        ///< Coarsest level that draws the step to `next`.
  int strahler = 1;
  std::int32_t n_inflows = 0;  ///< Drawn steps that end here.
  bool stream = false;         ///< A stream runs over it.
  bool water = false;          ///< Of a lake or the sea: streams may end or begin here.
  bool deep = false;           ///< Filled too deep to condition.
  bool step = false;           ///< The step to `next` is drawn.
  bool node = false;           ///< Links end and begin here.
};

class LinkFinder {
 public:
  LinkFinder(const FlowGrid& grid, const float* filled_m, const std::uint8_t* directions,
             const std::uint64_t* accumulation, const StreamOptions& options)
      : g_(grid), options_(options) {
    collect(filled_m, directions, accumulation);
    // Downstream there is always more, so this order goes down every stream.
    downward_.resize(posts_.size());
    std::iota(downward_.begin(), downward_.end(), std::size_t{0});
    std::stable_sort(downward_.begin(), downward_.end(),
                     [&](std::size_t a, std::size_t b) { return posts_[a].accumulation < posts_[b].accumulation; });
    order_streams();
    find_nodes();
  }

  StreamNetwork run() {
    condition();
    trace();
    return std::move(network_);
  }

 private:
  void collect(const float* filled_m, const std::uint8_t* directions, const std::uint64_t* accumulation) {
    const std::uint64_t least = options_.thresholds.back();
    std::vector<std::size_t> row_begin;
    for (std::int64_t r = 0; r < g_.n_rows; ++r) {
      row_begin.push_back(posts_.size());
      for (std::int64_t i = r * g_.n_cols; i < (r + 1) * g_.n_cols; ++i) {
        const std::uint8_t mark = g_.marks[i];
        if (!(mark & kInside) || accumulation[i] < least) continue;
        ChannelPost p;
        p.index = i;
        p.accumulation = accumulation[i];
        p.height_m = static_cast<double>(g_.heights_m[i]);
        p.stream = !(mark & (kSea | kLake | kVoid | kBasin));
        p.water = (mark & (kSea | kLake)) && !(mark & (kVoid | kBasin));
        p.deep = static_cast<double>(filled_m[i]) - p.height_m > 2 * options_.max_change_m;
        while (p.accumulation < options_.thresholds[static_cast<std::size_t>(p.level)]) ++p.level;
        posts_.push_back(p);
      }
    }
    row_begin.push_back(posts_.size());
    for (ChannelPost& p : posts_) {
      const int d = directions[p.index] & kDirection;
      if (d >= 8) continue;
      const std::int64_t n = g_.neighbour(p.index / g_.n_cols, p.index % g_.n_cols, d);
      const auto row = static_cast<std::size_t>(n / g_.n_cols);
      const auto begin = posts_.begin() + static_cast<std::ptrdiff_t>(row_begin[row]),
                 end = posts_.begin() + static_cast<std::ptrdiff_t>(row_begin[row + 1]);
      p.next = std::lower_bound(begin, end, n, [](const ChannelPost& q, std::int64_t i) { return q.index < i; }) -
               posts_.begin();
    }
  }

  ChannelPost& next_of(const ChannelPost& p) { return posts_[static_cast<std::size_t>(p.next)]; }

  void order_streams() {
    struct Inflows {
      int highest = 0, n_highest = 0;
    };
    std::vector<Inflows> inflows(posts_.size());
    for (const std::size_t k : downward_) {
      ChannelPost& p = posts_[k];
      if (inflows[k].highest > 0) p.strahler = inflows[k].highest + (inflows[k].n_highest > 1 ? 1 : 0);
      if (p.next < 0) continue;
      Inflows& below = inflows[static_cast<std::size_t>(p.next)];
      if (p.strahler > below.highest) below = {p.strahler, 0};
      if (p.strahler == below.highest) ++below.n_highest;
    }
  }

  void find_nodes() {
    // Where a lake runs out, several of its posts flow into one: the outflow is the one that carries most.
    std::vector<const ChannelPost*> outflow(posts_.size(), nullptr);
    for (const ChannelPost& p : posts_) {
      if (!p.water || (g_.marks[p.index] & kSea) || p.next < 0) continue;
      const ChannelPost*& best = outflow[static_cast<std::size_t>(p.next)];
      if (!best || p.accumulation > best->accumulation) best = &p;
    }
    std::vector<int> level_above(posts_.size(), -1);
    for (ChannelPost& p : posts_) {
      if (p.next < 0) continue;
      ChannelPost& q = next_of(p);
      p.step = p.stream ? q.stream || q.water : q.stream && outflow[static_cast<std::size_t>(p.next)] == &p;
      if (!p.step) continue;
      ++q.n_inflows;
      level_above[static_cast<std::size_t>(p.next)] = p.level;
    }
    for (std::size_t k = 0; k < posts_.size(); ++k) {
      ChannelPost& p = posts_[k];
      p.node = p.n_inflows != 1 || !p.step || !p.stream || level_above[k] != p.level;
    }
  }

  void condition() {
    StreamCounts& counts = network_.counts;
    counts.channel_posts = static_cast<std::int64_t>(posts_.size());
    counts.deviations_above.assign(options_.deviation_limits_m.size(), 0);
    const auto passes = [&](const ChannelPost& p) { return p.step && !p.deep && !next_of(p).deep; };
    std::vector<double> least_above, most_below;
    for (const ChannelPost& p : posts_) least_above.push_back(p.height_m);
    most_below = least_above;
    for (const std::size_t k : downward_) {
      const ChannelPost& p = posts_[k];
      if (!passes(p)) continue;
      double& below = least_above[static_cast<std::size_t>(p.next)];
      below = std::min(below, p.stream ? least_above[k] : p.height_m);
    }
    for (auto k = downward_.rbegin(); k != downward_.rend(); ++k) {
      const ChannelPost& p = posts_[*k];
      if (!passes(p)) continue;
      const ChannelPost& q = next_of(p);
      most_below[*k] = std::max(most_below[*k], q.stream ? most_below[static_cast<std::size_t>(p.next)] : q.height_m);
    }
    for (std::size_t k = 0; k < posts_.size(); ++k) {
      ChannelPost& p = posts_[k];
      if (!p.stream) continue;
      ++counts.stream_posts;
      if (p.deep) {
        ++counts.deep_posts;
        continue;
      }
      const double change = (most_below[k] + least_above[k]) / 2 - p.height_m;
      counts.largest_deviation_m = std::max(counts.largest_deviation_m, std::abs(change));
      for (std::size_t n = 0; n < options_.deviation_limits_m.size(); ++n) {
        if (std::abs(change) > options_.deviation_limits_m[n]) ++counts.deviations_above[n];
      }
      if (std::abs(change) > options_.max_change_m) ++counts.clamped;
      p.height_m += std::clamp(change, -options_.max_change_m, options_.max_change_m);
    }
    for (const ChannelPost& p : posts_) {
      if (!p.step) continue;
      const double rise = next_of(p).height_m - p.height_m;
      if (rise <= 0) continue;
      ++counts.uphill_steps;
      counts.largest_uphill_m = std::max(counts.largest_uphill_m, rise);
    }
  }

  void trace() {
    constexpr std::int64_t kNone = -1;
    std::vector<std::int64_t> link_of(posts_.size(), kNone), end_of;
    for (std::size_t first = 0; first < posts_.size(); ++first) {
      if (!posts_[first].step || !posts_[first].node) continue;
      StreamLink link;
      link.first_level = posts_[first].level;
      link.strahler = posts_[first].strahler;
      std::size_t k = first;
      const auto add = [&] {
        link.posts.push_back(posts_[k].index);
        link.heights_m.push_back(posts_[k].height_m);
      };
      add();
      do {
        link_of[k] = static_cast<std::int64_t>(network_.links.size());
        link.accumulation = posts_[k].accumulation;
        k = static_cast<std::size_t>(posts_[k].next);
        add();
      } while (!posts_[k].node);
      end_of.push_back(static_cast<std::int64_t>(k));
      network_.links.push_back(std::move(link));
    }
    // Where no drawn step goes on, the water does: on to the next drawn one.
    for (auto k = downward_.rbegin(); k != downward_.rend(); ++k) {
      const std::int64_t next = posts_[*k].next;
      if (link_of[*k] == kNone && next >= 0) link_of[*k] = link_of[static_cast<std::size_t>(next)];
    }
    for (std::size_t n = 0; n < end_of.size(); ++n) {
      network_.links[n].downstream = link_of[static_cast<std::size_t>(end_of[n])];
    }
  }

  const FlowGrid& g_;
  const StreamOptions& options_;
  std::vector<ChannelPost> posts_;  // ascending by index
  std::vector<std::size_t> downward_;
  StreamNetwork network_;
};

}  // namespace

StreamNetwork find_streams(const FlowGrid& grid, const float* filled_m, const std::uint8_t* directions,
                           const std::uint64_t* accumulation, const StreamOptions& options) {
  return LinkFinder(grid, filled_m, directions, accumulation, options).run();
}

}  // namespace tind
