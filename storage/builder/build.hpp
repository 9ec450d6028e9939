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
  const std::atomic<bool>* cancel = nullptr;  ///< Set by a signal handler: stop, leave nothing behind.
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
};

/// Builds the pyramid of `options.source.inputs` into `options.output`: under a temporary name beside it, synced, then
/// renamed. On any failure an earlier output is left untouched and nothing new stays behind. The same input and options
/// give the same bytes for any number of threads.
Result<BuildReport> build_pyramid(const BuildOptions& options, Progress& progress);

}  // namespace tind
