// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/level_tally.hpp"

#include <algorithm>
#include <cmath>

#include "core/level_spec.hpp"

namespace tind {

LevelInfo uncounted(const LevelInfo& level) {
  LevelInfo info;
  info.level = level.level;
  info.tolerance_m = level.tolerance_m;
  info.spacing_m = level.spacing_m;
  info.height_step_m = level.height_step_m;
  return info;
}

LevelTally::LevelTally(LevelInfo info, double semi_major_m)
    : info_(std::move(info)),
      seeds_per_axis_(static_cast<std::uint64_t>(seed_segments(info_.level, info_.tolerance_m, semi_major_m) - 1)) {}

void LevelTally::add_corner(std::size_t n_bytes) {
  ++info_.n_border_vertices;
  info_.bytes += n_bytes;
}

void LevelTally::add_edge(std::size_t n_inner, std::size_t n_bytes) {
  info_.n_border_vertices += n_inner;
  info_.n_seed_vertices += seeds_per_axis_;
  info_.bytes += n_bytes;
}

void LevelTally::add_body(const TileKey& key, const TileStats& stats, std::uint64_t n_interior,
                          std::uint64_t n_triangles, std::size_t n_bytes) {
  ++info_.n_tiles;
  info_.n_vertices += n_interior;
  info_.n_seed_vertices += seeds_per_axis_ * seeds_per_axis_;
  info_.n_triangles += n_triangles;
  info_.n_posts += stats.n_posts;
  info_.max_error_m = std::max(info_.max_error_m, static_cast<double>(stats.max_error_m));
  squares_ += static_cast<double>(stats.rmse_m) * stats.rmse_m * static_cast<double>(stats.n_posts);
  info_.bytes += n_bytes;
  coverage_[{key.y, key.x}] = stats.coverage;
}

LevelInfo LevelTally::finish() {
  LevelInfo info = info_;
  info.n_vertices += info.n_border_vertices;
  info.rmse_m = info.n_posts ? std::sqrt(squares_ / static_cast<double>(info.n_posts)) : 0;
  for (const auto& [position, kind] : coverage_) {
    const auto [y, x] = position;
    ++(kind == TileCoverage::kReal ? info.n_real : kind == TileCoverage::kPartial ? info.n_partial : info.n_filler);
    if (!info.rows.empty() && info.rows.back().y == y && info.rows.back().x_last + 1 == x &&
        info.rows.back().coverage == kind) {
      info.rows.back().x_last = x;
    } else {
      info.rows.push_back({y, x, x, kind});
    }
  }
  return info;
}

}  // namespace tind
