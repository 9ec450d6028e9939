// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/surface_lines.hpp"

#include <utility>

#include "storage/readers/scratch_map.hpp"

namespace tind {
namespace {

// Lines follow the terrain to half a post spacing of their level.
constexpr double kPlanShare = 0.5;

}  // namespace

Result<SurfaceLines> make_surface_lines(const HeightField& field, const LevelTable& table, const LineOptions& options,
                                        const std::string& scratch_dir) {
  SurfaceLines lines;
  std::vector<BreakChain> chains;
  if (options.drainage) {
    DrainageOptions drainage_options;
    drainage_options.cells = options.drainage_cells;
    drainage_options.growth = options.drainage_growth;
    drainage_options.lake_area_m2 = options.lake_area_m2;
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
  std::vector<LineDetail> detail;
  for (const LevelSpec& level : table.levels) detail.push_back({level.spacing_m * kPlanShare, level.tolerance_m});
  lines.pyramid = LinePyramid(field.lattice, chains, detail);
  for (const auto& line : lines.pyramid.polylines(table.bottom_level())) lines.counts.vertices += line.size();
  return lines;
}

}  // namespace tind
