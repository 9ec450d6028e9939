// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "core/drainage/flow_grid.hpp"
#include "core/drainage/flow_run.hpp"
#include "core/result.hpp"

namespace tind {

/// One stretch of stream between two nodes, as posts.
struct StreamLink {
  std::vector<std::int64_t> posts;  ///< Indices, downstream; at least 2.
  std::vector<double> heights_m;    ///< Conditioned, one per post.
  int first_level = 0;              ///< Coarsest level that draws it.
  int strahler = 1;                 ///< Order in the network of the bottom level's threshold.
  std::uint64_t accumulation = 0;   ///< Where it ends (before what joins there), in 1 / kCell cells.
};

/// How conditioning went.
struct StreamCounts {
  std::int64_t channel_posts = 0;  ///< Posts above the bottom level's threshold.
  std::int64_t stream_posts = 0;   ///< Of those, posts that a stream runs over: not in the sea, lakes, voids, basins.
  std::int64_t deep_posts = 0;     ///< Of those, posts in pits too deep to condition: they keep their heights.
  std::int64_t clamped = 0;        ///< Posts whose conditioned height was cut off at the largest change allowed.
  std::int64_t uphill_steps = 0;   ///< Steps of streams that still run uphill.
  double largest_uphill_m = 0;
  double largest_deviation_m = 0;              ///< Of a conditioned height from the post's own, before clamping.
  std::vector<std::int64_t> deviations_above;  ///< Posts that deviate more (before clamping), for each limit asked.
};

struct StreamNetwork {
  /// Per link: the one that its water enters next, also beyond a lake or a void; -1 none.
  std::vector<std::int64_t> downstream;
  StreamCounts counts;
};

struct StreamOptions {
  /// Smallest accumulation of a stream at each level, in 1 / kCell cells, index = level: descending (not strictly).
  std::vector<std::uint64_t> thresholds;
  double max_change_m = 0;
  std::vector<double> deviation_limits_m;
};

/// Streams over a grid whose flow is known: posts at or above the last threshold, split where streams meet, where a
/// coarser level begins to draw them, and at lakes. A stream ends with the first post of the sea or of a lake, and
/// begins with a lake's last one, so it meets the shore in a post; it ends before a void or a basin.
///
/// Heights run downhill: z* = (max downstream-inclusive + min upstream-inclusive) / 2 over the connected streams, lakes
/// and sea being ends with their own heights; then clamped to the post's own +- max_change_m. Posts that filling raised
/// by more than 2 * max_change_m keep their own height and divide the streams for conditioning; between them
/// |z* - z| <= max_change_m follows, so nothing is clamped but for rounding (docs/decisions/0007-drainage.md).
///
/// `directions`, `accumulation`: size() each, from direct_flow and accumulate_flow; posts filled too deep are marked
/// kDeep. Takes some 30 bytes per channel post from `scratch`. `take` is called for each link in ascending order of
/// first post; the link is valid until it returns. kIo: no scratch; kInvalidInput: 2^32 channel posts or more.
Result<StreamNetwork> find_streams(const FlowGrid& grid, const std::uint8_t* directions,
                                   const std::uint64_t* accumulation, const StreamOptions& options,
                                   const ScratchAllocator& scratch, const FlowRun& run,
                                   const std::function<void(const StreamLink&)>& take);

}  // namespace tind
