// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/point_scatter.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <numeric>
#include <span>
#include <tuple>
#include <utility>

namespace tind {
namespace {

/// A point and its block in a batch that is being sorted, with room for the sort.
constexpr std::uint64_t kBytesPerBatchPoint = 2 * sizeof(std::pair<std::uint64_t, std::uint32_t>);

auto rounded(const PointPost& p) { return std::make_pair(std::llround(p.y), std::llround(p.x)); }

/// By rounded position, then lowest first, then by real position.
bool before(const PointPost& a, const PointPost& b) {
  const auto at = rounded(a), bt = rounded(b);
  return at != bt ? at < bt : std::tie(a.height_m, a.y, a.x) < std::tie(b.height_m, b.y, b.x);
}

}  // namespace

Result<ScatteredPoints> scatter_points(const PointSource& source, const ScatterOptions& o,
                                       const std::function<void(double)>& progress) {
  const auto report = [&](double fraction) {
    if (progress) progress(fraction);
  };
  const std::uint64_t n = source.n_used;
  auto unsorted = ScratchMap::create(o.scratch_dir, std::max<std::uint64_t>(n, 1) * sizeof(PointPost));
  if (!unsorted) return tl::unexpected(unsorted.error());
  auto* arrived = static_cast<PointPost*>(unsorted->data());
  const auto block_of = [&](const PointPost& p) {
    const auto r = static_cast<std::int64_t>(std::floor((p.y - o.y0) / o.side));
    const auto c = static_cast<std::int64_t>(std::floor((p.x - o.x0) / o.side));
    assert(r >= 0 && c >= 0 && r < o.n_rows && c < o.n_cols);
    return static_cast<std::size_t>(r * o.n_cols + c);
  };

  ScatteredPoints result;
  const auto n_blocks = static_cast<std::size_t>(o.n_rows * o.n_cols);
  result.first.assign(n_blocks + 1, 0);
  std::uint64_t n_read = 0;
  const auto read = source.read([&](std::span<const GeoPoint> points) -> Result<void> {
    if (is_set(o.cancel)) return interrupted();
    if (points.size() > n - n_read)
      return fail(ErrorKind::kIo, "the point files grew while they were read; start again");
    for (const GeoPoint& g : points) {
      const PointPost p{lattice_x(o.lattice, g.lon_deg) + o.x_turn, lattice_y(o.lattice, g.lat_deg), g.height_m};
      ++result.first[block_of(p) + 1];
      arrived[n_read++] = p;
    }
    report(0.5 * static_cast<double>(n_read) / static_cast<double>(n));
    return {};
  });
  if (!read) return tl::unexpected(read.error());
  std::partial_sum(result.first.begin(), result.first.end(), result.first.begin());

  auto sorted = ScratchMap::create(o.scratch_dir, std::max<std::uint64_t>(n, 1) * sizeof(PointPost));
  if (!sorted) return tl::unexpected(sorted.error());
  auto* posts = static_cast<PointPost*>(sorted->data());
  std::vector<std::uint64_t> next(result.first.begin(), result.first.end() - 1);
  // A batch goes out in the order of blocks, so that a file larger than memory is written in runs, not point by point.
  const std::uint64_t n_batch = std::clamp<std::uint64_t>(o.memory_bytes / kBytesPerBatchPoint, 1024, 1u << 30);
  std::vector<std::pair<std::uint64_t, std::uint32_t>> order;
  for (std::uint64_t begin = 0; begin < n; begin += n_batch) {
    if (is_set(o.cancel)) return interrupted();
    const std::uint64_t end = std::min(n, begin + n_batch);
    order.clear();
    for (std::uint64_t i = begin; i < end; ++i) {
      order.emplace_back(block_of(arrived[i]), static_cast<std::uint32_t>(i - begin));
    }
    std::sort(order.begin(), order.end());
    for (const auto& [block, i] : order) posts[next[block]++] = arrived[begin + i];
    report(0.5 + 0.3 * static_cast<double>(end) / static_cast<double>(n));
  }

  std::uint64_t n_kept = 0;
  for (std::size_t b = 0; b < n_blocks; ++b) {
    if (is_set(o.cancel)) return interrupted();
    const std::uint64_t begin = result.first[b], end = result.first[b + 1];
    result.first[b] = n_kept;
    std::sort(posts + begin, posts + end, before);
    for (std::uint64_t i = begin; i < end; ++i) {
      if (i > begin && rounded(posts[i]) == rounded(posts[i - 1])) {
        ++result.n_duplicates;
      } else if (n_kept++ != i) {
        posts[n_kept - 1] = posts[i];
      }
    }
  }
  result.first[n_blocks] = n_kept;
  result.map = std::move(*sorted);
  report(1.0);
  return result;
}

}  // namespace tind
