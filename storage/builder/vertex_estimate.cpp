// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/vertex_estimate.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/border_line.hpp"
#include "core/triangulator.hpp"
#include "storage/builder/border_lines.hpp"
#include "storage/builder/ordered_pipeline.hpp"
#include "storage/builder/plan.hpp"
#include "storage/builder/tile_posts.hpp"

namespace tind {
namespace {

constexpr std::size_t kSampleTiles = 12;

// Vertices of a tile that is built alone, each border counted half.
double vertices_of(const HeightField& field, const RefinementSpec& spec, const TileKey& key) {
  const std::int64_t side = field.lattice.tile_side(key.level), west = side * key.x, south = side * key.y;
  TileTask task;
  task.key = key;
  task.tolerance_m = spec.tolerance_m.back();
  task.height_step_m = spec.height_step_m.back();
  double on_border = 0;
  for (int b = 0; b < 4; ++b) {
    const bool vertical = b % 2 == 1;
    RootEdge root{vertical, key.level, 0, vertical ? south : west};
    root.at = b == 0 ? south : b == 1 ? (west + side) % field.lattice.width() : b == 2 ? south + side : west;
    const auto line = refine_root_edge(field, spec, root, {}, {}, [](int, std::int64_t) { return false; });
    set_border(field.lattice, line, b, task);
    on_border += static_cast<double>(task.borders[static_cast<std::size_t>(b)].size() - 1) / 2;
  }
  return 1 + on_border + static_cast<double>(triangulate(field, task).n_inserted);
}

}  // namespace

double estimate_bottom_vertices(const HeightField& field, const LevelTable& table, int threads) {
  const int bottom = table.bottom_level();
  const TilePlan plan(field, bottom);
  RefinementSpec spec;
  for (const LevelSpec& level : table.levels) {
    spec.tolerance_m.push_back(level.tolerance_m);
    spec.seed_segments.push_back(1);
    spec.height_step_m.push_back(field.lattice.height_unit_m());
  }
  std::vector<TileKey> tiles;
  for (const TileKey& tile : plan.tiles(bottom)) {
    if (coverage_of(field, tile) != TileCoverage::kFiller) tiles.push_back(tile);
  }
  const std::size_t n = std::min(tiles.size(), kSampleTiles);
  double sum = 0;
  const auto prepare = [&](std::size_t i) { return tiles[(2 * i + 1) * tiles.size() / (2 * n)]; };
  const auto work = [&](TileKey&& key) { return vertices_of(field, spec, key); };
  const auto consume = [&](std::size_t, double&& vertices) {
    sum += vertices;
    return true;
  };
  run_ordered<TileKey, double>(n, threads, prepare, work, consume);
  return n > 0 ? std::max(1.0, sum / static_cast<double>(n) * static_cast<double>(tiles.size())) : 1;
}

}  // namespace tind
