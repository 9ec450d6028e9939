// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <vector>

#include "core/drainage/flow_grid.hpp"
#include "core/drainage/flow_run.hpp"

namespace tind {

/// Side of the square blocks of posts in which the steps below work, unless told otherwise. Results do not depend on
/// it: each step has one answer (docs/decisions/0007-drainage.md). Heap use is what one block needs at a time.
inline constexpr std::int64_t kBlockSide = 256;

/// Fills depressions: `filled_m` (n_rows * n_cols) becomes the lowest surface >= heights_m from every post of which a
/// path that never rises leads to an outlet (Priority-Flood: Barnes, Lehman, Mulla 2014,
/// doi:10.1016/j.cageo.2013.04.024). Minus infinity at posts that take no part. Precondition: mark_outlets was called;
/// 1 <= block_side <= 32768.
void fill_depressions(const FlowGrid& grid, std::int64_t block_side, float* filled_m, const FlowRun& run = {});

/// Distances across a flat, for the directions in it, in steps between posts: 20 bits and 12 bits of one word.
class FlatSteps {
 public:
  static constexpr std::uint32_t kFarToward = 0xfffff;  ///< That many steps or more.
  static constexpr std::uint32_t kFarAway = 0xfff;

  FlatSteps() = default;
  /// toward_lower <= kFarToward, away_from_higher <= kFarAway.
  FlatSteps(std::uint32_t toward_lower, std::uint32_t away_from_higher)
      : word_(toward_lower << 12 | away_from_higher) {}
  std::uint32_t toward_lower() const { return word_ >> 12; }           ///< To where the flat drains.
  std::uint32_t away_from_higher() const { return word_ & kFarAway; }  ///< From higher ground.

 private:
  std::uint32_t word_ = 0;
};

/// D8: `directions` (n_rows * n_cols) becomes each post's neighbour of steepest descent on the filled surface, metres
/// over metres, the first in kTieOrder where several are equal; kLeaves at outlets without a lower neighbour and at the
/// sea; kNoFlow at posts that take no part. A post of a flat goes to the neighbour in the flat with the least
/// 2 * toward_lower - away_from_higher, and to a draining one first (Barnes, Lehman, Mulla 2014,
/// doi:10.1016/j.cageo.2013.01.009). Two
/// flows never cross diagonally between the same four posts: a diagonal wins only where it is steeper than both sides
/// of its square, which cannot hold for both of them. Beyond kFarAway steps from higher ground a flat's posts are
/// equally far; kFarToward steps from where it drains it drains at once (kLeaves). Sets or clears kInFlat. `steps`
/// (n_rows * n_cols) is scratch. Returns the number of posts in flats.
std::int64_t direct_flow(const FlowGrid& grid, std::int64_t block_side, const float* filled_m, FlatSteps* steps,
                         std::uint8_t* directions, const FlowRun& run = {});

/// `accumulation` (n_rows * n_cols) becomes the area that drains through each post, itself included, in units of
/// 1 / kCell cells; 0 at posts that take no part. Uses the upper bits of `directions` on its way and clears them.
void accumulate_flow(const FlowGrid& grid, std::int64_t block_side, std::uint8_t* directions,
                     std::uint64_t* accumulation, const FlowRun& run = {});

/// The flow over a plain grid of posts of one size, with its own arrays. All arrays n_rows x n_cols, row-major, row 0
/// southernmost.
struct Flow {
  std::int64_t n_rows = 0, n_cols = 0;
  std::vector<float> filled_m;           ///< Minus infinity where no height was given.
  std::vector<std::uint8_t> directions;  ///< 0..7, kLeaves, kNoFlow.
  std::vector<double> cells;             ///< Number of posts that drain through a post, itself included.
  std::vector<std::uint8_t> in_flat;     ///< 1 where the filled surface is flat.
  std::vector<std::uint8_t> raised;      ///< 1 where filling raised the post.
};

/// Fills, directs and accumulates. `heights_m`: n_rows * n_cols, NaN where there is no post; `east_m`, `north_m`:
/// metres between posts. All the memory is on the heap: some 25 bytes a post.
Flow flow_of(const float* heights_m, std::int64_t n_rows, std::int64_t n_cols, double east_m, double north_m);

/// 1 at the posts through which at least `min_cells` drain: n_rows * n_cols.
std::vector<std::uint8_t> channel_mask(const Flow& flow, double min_cells);

}  // namespace tind
