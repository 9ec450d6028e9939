// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/tile_posts.hpp"

#include <limits>

#include "core/drainage/flow_run.hpp"
#include "core/format/quantized_mesh.hpp"

namespace tind {
namespace {

// Smallest power of two s with at most 32767 steps between a tile's lowest and highest height, both rounded outwards.
double height_step_m(double low, double high) {
  double step = kSmallestBorderStepM;
  while (std::ceil(high / step) - std::floor(low / step) > kQuantizedSteps) step *= 2;
  return step;
}

constexpr std::uint8_t kOfSource =
    1 << static_cast<int>(PostOrigin::kSource) | 1 << static_cast<int>(PostOrigin::kInterpolated);

struct SourceShare {
  bool is_any = false, is_all = true;
};

// How many of the posts of a window that lie in the grid are of the source.
SourceShare share_of(const HeightField& field, const PostBlocks::Extent& window) {
  SourceShare share;
  const auto is_known = [&] { return share.is_any && !share.is_all; };
  field.visit_posts(
      window,
      [&](int level, std::int64_t i, std::int64_t j, bool inside) {
        if (is_known()) return true;
        const std::uint8_t origins = field.blocks->summary(level, i, j).origins;
        const bool some = (origins & kOfSource) != 0, others = (origins & ~kOfSource) != 0;
        if (some && others && !inside) return false;
        share.is_any = share.is_any || some;
        share.is_all = share.is_all && !others;
        return true;
      },
      [&](std::int64_t r, std::int64_t begin, std::int64_t end) {
        for (std::int64_t c = begin; c < end && !is_known(); ++c) {
          const bool is_source = is_of_source(field.origin_at(r, c));
          share.is_any = share.is_any || is_source;
          share.is_all = share.is_all && is_source;
        }
      });
  return share;
}

// The same where columns are counted around the globe.
SourceShare share_of_ring(const HeightField& field, std::int64_t r_first, std::int64_t r_last, std::int64_t c_first,
                          std::int64_t c_last) {
  const std::int64_t n = field.n_cols, n_rows = r_last - r_first + 1;
  const std::int64_t n_window = std::min(c_last - c_first + 1, n), begin = ((c_first % n) + n) % n;
  const std::int64_t n_east = std::min(n_window, n - begin);
  const SourceShare east = share_of(field, {r_first, begin, n_rows, n_east});
  if (n_east == n_window) return east;
  const SourceShare west = share_of(field, {r_first, 0, n_rows, n_window - n_east});
  return {east.is_any || west.is_any, east.is_all && west.is_all};
}

struct HeightRange {
  double low, high;
  void include(double least, double most) {
    low = std::min(low, least);
    high = std::max(high, most);
  }
};

// Lowest and highest height of the posts of all cells that meet a tile, the base height among them.
HeightRange range_of(const HeightField& field, const TileKey& tile) {
  HeightRange range{field.base_height_m, field.base_height_m};
  for_windows_around(field, tile, [&](const PostBlocks::Extent& window) {
    field.visit_posts(
        window,
        [&](int level, std::int64_t i, std::int64_t j, bool inside) {
          const PostSummary posts = field.blocks->summary(level, i, j);
          const auto low = static_cast<double>(posts.min_height_m), high = static_cast<double>(posts.max_height_m);
          if (low >= range.low && high <= range.high) return true;
          if (inside) range.include(low, high);
          return inside;
        },
        [&](std::int64_t r, std::int64_t begin, std::int64_t end) {
          const float* const row = field.posts_from(r, begin).heights_m;  // a part of a block, so of a page
          float low = row[0], high = low;
          for (std::int64_t c = 1; c < end - begin; ++c) {
            low = row[c] < low ? row[c] : low;
            high = row[c] > high ? row[c] : high;
          }
          range.include(static_cast<double>(low), static_cast<double>(high));
        });
  });
  const double side = static_cast<double>(field.lattice.tile_side(tile.level));
  for (const double turn : {0.0, static_cast<double>(field.lattice.width())}) {
    const double west = side * tile.x + turn, south = side * tile.y;
    field.points.for_blocks(west, south, west + side, south + side, [&](const PointPost& p) {
      range.include(static_cast<double>(p.height_m), static_cast<double>(p.height_m));
    });
  }
  return range;
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
    const SourceShare share = field.wraps
                                  ? share_of_ring(field, r_first, r_last, c_first, c_last)
                                  : share_of(field, {r_first, c_first, r_last - r_first + 1, c_last - c_first + 1});
    const bool complete = share.is_all && rows_inside && (field.wraps || (c_first >= 0 && c_last < field.n_cols));
    any = any || share.is_any;
    all = all || complete;
  }
  return all ? TileCoverage::kReal : any ? TileCoverage::kPartial : TileCoverage::kFiller;
}

Result<void> posts_are_read(const HeightField& field) {
  const bool lost =
      (field.pages != nullptr && field.pages->failed()) || (field.blocks != nullptr && field.blocks->failed());
  if (!lost) return {};
  return fail(ErrorKind::kIo, "the scratch file of the posts cannot be read");
}

bool is_outside(const HeightField& field, std::int64_t x, std::int64_t y) {
  // Nearest row and column by truncation, which is floor from here on: this is asked for every vertex.
  const double v = (static_cast<double>(y) - field.y0) / field.dy + 0.5;
  if (!(v >= 0) || v >= static_cast<double>(field.n_rows)) return true;
  const auto r = static_cast<std::int64_t>(v);
  const double n_cols = static_cast<double>(field.n_cols), width = static_cast<double>(field.lattice.width());
  for (const double turn : {0.0, width, -width}) {
    const double u = (static_cast<double>(x) + turn - field.x0) / field.dx + 0.5;
    // Of a ring the seam's eastern half cell belongs to its first column.
    if (!(u >= 0) || u >= n_cols + (field.wraps ? 1 : 0)) continue;
    const auto c = static_cast<std::int64_t>(u);
    const PostOrigin origin = field.origin_at(r, c < field.n_cols ? c : 0);
    if (is_of_source(origin) || origin == PostOrigin::kFilled) return false;
  }
  return true;
}

std::vector<double> height_steps(const HeightField& field, const TilePlan& plan, double slack_m, int threads) {
  std::vector<double> steps(static_cast<std::size_t>(plan.bottom_level()) + 1, kSmallestBorderStepM);
  const double unit = field.lattice.height_unit_m() + slack_m;
  std::vector<HeightRange> finer;  // of the tiles of the level below, in their order
  for (int level = plan.bottom_level(); level >= 0; --level) {
    const std::vector<TileKey>& tiles = plan.tiles(level);
    std::vector<HeightRange> ranges(tiles.size(), {field.base_height_m, field.base_height_m});
    if (level == plan.bottom_level()) {
      for_each_job({threads, nullptr, {}}, static_cast<std::int64_t>(tiles.size()), [&](int, std::int64_t k) {
        const auto tile = static_cast<std::size_t>(k);
        ranges[tile] = range_of(field, tiles[tile]);
      });
    }
    // The stored tiles of a level are the children of the split tiles above, four by four in one order.
    std::size_t n_split = 0;
    for (std::size_t k = 0; k < tiles.size(); ++k) {
      HeightRange& range = ranges[k];
      if (level < plan.bottom_level() && plan.is_split(tiles[k])) {
        for (std::size_t child = 0; child < 4; ++child) {
          const HeightRange& part = finer[4 * n_split + child];
          range.include(part.low, part.high);
        }
        ++n_split;
      }
      double& step = steps[static_cast<std::size_t>(level)];
      step = std::max(step, height_step_m(range.low - unit, range.high + unit));
    }
    finer = std::move(ranges);
  }
  return steps;
}

}  // namespace tind
