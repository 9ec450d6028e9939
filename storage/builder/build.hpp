// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/level_spec.hpp"
#include "core/result.hpp"
#include "storage/builder/elevation_source.hpp"
#include "storage/builder/progress.hpp"
#include "storage/builder/pyramid_builder.hpp"
#include "storage/builder/surface_lines.hpp"
#include "storage/manifest.hpp"

namespace tind {

inline constexpr int kMostShards = 65536;

/// Everything that tind-build can be told.
struct BuildOptions {
  SourceOptions source;
  std::string output;
  bool force = false;   ///< Replace an output that exists.
  LevelOptions levels;  ///< metres_per_degree and irregular_posts are set by the builder.
  /// Where spacing in metres is taken for the 4/5 rule.
  enum class Metres {
    kAuto,         ///< The source's own metres where it has them (projected, points), else as kEquator.
    kEquator,      ///< Degrees of longitude on the equator.
    kMidLatitude,  ///< Degrees of longitude at the source's middle latitude.
  } metres = Metres::kAuto;
  LineOptions lines;
  double base_height_m = 0;
  int falloff_posts = 64;
  std::string attribution;
  int threads = 0;                                        ///< 0: all cores.
  std::uint64_t memory_bytes = std::uint64_t{512} << 20;  ///< What the whole process may hold in memory.
  bool resume = false;                                    ///< Go on where an interrupted build of the same stopped.
  /// One of several parts of a pyramid that are built apart and merged; 0 <= index < count <= kMostShards.
  struct Shard {
    int index = 0;
    int count = 1;
  };
  std::optional<Shard> shard;
  /// An earlier pyramid to take over what was made of the same inputs from; it may be the output itself. Empty: none.
  std::string earlier;
  const std::atomic<bool>* cancel = nullptr;  ///< Set by a signal handler: stop soon.
};

struct BuildReport {
  Manifest manifest;
  SourceCounts counts;
  std::int64_t drainage_cells = 0;  ///< As used; 0: no drainage.
  DrainageCounts drainage;
  BreakLineCounts given;  ///< Of the user's lines.
  std::vector<LevelBreakdown> breakdown;
  std::uint64_t file_bytes = 0;
  double seconds = 0;
  double read_seconds = 0;
  double line_seconds = 0;
  int threads = 0;
  bool is_copy = false;  ///< The file is a copy of the earlier one, changed in places; else it was written anew.
  /// With BuildOptions::earlier: tiles that are served otherwise than before or not at all any more, by level, then in
  /// Morton order.
  std::vector<TileKey> changed_tiles;
};

/// Builds the pyramid of `options.source.inputs` into `options.output`: under a temporary name beside it, synced, then
/// renamed. On any failure an earlier output is left untouched; work that had begun to be stored stays behind for
/// BuildOptions::resume. The same input and options give the same bytes for any number of threads, any interruption and
/// any earlier pyramid. kInterrupted when cancelled.
Result<BuildReport> build_pyramid(const BuildOptions& options, Progress& progress);

}  // namespace tind
