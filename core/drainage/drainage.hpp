// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "core/break_line.hpp"
#include "core/drainage/flow.hpp"
#include "core/height_field.hpp"
#include "core/result.hpp"

namespace tind {

struct DrainageOptions {
  /// Area from which on a stream is drawn at the bottom level, in cells (posts at the middle latitude of the data);
  /// >= 1. The default keeps the cost below 10 % more vertices on 30 m mountains (docs/decisions/0007-drainage.md).
  std::int64_t cells = 3200;
  double growth = 4;             ///< That area grows by this factor per coarser level; >= 1.
  double lake_area_m2 = 250000;  ///< Core area of the smallest lake drawn at the bottom level; >= 0.
  /// Everything at or below is the sea. Without it bodies of posts at or below 0 m with kSeaAreaM2 or more are.
  std::optional<double> sea_level_m;
  int bottom_level = 0;     ///< >= 0; chains get levels 0..bottom_level.
  double max_change_m = 0;  ///< Conditioning moves no height by more than this; E_bottom / 2 is sound. >= 0.
  std::vector<double> deviation_limits_m;  ///< For DrainageCounts::deviations_above, e.g. E_L / 2 per level.
  std::int64_t block_side = kBlockSide;    ///< Posts along a block; bounds the heap, changes no result. 1..32768
  /// Memory for vertices of streams, alive as long as they are looked at; empty, or where it gives none: the heap.
  ScratchAllocator kept;
  FlowRun run;  ///< Threads, cancel flag, progress of the whole; changes no result.
};

struct DrainageCounts {
  std::int64_t posts = 0;         ///< Posts that take part.
  std::int64_t filled_posts = 0;  ///< Raised by filling.
  std::int64_t flat_posts = 0;    ///< In flats of the filled surface.
  std::int64_t sea_posts = 0;
  std::int64_t lakes = 0;
  std::int64_t lake_posts = 0;
  std::int64_t basin_posts = 0;    ///< In depressions too deep and wide to carry streams.
  std::int64_t channel_posts = 0;  ///< At or above the bottom level's threshold.
  std::int64_t stream_posts = 0;   ///< Of those, posts that carry a stream.
  std::int64_t deep_posts = 0;  ///< Of those, posts in narrow pits deeper than 2 max_change_m: they keep their height.
  std::int64_t clamped = 0;     ///< Heights that wanted to move by more than max_change_m.
  std::int64_t uphill_steps = 0;  ///< Steps of streams that run uphill after all (deep pits, lakes, clamping).
  double largest_uphill_m = 0;
  double largest_deviation_m = 0;              ///< Of a conditioned height from its post's, before clamping.
  std::vector<std::int64_t> deviations_above;  ///< Posts that deviate more, per DrainageOptions::deviation_limits_m.
};

/// The drainage of a height field. `streams` and the three vectors after it are parallel.
/// Vertices are posts (rounded to the lattice); the smallest x of a chain is in [0, lattice width), so a chain across
/// longitude 180 goes on past the width. Chains of both kinds meet in their end vertices alone and never cross.
struct Drainage {
  /// Downstream, conditioned heights (float64: rounding is the caller's); weight = cells that drain through its end.
  /// Ordered by first post (row from the south, then column from the west), then by second.
  std::vector<BreakChain> streams;
  std::vector<int> strahler;             ///< In the network of the bottom level.
  std::vector<double> area_km2;          ///< That drains through its end.
  std::vector<std::int64_t> downstream;  ///< Stream its water enters next, also beyond a lake or a void; -1 none.
  /// Lake shores at the lake's height, the lake on the left; rings repeat their first vertex (one around the globe does
  /// so a lattice width further on). Cut where streams meet them. weight: kShoreWeight + cells of the lake's core.
  /// Drawn from the level on at which the core's area is at least 4^(bottom - L) times the smallest lake's. Ordered by
  /// first post.
  std::vector<BreakChain> shores;
  DrainageCounts counts;
};

/// Shores outweigh streams: a lake is flat where a stream only passes.
inline constexpr double kShoreWeight = 1e12;

/// Streams and lake shores of `field` (docs/decisions/0007-drainage.md). Takes 10 bytes a post and some 30 for each
/// post that carries a stream from `scratch`; its own heap holds a block a thread, the runs of the largest piece of
/// level water, and what it returns. Same result for any block size and number of threads. kInvalidInput: an option out
/// of range, no posts, or posts closer than a lattice step. kIo: no scratch. kInterrupted.
Result<Drainage> derive_drainage(const HeightField& field, const DrainageOptions& options,
                                 const ScratchAllocator& scratch);

}  // namespace tind
