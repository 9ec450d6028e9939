// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/surface_lines.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "storage/builder/tile_posts.hpp"
#include "storage/builder/vertex_estimate.hpp"

#include "storage/readers/scratch_map.hpp"

namespace tind {
namespace {

// How closely lines are drawn in plan: on a slope of one in two, two tolerances to the side are one in height; beyond a
// few posts a line would leave its valley (docs/decisions/0007-drainage.md has the figures).
constexpr double kPlanTolerances = 2;
constexpr double kMostPlanPosts = 3;
constexpr double kLeastPlanPosts = 0.5;

std::vector<LineDetail> details_of(const HeightField& field, const LevelTable& table) {
  const double post_m =
      field.dy * field.lattice.step_deg() * std::numbers::pi / 180 * field.lattice.ellipsoid.semi_major_m;
  std::vector<LineDetail> detail;
  for (const LevelSpec& level : table.levels) {
    const double plan_m =
        std::clamp(kPlanTolerances * level.tolerance_m, kLeastPlanPosts * post_m, kMostPlanPosts * post_m);
    detail.push_back({plan_m, level.tolerance_m});
  }
  return detail;
}

// Sets what the user left open by how many posts stand behind a vertex of the bottom level.
void choose_sizes(const HeightField& field, const LevelTable& table, const LineOptions& options, int threads,
                  SurfaceLines& lines) {
  lines.drainage_cells = options.drainage_cells.value_or(0);
  lines.lake_area_m2 = options.lake_area_m2.value_or(0);
  if (options.drainage_cells && options.lake_area_m2) return;
  std::int64_t n_posts = 0;
  double area_m2 = 0;
  const double post_m =
      field.dy * field.lattice.step_deg() * std::numbers::pi / 180 * field.lattice.ellipsoid.semi_major_m;
  for (std::int64_t r = 0; r < field.n_rows; ++r) {
    std::int64_t n = 0;
    for (std::int64_t c = 0; c < field.n_cols; ++c) n += is_of_source(field.origin_at(r, c));
    n_posts += n;
    const double latitude = (field.post_y(r) * field.lattice.step_deg() - 90) * std::numbers::pi / 180;
    area_m2 += static_cast<double>(n) * post_m * post_m * (field.dx / field.dy) * std::max(0.0, std::cos(latitude));
  }
  const double vertices = estimate_bottom_vertices(field, table, threads);
  if (!options.drainage_cells) {
    const double cells = kCellsPerVertex * static_cast<double>(n_posts) / vertices;
    lines.drainage_cells = std::max<std::int64_t>(1, std::llround(cells));
  }
  if (!options.lake_area_m2) {
    lines.lake_area_m2 = std::round(std::max(DrainageOptions().lake_area_m2, kLakePerVertex * area_m2 / vertices));
  }
}

}  // namespace

Result<SurfaceLines> make_surface_lines(const HeightField& field, const LevelTable& table, const LineOptions& options,
                                        const std::string& scratch_dir, int threads) {
  SurfaceLines lines;
  std::vector<BreakChain> chains;
  if (options.drainage) {
    DrainageOptions drainage_options;
    choose_sizes(field, table, options, threads, lines);
    drainage_options.cells = lines.drainage_cells;
    drainage_options.growth = options.drainage_growth;
    drainage_options.lake_area_m2 = lines.lake_area_m2;
    drainage_options.sea_level_m = options.sea_level_m;
    drainage_options.bottom_level = table.bottom_level();
    // Nested vertices keep their height on every finer level, so the finest tolerance bounds what may be moved.
    drainage_options.max_change_m = table.levels.back().tolerance_m / 2;
    for (const LevelSpec& level : table.levels) drainage_options.deviation_limits_m.push_back(level.tolerance_m / 2);
    std::vector<ScratchMap> scratch;
    std::string scratch_error;
    const auto allocate = [&](std::size_t n_bytes) -> void* {
      auto map = ScratchMap::create(scratch_dir, n_bytes);
      if (!map) {
        scratch_error = map.error().message;
        return nullptr;
      }
      scratch.push_back(std::move(*map));
      return scratch.back().data();
    };
    auto drainage = derive_drainage(field, drainage_options, allocate);
    if (!drainage) {
      if (!scratch_error.empty()) return fail(ErrorKind::kIo, scratch_error);
      return tl::unexpected(drainage.error());
    }
    lines.drainage = drainage->counts;
    lines.counts.streams = drainage->streams.size();
    lines.counts.shores = drainage->shores.size();
    chains = std::move(drainage->streams);
    chains.insert(chains.end(), drainage->shores.begin(), drainage->shores.end());
  }
  if (chains.empty()) return lines;
  lines.pyramid = LinePyramid(field.lattice, chains, details_of(field, table));
  for (const auto& line : lines.pyramid.polylines(table.bottom_level())) lines.counts.vertices += line.size();
  return lines;
}

}  // namespace tind
