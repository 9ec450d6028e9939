// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/sample_window.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "storage/builder/sample_region.hpp"
#include "storage/readers/falloff.hpp"
#include "storage/readers/void_fill.hpp"

namespace tind {
namespace {

constexpr std::int64_t kMarginPosts = 2;

// Adds the posts of one source, `turn` columns further east, to those of the range.
Result<void> add_source(const RasterMosaic& mosaic, std::size_t s, const PostRange& range, std::int64_t turn,
                        std::vector<double>& sum, std::vector<float>& low, std::vector<float>& high,
                        std::vector<std::uint16_t>& count, PostSample& sample) {
  const RasterSource& source = mosaic.sources[s];
  const std::int64_t row = std::max(range.row, source.grid_row),
                     row_end = std::min(range.row + range.n_rows, source.grid_row + source.n_used_rows);
  const std::int64_t col = std::max(range.col, source.grid_col + turn),
                     col_end = std::min(range.col + range.n_cols, source.grid_col + turn + source.n_used_cols);
  if (row >= row_end || col >= col_end) return {};
  std::vector<float> heights;
  const double before = thread_seconds();
  if (auto read = mosaic.read_window(s, row - source.grid_row, col - source.grid_col - turn, row_end - row,
                                     col_end - col, heights, sample.signs.implausible);
      !read) {
    return read;
  }
  sample.read_seconds += thread_seconds() - before;
  std::size_t from = 0;
  for (std::int64_t r = row; r < row_end; ++r) {
    auto to = static_cast<std::size_t>((r - range.row) * range.n_cols + col - range.col);
    for (std::int64_t c = col; c < col_end; ++c, ++from, ++to) {
      if (std::isnan(heights[from])) continue;
      sum[to] += static_cast<double>(heights[from]);
      low[to] = count[to] ? std::min(low[to], heights[from]) : heights[from];
      high[to] = count[to] ? std::max(high[to], heights[from]) : heights[from];
      ++count[to];
    }
  }
  return {};
}

// Second differences along rows, where three heights stand in a row.
double roughness(const std::vector<float>& heights, const PostRange& range) {
  double sum = 0;
  std::int64_t n = 0;
  for (std::int64_t r = 0; r < range.n_rows; ++r) {
    const float* row = heights.data() + r * range.n_cols;
    for (std::int64_t c = 2; c < range.n_cols; ++c) {
      const float bend = std::abs(row[c] - 2 * row[c - 1] + row[c - 2]);
      if (std::isnan(bend)) continue;
      sum += static_cast<double>(bend);
      ++n;
    }
  }
  return n ? sum / static_cast<double>(n) : 0;
}

void add_zeros(const PostRange& range, PostSample& sample) {
  for (std::int64_t r = 0; r < range.n_rows; ++r) {
    for (std::int64_t c = 0; c < range.n_cols; ++c) {
      if (sample.heights_m[static_cast<std::size_t>(r * range.n_cols + c)] != 0) continue;
      bool beside = false;
      for (std::int64_t rr = std::max<std::int64_t>(r - 1, 0); rr < std::min(r + 2, range.n_rows); ++rr) {
        for (std::int64_t cc = std::max<std::int64_t>(c - 1, 0); cc < std::min(c + 2, range.n_cols); ++cc)
          beside = beside || std::isnan(sample.heights_m[static_cast<std::size_t>(rr * range.n_cols + cc)]);
      }
      ++sample.signs.zeros;
      sample.signs.zeros_beside_voids += beside;
    }
  }
}

}  // namespace

void PostSigns::add(const PostSigns& other) {
  if (other.heights > 0) {
    lowest_m = heights ? std::min(lowest_m, other.lowest_m) : other.lowest_m;
    highest_m = heights ? std::max(highest_m, other.highest_m) : other.highest_m;
    whole_metres = whole_metres && other.whole_metres;
  }
  if (other.heights > other.zeros) {
    lowest_other_m = heights > zeros ? std::min(lowest_other_m, other.lowest_other_m) : other.lowest_other_m;
  }
  posts += other.posts;
  voids += other.voids;
  heights += other.heights;
  implausible += other.implausible;
  overlapping += other.overlapping;
  disagreeing += other.disagreeing;
  largest_disagreement_m = std::max(largest_disagreement_m, other.largest_disagreement_m);
  zeros += other.zeros;
  zeros_beside_voids += other.zeros_beside_voids;
}

Result<PostSample> read_posts(const RasterMosaic& mosaic, const PostRange& range) {
  const auto n = static_cast<std::size_t>(range.n_rows * range.n_cols);
  std::vector<double> sum(n);
  std::vector<float> low(n), high(n);
  std::vector<std::uint16_t> count(n);
  PostSample sample;
  for (std::size_t s = 0; s < mosaic.sources.size(); ++s) {
    for (const std::int64_t turn : {-mosaic.n_cols, std::int64_t{0}, mosaic.n_cols}) {
      if (turn != 0 && !mosaic.wraps) continue;
      if (auto added = add_source(mosaic, s, range, turn, sum, low, high, count, sample); !added)
        return tl::unexpected(added.error());
    }
  }
  sample.heights_m.assign(n, std::numeric_limits<float>::quiet_NaN());
  PostSigns& signs = sample.signs;
  for (std::int64_t r = 0; r < range.n_rows; ++r) {
    if (range.row + r < 0 || range.row + r >= mosaic.n_rows) continue;
    for (std::int64_t c = 0; c < range.n_cols; ++c) {
      if (!mosaic.wraps && (range.col + c < 0 || range.col + c >= mosaic.n_cols)) continue;
      const auto i = static_cast<std::size_t>(r * range.n_cols + c);
      ++signs.posts;
      if (count[i] == 0) {
        ++signs.voids;
        continue;
      }
      const auto height = static_cast<float>(sum[i] / count[i]);
      sample.heights_m[i] = height;
      signs.whole_metres = signs.whole_metres && low[i] == std::round(low[i]);
      signs.lowest_m = signs.heights ? std::min<double>(signs.lowest_m, height) : height;
      signs.highest_m = signs.heights ? std::max<double>(signs.highest_m, height) : height;
      ++signs.heights;
      signs.overlapping += count[i] > 1;
      signs.disagreeing += low[i] != high[i];
      signs.largest_disagreement_m =
          std::max(signs.largest_disagreement_m, static_cast<double>(high[i]) - static_cast<double>(low[i]));
    }
  }
  bool any = false;
  for (const float height : sample.heights_m) {
    if (std::isnan(height) || height == 0) continue;
    signs.lowest_other_m = any ? std::min<double>(signs.lowest_other_m, height) : height;
    any = true;
  }
  add_zeros(range, sample);
  sample.roughness_m = roughness(sample.heights_m, range);
  return sample;
}

PostRange posts_around(const RasterMosaic& mosaic, const Lattice& lattice, const TileKey& tile) {
  const double side_deg = static_cast<double>(lattice.tile_side(tile.level)) * lattice.step_deg();
  double col = (side_deg * tile.x - 180.0 - mosaic.west_deg) / mosaic.lon_spacing_deg;
  const double around = 360.0 / mosaic.lon_spacing_deg, width = side_deg / mosaic.lon_spacing_deg;
  // West of the mosaic may be east of it, the other way round the globe.
  if (col + width < 0) col += around;
  const double row = (side_deg * tile.y - 90.0 - mosaic.south_deg) / mosaic.lat_spacing_deg;
  PostRange range;
  range.col = static_cast<std::int64_t>(std::floor(col)) - kMarginPosts;
  range.row = static_cast<std::int64_t>(std::floor(row)) - kMarginPosts;
  range.n_cols = static_cast<std::int64_t>(std::ceil(col + width)) + kMarginPosts + 1 - range.col;
  range.n_rows =
      static_cast<std::int64_t>(std::ceil(row + side_deg / mosaic.lat_spacing_deg)) + kMarginPosts + 1 - range.row;
  // No posts beyond the poles.
  const auto south = static_cast<std::int64_t>(std::ceil((-90.0 - mosaic.south_deg) / mosaic.lat_spacing_deg - 1e-3));
  const auto north = static_cast<std::int64_t>(std::floor((90.0 - mosaic.south_deg) / mosaic.lat_spacing_deg + 1e-3));
  const std::int64_t end = std::min(range.row + range.n_rows, north + 1);
  range.row = std::max(range.row, south);
  range.n_rows = end - range.row;
  return range;
}

WindowField::WindowField(const RasterMosaic& mosaic, const Lattice& lattice, const PostRange& range, PostSample sample,
                         double base_height_m, int falloff_posts)
    : heights_m_(std::move(sample.heights_m)), origins_(heights_m_.size(), PostOrigin::kBase) {
  for (std::size_t i = 0; i < heights_m_.size(); ++i) {
    if (!std::isnan(heights_m_[i])) {
      origins_[i] = PostOrigin::kSource;
    } else {
      heights_m_[i] = static_cast<float>(base_height_m);
    }
  }
  PostGrid grid;
  grid.n_rows = range.n_rows;
  grid.n_cols = range.n_cols;
  grid.heights_m = heights_m_.data();
  grid.origins = origins_.data();
  fill_interior_voids(grid, {0, range.n_rows - 1, 0, range.n_cols - 1, true, true});
  add_falloff(grid, base_height_m, falloff_posts);
  const double step = lattice.step_deg(), width = static_cast<double>(lattice.width());
  field_.lattice = lattice;
  field_.n_rows = range.n_rows;
  field_.n_cols = range.n_cols;
  field_.dx = mosaic.lon_spacing_deg / step;
  field_.dy = mosaic.lat_spacing_deg / step;
  field_.x0 = std::fmod((mosaic.west_deg + 180.0) / step + static_cast<double>(range.col) * field_.dx + width, width);
  field_.y0 = std::max(0.0, (mosaic.south_deg + 90.0) / step + static_cast<double>(range.row) * field_.dy);
  field_.base_height_m = base_height_m;
  field_.heights_m = heights_m_.data();
  field_.origins = origins_.data();
  field_.continues_south = field_.y0 <= field_.dy * (1 + 1e-9);
  field_.continues_north =
      static_cast<double>(lattice.height()) - field_.post_y(field_.n_rows - 1) <= field_.dy * (1 + 1e-9);
  field_.south_pole_m = field_.height_at(0, 0);
  field_.north_pole_m = field_.height_at(field_.n_rows - 1, 0);
  block_memory_.resize(PostBlocks::n_bytes(field_.n_rows, field_.n_cols));
  blocks_ = std::make_unique<PostBlocks>(PostBlocks::build(field_, block_memory_, 1));
  field_.blocks = blocks_.get();
}

}  // namespace tind
