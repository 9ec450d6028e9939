// SPDX-License-Identifier: GPL-3.0-or-later
#include <algorithm>
#include <array>
#include <atomic>
#include <vector>

#include "core/drainage/block_schedule.hpp"
#include "core/drainage/flow.hpp"

namespace tind {
namespace {

constexpr int kCountShift = 4;        // inflows still to come, above the direction
constexpr std::uint8_t kDone = 0xf0;  // no post has 15 inflows
constexpr std::uint8_t kOneInflow = std::uint8_t{1} << kCountShift;

/// `counts` (n_cols) becomes kOneInflow times the number of posts that flow into each post of a row.
void count_inflows(const FlowGrid& g, std::int64_t r, const std::uint8_t* directions, std::uint8_t* counts) {
  const auto count = [&](std::int64_t c) {
    int sum = 0;
    for (int d = 0; d < 8; ++d) {
      // The post in direction d flows here iff its direction is the opposite one.
      const std::int64_t n = g.neighbour(r, c, d);
      if (n >= 0 && (directions[n] & kDirection) == (d + 4) % 8) sum += kOneInflow;
    }
    return static_cast<std::uint8_t>(sum);
  };
  if (r == 0 || r + 1 == g.n_rows || g.n_cols < 3) {
    for (std::int64_t c = 0; c < g.n_cols; ++c) counts[c] = count(c);
    return;
  }
  std::fill_n(counts, g.n_cols, std::uint8_t{0});
  for (std::size_t k = 0; k < 8; ++k) {
    const std::uint8_t* const at = directions + (r + kStepRows[k]) * g.n_cols + kStepCols[k];
    const auto opposite = static_cast<std::uint8_t>((k + 4) % 8);
    for (std::int64_t c = 1; c + 1 < g.n_cols; ++c) {
      const std::uint8_t add = (at[c] & kDirection) == opposite ? kOneInflow : std::uint8_t{0};
      counts[c] = static_cast<std::uint8_t>(counts[c] + add);
    }
  }
  counts[0] = count(0);
  counts[g.n_cols - 1] = count(g.n_cols - 1);
}

}  // namespace

void accumulate_flow(const FlowGrid& g, std::int64_t block_side, std::uint8_t* directions, std::uint64_t* accumulation,
                     const FlowRun& run) {
  const FlowRun quiet = run.quiet();
  for_row_bands(quiet, g.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
    for (std::int64_t r = row_begin; r < row_end; ++r) {
      const std::uint64_t share = g.share[static_cast<std::size_t>(r)];
      for (std::int64_t i = r * g.n_cols; i < (r + 1) * g.n_cols; ++i) {
        directions[i] &= kDirection;
        accumulation[i] = directions[i] == kNoFlow ? 0 : share;
      }
    }
  });
  for_row_bands(quiet, g.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
    std::vector<std::uint8_t> counts(static_cast<std::size_t>(g.n_cols));
    for (std::int64_t r = row_begin; r < row_end; ++r) {
      count_inflows(g, r, directions, counts.data());
      std::uint8_t* const row = directions + r * g.n_cols;
      for (std::int64_t c = 0; c < g.n_cols; ++c) {
        row[c] = static_cast<std::uint8_t>(row[c] | counts[static_cast<std::size_t>(c)]);
      }
    }
  });
  std::array<std::int64_t, 8> step{};
  for (std::size_t k = 0; k < 8; ++k) step[k] = kStepRows[k] * g.n_cols + kStepCols[k];
  std::atomic<std::int64_t> n_done{0};
  BlockSchedule schedule(g.n_rows, g.n_cols, g.wraps, block_side);
  const auto visit_block = [&](int, BlockSchedule::Visit& visit) {
    std::int64_t n_passed = 0;
    // A post whose inflows are all in passes its sum on; so does the next one, for as long as that completes it.
    const auto walk = [&](std::int64_t r, std::int64_t c) {
      std::int64_t i = r * g.n_cols + c;
      while (directions[i] >> kCountShift == 0) {
        const int d = directions[i];
        directions[i] |= kDone;
        ++n_passed;
        if (d >= 8) return;
        r += kStepRows[static_cast<std::size_t>(d)];
        c += kStepCols[static_cast<std::size_t>(d)];
        std::int64_t n = i + step[static_cast<std::size_t>(d)];
        if (c < 0 || c >= g.n_cols) {  // only where the grid wraps
          c = c < 0 ? g.n_cols - 1 : 0;
          n = r * g.n_cols + c;
        }
        accumulation[n] += accumulation[i];
        directions[n] = static_cast<std::uint8_t>(directions[n] - kOneInflow);
        i = n;
        if (!visit.contains(r, c)) {
          if (directions[n] >> kCountShift == 0) visit.hand_over(r, c);
          return;
        }
      }
    };
    if (visit.first) {
      for (std::int64_t r = visit.row_begin; r < visit.row_end; ++r) {
        for (std::int64_t c = visit.col_begin; c < visit.col_end; ++c) walk(r, c);
      }
    }
    for (const BlockPlace at : visit.places) walk(visit.row(at), visit.col(at));
    n_done += n_passed;
  };
  schedule.run(run, visit_block, [&] { run.report(n_done, g.size()); });
  for_row_bands(quiet, g.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
    for (std::int64_t i = row_begin * g.n_cols; i < row_end * g.n_cols; ++i) directions[i] &= kDirection;
  });
}

}  // namespace tind
