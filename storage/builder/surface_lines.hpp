// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/drainage/drainage.hpp"
#include "core/height_field.hpp"
#include "core/level_spec.hpp"
#include "core/line_pyramid.hpp"
#include "core/result.hpp"
#include "storage/manifest.hpp"
#include "storage/readers/line_writer.hpp"
#include "storage/readers/ogr_lines.hpp"
#include "storage/readers/scratch_map.hpp"

namespace tind {

/// Streams and lakes are drawn where they are large beside the triangles of the level: then they cost about a tenth of
/// its vertices on any terrain (docs/decisions/0007-drainage.md).
inline constexpr double kCellsPerVertex = 44;
inline constexpr double kLakePerVertex = 4;

/// Which lines the surface follows.
struct LineOptions {
  bool drainage = true;
  /// Posts that drain into a stream at the bottom level; absent: kCellsPerVertex times the posts a vertex stands for.
  std::optional<std::int64_t> drainage_cells;
  double drainage_growth = DrainageOptions().growth;  ///< Of that number, per coarser level.
  /// Smallest lake at the bottom level; absent: kLakePerVertex times the area a vertex stands for, or the default of
  /// DrainageOptions where that is more.
  std::optional<double> lake_area_m2;
  std::optional<double> sea_level_m;
  std::vector<BreakLineFile> given;  ///< The user's break lines and lakes.
  std::string lines_out;             ///< GeoPackage to write the lines of every level to; empty: none.
};

/// The lines of a build.
struct SurfaceLines {
  std::vector<ScratchMap> scratch;  ///< Where the pyramid's vertices are.
  LinePyramid pyramid;
  LineCounts counts;
  std::int64_t drainage_cells = 0;  ///< As used.
  double lake_area_m2 = 0;          ///< As used.
  DrainageCounts drainage;
  BreakLineCounts given;
  std::vector<BreakLineSource> given_sources;
  std::vector<OutputLayer> layers;  ///< For LineOptions::lines_out, if it names a file: a layer per level.
  std::vector<std::string> notes;   ///< Lines for the user.
};

/// Derives streams and shores of the field, reads the user's lines, cuts them all at each other, generalises them with
/// the level table. `place`: for the flow's arrays, which are gone when lines are generalised, and then once more for
/// these. `progress(fraction)` is called from this thread while drainage is derived; null `cancel`: cannot be
/// interrupted. `pause`: as FlowRun::before_job. kIo, kInvalidInput, kInterrupted.
Result<SurfaceLines> make_surface_lines(const HeightField& field, const LevelTable& table, const LineOptions& options,
                                        ScratchPlace place, int threads, const std::atomic<bool>* cancel = nullptr,
                                        const std::function<void(double)>& progress = {},
                                        const std::function<void()>& pause = {});

}  // namespace tind
