// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/tile_posts.hpp"

#include <unordered_map>

#include "core/format/quantized_mesh.hpp"

namespace tind {
namespace {

// Smallest power of two s with at most 32767 steps between a tile's lowest and highest height, both rounded outwards.
double height_step_m(double low, double high) {
  double step = kSmallestBorderStepM;
  while (std::ceil(high / step) - std::floor(low / step) > kQuantizedSteps) step *= 2;
  return step;
}

}  // namespace

TileCoverage coverage_of(const HeightField& field, const TileKey& key) {
  const double side = static_cast<double>(field.lattice.tile_side(key.level));
  const double west = side * key.x, south = side * key.y;
  auto r_first = static_cast<std::int64_t>(std::floor((south - field.y0) / field.dy));
  auto r_last = static_cast<std::int64_t>(std::ceil((south + side - field.y0) / field.dy));
  if (field.continues_south) r_first = std::max<std::int64_t>(r_first, 0);
  if (field.continues_north) r_last = std::min(r_last, field.n_rows - 1);
  const bool rows_inside = r_first >= 0 && r_last < field.n_rows;
  bool any = false, all = false;
  const double width = static_cast<double>(field.lattice.width());
  for (const double turn : {-width, 0.0, width}) {
    if (field.wraps && turn != 0.0) continue;
    const auto c_first = static_cast<std::int64_t>(std::floor((west - field.x0 - turn) / field.dx));
    const auto c_last = static_cast<std::int64_t>(std::ceil((west + side - field.x0 - turn) / field.dx));
    bool complete = rows_inside && (field.wraps || (c_first >= 0 && c_last < field.n_cols));
    for (std::int64_t r = std::max<std::int64_t>(r_first, 0); r <= std::min(r_last, field.n_rows - 1); ++r) {
      const std::int64_t c_low = field.wraps ? c_first : std::max<std::int64_t>(c_first, 0);
      const std::int64_t c_high = field.wraps ? c_last : std::min(c_last, field.n_cols - 1);
      for (std::int64_t c = c_low; c <= c_high; ++c) {
        const std::int64_t column = field.wraps ? ((c % field.n_cols) + field.n_cols) % field.n_cols : c;
        const bool is_source = is_of_source(field.origin_at(r, column));
        any = any || is_source;
        complete = complete && is_source;
        if (any && !complete) return TileCoverage::kPartial;
      }
    }
    all = all || complete;
  }
  return all ? TileCoverage::kReal : any ? TileCoverage::kPartial : TileCoverage::kFiller;
}

bool is_outside(const HeightField& field, std::int64_t x, std::int64_t y) {
  const std::int64_t r = std::llround((static_cast<double>(y) - field.y0) / field.dy);
  if (r < 0 || r >= field.n_rows) return true;
  for (const double turn : {-1.0, 0.0, 1.0}) {
    const double shifted = static_cast<double>(x) + turn * static_cast<double>(field.lattice.width());
    std::int64_t c = std::llround((shifted - field.x0) / field.dx);
    if (field.wraps && c == field.n_cols) c = 0;  // the seam's eastern half cell
    if (c < 0 || c >= field.n_cols) continue;
    const PostOrigin origin = field.origin_at(r, c);
    if (is_of_source(origin) || origin == PostOrigin::kFilled) return false;
  }
  return true;
}

std::vector<double> height_steps(const HeightField& field, const TilePlan& plan, double slack_m) {
  struct Range {
    double low, high;
  };
  std::vector<double> steps(static_cast<std::size_t>(plan.bottom_level()) + 1, kSmallestBorderStepM);
  std::unordered_map<TileKey, Range> finer;
  for (int level = plan.bottom_level(); level >= 0; --level) {
    std::unordered_map<TileKey, Range> ranges;
    const double unit = field.lattice.height_unit_m() + slack_m;
    for (const TileKey& tile : plan.tiles(level)) {
      Range range{field.base_height_m, field.base_height_m};
      const auto include = [&range](double low, double high) {
        range = {std::min(range.low, low), std::max(range.high, high)};
      };
      if (level == plan.bottom_level()) {
        for_posts_around(field, tile, [&](std::int64_t r, std::int64_t c) {
          include(field.height_at(r, c), field.height_at(r, c));
        });
        const double side = static_cast<double>(field.lattice.tile_side(level));
        for (const double turn : {0.0, static_cast<double>(field.lattice.width())}) {
          const double west = side * tile.x + turn, south = side * tile.y;
          field.points.for_blocks(west, south, west + side, south + side, [&](const PointPost& p) {
            include(static_cast<double>(p.height_m), static_cast<double>(p.height_m));
          });
        }
      } else if (plan.is_split(tile)) {
        for (int child = 0; child < 4; ++child)
          include(finer.at(tile.child(child)).low, finer.at(tile.child(child)).high);
      }
      double& step = steps[static_cast<std::size_t>(level)];
      step = std::max(step, height_step_m(range.low - unit, range.high + unit));
      ranges.emplace(tile, range);
    }
    finer = std::move(ranges);
  }
  return steps;
}

}  // namespace tind
