// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "core/level_spec.hpp"
#include "core/result.hpp"
#include "storage/builder/build.hpp"
#include "storage/builder/sample_region.hpp"
#include "storage/builder/sample_window.hpp"

namespace tind {

/// Something about the inputs or the output that the user should know before the work begins.
struct PlanProblem {
  enum class Weight { kNote, kWarning, kError } weight = Weight::kNote;  ///< kError: the build would refuse or fail.
  std::string kind;                                                      ///< A word for programs, e.g. "voids".
  std::string text;                                                      ///< What is wrong.
  std::string advice;                                                    ///< What to do.
};

/// What a build will take and make.
struct Forecast {
  std::string source_kind;  ///< As in the manifest: "raster", "warped", "points".
  std::vector<std::string> sources;
  std::array<double, 4> bounds_deg{};   ///< West, south, east, north.
  std::array<double, 2> spacing_deg{};  ///< Longitude, latitude.
  std::int64_t n_cols = 0, n_rows = 0;  ///< Of the grid of posts; for points the one that is interpolated.
  double posts = 0;                     ///< That the promise is about, as far as they are known.
  LevelTable table;
  std::vector<LevelCost> levels;  ///< Index: level.
  double read_seconds = 0;        ///< Processor time, as the next two.
  double line_seconds = 0;
  double tile_seconds = 0;
  int threads = 1;
  double seconds_one = 0;           ///< Of the whole build, with one thread.
  double seconds = 0;               ///< With `threads`.
  std::uint64_t memory_bytes = 0;   ///< Peak of the process.
  std::uint64_t output_bytes = 0;   ///< Of the pyramid.
  std::uint64_t scratch_bytes = 0;  ///< Working copy of the posts beside it, gone at the end.
  std::int64_t n_regions = 0;       ///< Sample regions built ..
  std::int64_t n_all_regions = 0;   ///< .. of how many.
  bool whole_source_read = false;   ///< Else `signs` is of a sample.
  PostSigns signs;
  std::vector<std::string> notes;  ///< Of the readers.
  std::vector<PlanProblem> problems;

  double total(double LevelCost::*member) const {
    double sum = 0;
    for (const LevelCost& level : levels) sum += level.*member;
    return sum;
  }
};

/// Opens the inputs, builds a few regions spread over the data by roughness and tells what the whole build takes.
/// Rasters of more than kWholePosts posts are read in windows only, so that it takes seconds whatever their size;
/// points are read whole. Needs no output; where one is named it is checked. Failures are those that a build would
/// have.
Result<Forecast> make_forecast(const BuildOptions& options);
inline constexpr std::int64_t kWholePosts = 4'000'000;

}  // namespace tind
