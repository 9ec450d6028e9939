// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cstdint>
#include <cstdio>
#include <optional>
#include <string>
#include <vector>

#include "core/drainage/compare.hpp"
#include "core/result.hpp"
#include "storage/report/bilinear_raster.hpp"
#include "storage/builder/rebuild_options.hpp"
#include "storage/report/surface_sampler.hpp"

namespace tind {

/// What a report is asked for.
struct ReportOptions {
  std::string pyramid;  ///< The `.tind` file.
  SourceHints source;   ///< inputs: the pyramid's source files.
  bool bilinear = false;
  bool streams = true;
  std::string unconstrained;  ///< A `.tind` file built without lines; empty: built here when the pyramid has lines.
  std::optional<std::int64_t> drainage_cells;  ///< For the thresholds of streams; default: what the pyramid was built
  std::optional<double> drainage_growth;       ///< with, or would be.
  std::optional<int> first_level, last_level;  ///< Default: see PyramidReport::levels.
  double buffer_cells = 2;
  std::optional<int> picture_level;  ///< Whose hill-shade is wanted; default: the coarsest with 3000 points.
  bool picture = false;
  int threads = 0;                            ///< 0: all cores.
  const std::atomic<bool>* cancel = nullptr;  ///< Set by a signal handler.
};

/// One surface of one level.
struct SurfaceFigures {
  std::uint64_t n_points = 0;  ///< Vertices, or nodes of a raster, in the data.
  SurfaceErrors errors;
  std::optional<StreamMatch> streams;
  std::optional<RasterShape> shape;  ///< Of a raster.
};

struct LevelReport {
  int level = 0;
  double tolerance_m = 0, spacing_m = 0;
  SurfaceFigures tin;
  std::uint64_t n_void_points = 0;     ///< Further vertices of the TIN in interior voids.
  std::uint64_t n_outside_points = 0;  ///< And beyond the data.
  std::uint64_t n_missed_posts = 0;    ///< Posts that no tile of the level holds.
  double manifest_rmse_m = 0, manifest_max_error_m = 0;
  std::uint64_t manifest_posts = 0;  ///< Measured by the builder.
  std::optional<SurfaceFigures> unconstrained;
  std::optional<SurfaceFigures> same_spacing;  ///< Bilinear raster with the level's spacing.
  std::optional<SurfaceFigures> same_points;   ///< Bilinear raster with as many points as the TIN.
  std::optional<SurfaceErrors> native;         ///< Of the TIN at the cells of a projected source.
  std::optional<double> stream_cells;          ///< Area from which on there is a stream, in cells.
};

/// A window of heights for a picture, row 0 southernmost; NaN where there is no data.
struct PictureWindow {
  int level = 0;
  std::int64_t n_rows = 0, n_cols = 0;
  double east_m = 0, north_m = 0;  ///< Between posts.
  std::vector<float> source_m, tin_m;
};

/// The paper's Table 1 for one pyramid.
struct PyramidReport {
  std::string name;  ///< File name without folder and ending.
  std::string source_kind;
  std::vector<std::string> source_names;
  std::uint64_t n_posts = 0;
  std::int64_t n_rows = 0, n_cols = 0;  ///< The grid's rectangle around the data.
  std::uint64_t n_native_left_out = 0;  ///< Cells of a projected source beside voids or on the rim.
  double area_km2 = 0;
  double bottom_tolerance_m = 0;
  double buffer_cells = 0;
  bool has_lines = false;
  std::vector<LevelReport> levels;  ///< Coarse to fine; by default those with at least 8 spacings along the data.
  std::vector<std::string> notes;   ///< Warnings and what was left out.
  std::optional<PictureWindow> window;

  double percent_of_posts(const SurfaceFigures& figures) const;
  double points_per_km2(const SurfaceFigures& figures) const;
};

/// Measures a pyramid against its source; tells how far it is on `progress`, if that is not null. The figures do not
/// depend on `threads`. Errors name the file, what is wrong and what to try.
Result<PyramidReport> measure_pyramid(const ReportOptions& options, std::FILE* progress);

}  // namespace tind
