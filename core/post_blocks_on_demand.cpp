// SPDX-License-Identifier: GPL-3.0-or-later
#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <span>
#include <tuple>
#include <vector>

#include "core/drainage/flow_run.hpp"
#include "core/height_field.hpp"
#include "core/post_blocks.hpp"
#include "core/registers.hpp"

namespace tind {
namespace {

using Lanes = std::array<float, 8>;

#define TIND_LOOPS "core/post_summary_loops.inc"
#include "core/register_widths.inc"

// Adds `n` posts of a row.
void add_origins(const PostOrigin* origins, std::int64_t n, PostSummary& to) {
  constexpr std::uint64_t kEight = 0x0101010101010101u * static_cast<std::uint64_t>(PostOrigin::kSource);
  std::uint64_t eight = 0, same = kEight;
  std::int64_t k = 0;
  for (; k + 8 <= n; k += 8) {
    std::memcpy(&eight, origins + k, sizeof eight);
    same = eight == kEight ? same : 0;
  }
  if (same == kEight && k > 0) {
    to.origins |= 1 << static_cast<int>(PostOrigin::kSource);
    to.n_source += static_cast<std::uint32_t>(k);
  } else {
    k = 0;
  }
  for (; k < n; ++k) {
    to.origins = static_cast<std::uint8_t>(to.origins | 1 << static_cast<int>(origins[k]));
    to.n_source += origins[k] == PostOrigin::kSource;
  }
}

// Of squares, side by side and no wider than pages.
void summarize(const HeightField& field, std::span<const PostBlocks::Extent> squares, PostSummary* to) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  constexpr std::int64_t kLanes = std::tuple_size_v<Lanes>;
  struct Range {
    Lanes low, high;
  };
  Range none;
  none.low.fill(kInfinity);
  none.high.fill(-kInfinity);
  std::vector<Range> ranges(squares.size(), none);
  const auto add = [&](std::size_t s, std::int64_t r_begin, std::int64_t r_end) {
    const PostBlocks::Extent& e = squares[s];
    const auto [heights, origins, stride] = field.posts_from(r_begin, e.col);
    const std::int64_t whole = e.n_cols / kLanes * kLanes;
    auto& [low, high] = ranges[s];
    for (std::int64_t r = 0; r < r_end - r_begin; ++r) {
      const float* const row = heights + r * stride;
      if (kIsWide) {
        wide::widen(row, whole, low, high);
      } else {
        narrow::widen(row, whole, low, high);
      }
      for (std::int64_t c = whole; c < e.n_cols; ++c) {
        low[0] = std::min(low[0], row[c]);
        high[0] = std::max(high[0], row[c]);
      }
      add_origins(origins + r * stride, e.n_cols, to[s]);
    }
  };
  // Arrays in the order of their rows, of pages one after the other.
  const std::int64_t row = squares.front().row, row_end = row + squares.front().n_rows;
  const std::int64_t n_at_once = field.pages == nullptr ? 1 : row_end - row;
  for (std::int64_t r = row; r < row_end; r += n_at_once) {
    for (std::size_t s = 0; s < squares.size(); ++s) add(s, r, r + n_at_once);
  }
  for (std::size_t s = 0; s < squares.size(); ++s) {
    const auto& [low, high] = ranges[s];
    to[s].min_height_m = *std::min_element(low.begin(), low.end());
    to[s].max_height_m = *std::max_element(high.begin(), high.end());
  }
}

enum State : std::uint8_t { kNone, kBeingMade, kMade };

}  // namespace

// Which blocks are made, from the level of squares up, and what is known of squares that are not.
struct PostBlocks::Demand {
  HeightField field;
  std::vector<PostSummary> squares;
  std::vector<std::vector<std::atomic<std::uint8_t>>> states;  // of blocks from square_level() on
};

PostBlocks PostBlocks::on_demand(const HeightField& field, std::span<std::byte> memory, int threads,
                                 const std::atomic<bool>* cancel, std::span<const PostSummary> known) {
  PostBlocks result = lay_out(field, memory);
  result.demand_ = std::make_shared<Demand>();
  Demand& demand = *result.demand_;
  demand.field = field;
  const int level = result.square_level();
  for (int l = level; l < result.n_levels(); ++l) {
    demand.states.emplace_back(static_cast<std::size_t>(result.at(l).n_rows * result.at(l).n_cols));
  }
  const std::int64_t n_cols = result.at(level).n_cols;
  demand.squares.resize(demand.states.front().size());
  for_each_job({threads, cancel, {}}, result.at(level).n_rows, [&](int, std::int64_t i) {
    const auto first = static_cast<std::size_t>(i * n_cols);
    const auto is_known = [&](std::int64_t j) {
      return !known.empty() && known[first + static_cast<std::size_t>(j)].origins != 0;
    };
    std::vector<Extent> squares;
    for (std::int64_t j = 0; j < n_cols;) {
      const std::int64_t begin = j;
      for (squares.clear(); j < n_cols && !is_known(j); ++j) squares.push_back(result.extent(level, i, j));
      if (!squares.empty()) summarize(field, squares, &demand.squares[first + static_cast<std::size_t>(begin)]);
      for (; j < n_cols && is_known(j); ++j) {
        demand.squares[first + static_cast<std::size_t>(j)] = known[first + static_cast<std::size_t>(j)];
      }
    }
  });
  return result;
}

PostSummary PostBlocks::summary(int level, std::int64_t i, std::int64_t j) const {
  if (is_on_demand() && level == square_level()) {
    return demand_->squares[static_cast<std::size_t>(i * at(level).n_cols + j)];
  }
  const PostBlockSums& s = sums(level, i, j);
  PostSummary result{s.min_height_m, s.max_height_m, s.n_source, 0};
  result.origins = block(level, i, j).origins;
  return result;
}

// A block waits for finer ones alone, so nobody waits for ever.
void PostBlocks::make(int level, std::int64_t i, std::int64_t j) const {
  const int least = square_level();
  if (level < least) {
    i >>= least - level;
    j >>= least - level;
    level = least;
  }
  auto& states = demand_->states[static_cast<std::size_t>(level - least)];
  std::atomic<std::uint8_t>& state = states[static_cast<std::size_t>(i * at(level).n_cols + j)];
  std::uint8_t now = state.load(std::memory_order_acquire);
  if (now == kMade) return;
  if (now != kNone || !state.compare_exchange_strong(now, kBeingMade, std::memory_order_acquire)) {
    for (; now != kMade; now = state.load(std::memory_order_acquire)) state.wait(now, std::memory_order_acquire);
    return;
  }
  if (level > least) {
    const Level& finer = at(level - 1);
    for (std::int64_t ci = 2 * i; ci < std::min(2 * i + 2, finer.n_rows); ++ci) {
      for (std::int64_t cj = 2 * j; cj < std::min(2 * j + 2, finer.n_cols); ++cj) make(level - 1, ci, cj);
    }
    merge_children(level, i, j);
  } else {
    for (int l = 0; l <= level; ++l) {
      const std::int64_t n = std::int64_t{1} << (level - l);
      for (std::int64_t bi = i * n; bi < std::min((i + 1) * n, at(l).n_rows); ++bi) {
        for (std::int64_t bj = j * n; bj < std::min((j + 1) * n, at(l).n_cols); ++bj) {
          if (l == 0) {
            fit_leaf(demand_->field, bi, bj);
          } else {
            merge_children(l, bi, bj);
          }
        }
      }
    }
  }
  state.store(kMade, std::memory_order_release);
  state.notify_all();
}

}  // namespace tind
