// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/report/native_posts.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <utility>

namespace tind {
namespace {

/// Posts of the warped grid along a block of cells.
constexpr double kBlockPosts = 32;
/// Cells read at a time.
constexpr std::int64_t kBatchCells = 1 << 20;

bool is_between_source_posts(const HeightField& field, const PointPost& p) {
  const double u = (p.x - field.x0) / field.dx, v = (p.y - field.y0) / field.dy;
  const auto c = static_cast<std::int64_t>(std::floor(u)), r = static_cast<std::int64_t>(std::floor(v));
  if (r < 0 || c < 0 || r + 1 >= field.n_rows || (!field.wraps && c + 1 >= field.n_cols)) return false;
  const std::int64_t west = field.wraps ? c % field.n_cols : c, east = (west + 1) % field.n_cols;
  return field.origin_at(r, west) == PostOrigin::kSource && field.origin_at(r, east) == PostOrigin::kSource &&
         field.origin_at(r + 1, west) == PostOrigin::kSource && field.origin_at(r + 1, east) == PostOrigin::kSource;
}

/// Calls visit for every cell that has a height and a place.
Result<void> for_cells(const RasterMosaic& mosaic, const HeightField& field,
                       const std::function<void(const PointPost&)>& visit) {
  const Lattice& lattice = field.lattice;
  NativePosts cells;
  for (std::size_t s = 0; s < mosaic.sources.size(); ++s) {
    const RasterSource& source = mosaic.sources[s];
    const std::int64_t batch = std::max<std::int64_t>(1, kBatchCells / source.n_cols);
    for (std::int64_t row = 0; row < source.n_rows; row += batch) {
      const std::int64_t n = std::min(batch, source.n_rows - row);
      if (auto read = mosaic.read_native_rows(s, row, n, cells); !read) return read;
      for (std::size_t i = 0; i < cells.heights_m.size(); ++i) {
        if (std::isnan(cells.heights_m[i]) || !std::isfinite(cells.lon_deg[i]) || !std::isfinite(cells.lat_deg[i])) {
          continue;
        }
        PointPost post{(cells.lon_deg[i] + 180) / lattice.step_deg(), (cells.lat_deg[i] + 90) / lattice.step_deg(),
                       cells.heights_m[i]};
        if (post.x < field.x0) post.x += static_cast<double>(lattice.width());
        visit(post);
      }
    }
  }
  return {};
}

}  // namespace

Result<NativeCells> NativeCells::load(const RasterMosaic& mosaic, const HeightField& field,
                                      const std::string& scratch_dir) {
  NativeCells result;
  PointBlocks& blocks = result.blocks_;
  blocks.x0 = field.x0;
  blocks.y0 = field.y0;
  blocks.side = kBlockPosts * std::max(field.dx, field.dy);
  blocks.n_rows = static_cast<std::int64_t>(std::floor(static_cast<double>(field.n_rows) * field.dy / blocks.side)) + 1;
  blocks.n_cols = static_cast<std::int64_t>(std::floor(static_cast<double>(field.n_cols) * field.dx / blocks.side)) + 1;
  const auto block_of = [&](const PointPost& p) {
    const auto r = static_cast<std::int64_t>(std::floor((p.y - blocks.y0) / blocks.side));
    const auto c = static_cast<std::int64_t>(std::floor((p.x - blocks.x0) / blocks.side));
    return static_cast<std::size_t>(r * blocks.n_cols + c);
  };
  result.first_.assign(static_cast<std::size_t>(blocks.n_rows * blocks.n_cols) + 1, 0);
  auto counted = for_cells(mosaic, field, [&](const PointPost& p) {
    if (is_between_source_posts(field, p)) {
      ++result.first_[block_of(p) + 1];
    } else {
      ++result.n_left_out;
    }
  });
  if (!counted) return tl::unexpected(counted.error());
  std::partial_sum(result.first_.begin(), result.first_.end(), result.first_.begin());
  const std::uint64_t n_bytes = std::max<std::uint64_t>(result.size(), 1) * sizeof(PointPost);
  auto map = ScratchMap::create(scratch_dir, n_bytes);
  if (!map) return tl::unexpected(map.error());
  result.map_ = std::move(*map);
  auto* posts = static_cast<PointPost*>(result.map_.data());
  std::vector<std::uint64_t> next(result.first_.begin(), result.first_.end() - 1);
  std::uint64_t n_placed = 0;
  auto placed = for_cells(mosaic, field, [&](const PointPost& p) {
    if (!is_between_source_posts(field, p)) return;
    const std::size_t b = block_of(p);
    // A file that changes between the two readings must not make us write beyond the map.
    if (next[b] == result.first_[b + 1]) return;
    posts[next[b]++] = p;
    ++n_placed;
  });
  if (!placed) return tl::unexpected(placed.error());
  if (n_placed != result.size()) return fail(ErrorKind::kIo, "a source changed while it was read");
  blocks.first = result.first_.data();
  blocks.posts = posts;
  return result;
}

}  // namespace tind
