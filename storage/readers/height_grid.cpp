// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/height_grid.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <mutex>
#include <optional>
#include <span>
#include <utility>

#include <fmt/format.h>

#include "core/drainage/flow_run.hpp"
#include "storage/readers/falloff.hpp"
#include "storage/readers/packed_posts.hpp"
#include "storage/readers/post_arrays.hpp"
#include "storage/readers/row_merge.hpp"
#include "storage/readers/void_fill.hpp"

namespace tind {
namespace {

constexpr std::size_t kStripBytes = std::size_t{16} << 20;
constexpr std::size_t kMaxStripRows = 512;
constexpr std::size_t kBytesPerStripPost = 40;  // of a RowMerge, GDAL's doubles included

}  // namespace

struct HeightGrid::Impl {
  PostArrays arrays;
  std::unique_ptr<PackedPosts> packed;  // instead of arrays
  HeightField field;
  HeightGridCounts counts;
  std::vector<std::string> notes;
  PostGrid grid;
  DataFrame frame;

  /// Lays the extended grid around the mosaic's. Returns the falloff that fits.
  Result<std::int64_t> lay_out(const RasterMosaic& mosaic, const Lattice& lattice, const HeightGridOptions& options);
  /// Calls take(rows, k) for rows strips(k) = {begin, end} of the mosaic, 0 <= k < n_strips, on any thread, each with
  /// its own `rows` to read them. False: take() said so, and the rest was left.
  using Strips = std::function<std::pair<std::int64_t, std::int64_t>(std::int64_t k)>;
  using Take = std::function<Result<bool>(RowMerge& rows, std::int64_t k)>;
  Result<bool> merge(const RasterMosaic& mosaic, int n_workers, const std::function<void(double)>& progress,
                     std::int64_t n_strips, const Strips& strips, const Take& take);
  Result<void> merge_into_arrays(const RasterMosaic& mosaic, int n_workers,
                                 const std::function<void(double)>& progress);
  /// Whether the grid is one of PackedPosts, as far as is known before posts are read.
  bool can_be_packed(const RasterMosaic& mosaic, std::int64_t falloff) const;
  /// False: it has voids.
  Result<bool> merge_into_pages(const RasterMosaic& mosaic, int n_workers, std::int64_t falloff,
                                const std::function<void(double)>& progress);
  Result<void> make_arrays(const HeightGridOptions& options);
  /// One height for a pole; `row` is the grid's last row at it, `on_pole` iff it lies on the pole itself.
  double settle_pole(std::int64_t row, bool on_pole);
  /// Lattice steps between the last row and the north pole.
  double north_gap() const { return static_cast<double>(field.lattice.height()) - field.post_y(field.n_rows - 1); }
};

Result<std::int64_t> HeightGrid::Impl::lay_out(const RasterMosaic& mosaic, const Lattice& lattice,
                                               const HeightGridOptions& options) {
  const std::int64_t wanted = options.falloff_posts;
  std::int64_t falloff = wanted, rim_x = wanted;
  const double around = 360.0 / mosaic.lon_spacing_deg;
  const auto spare = static_cast<std::int64_t>(std::floor(around + 1e-3)) - mosaic.n_cols;
  grid.wraps = mosaic.wraps;
  grid.n_cols = mosaic.n_cols + 2 * rim_x;
  frame.west_col = rim_x;
  if (mosaic.wraps) {
    rim_x = 0;
    grid.n_cols = mosaic.n_cols;
    frame.west_col = 0;
  } else if (spare < 2 * wanted) {
    // The two rims would meet at the back of the globe.
    if (std::abs(around - std::round(around)) <= 1e-3) {
      grid.wraps = true;  // the gap becomes a void between the data's two sides
      rim_x = 0;
      grid.n_cols = mosaic.n_cols + spare;
      frame.west_col = 0;
    } else {
      rim_x = std::max<std::int64_t>(spare / 2, 0);
      falloff = std::max<std::int64_t>(rim_x, 1);
      grid.n_cols = mosaic.n_cols + 2 * rim_x;
      frame.west_col = rim_x;
      notes.push_back(fmt::format("the data nearly closes around the globe: the falloff is {} posts instead of {}",
                                  falloff, wanted));
    }
  }
  frame.east_col = grid.wraps ? grid.n_cols - 1 : frame.west_col + mosaic.n_cols - 1;

  const double north_deg = mosaic.south_deg + static_cast<double>(mosaic.n_rows - 1) * mosaic.lat_spacing_deg;
  const auto rows_to_pole = [&](double degrees) {
    return std::max<std::int64_t>(0, static_cast<std::int64_t>(std::floor(degrees / mosaic.lat_spacing_deg + 1e-3)));
  };
  const std::int64_t rim_south = std::min(falloff, rows_to_pole(mosaic.south_deg + 90.0));
  const std::int64_t rim_north = std::min(falloff, rows_to_pole(90.0 - north_deg));
  grid.n_rows = mosaic.n_rows + rim_south + rim_north;
  frame.south_row = rim_south;
  frame.north_row = rim_south + mosaic.n_rows - 1;
  frame.open_south = rim_south > 0;
  frame.open_north = rim_north > 0;

  grid.cancel = options.cancel;
  const double step = lattice.step_deg();
  field.lattice = lattice;
  field.n_rows = grid.n_rows;
  field.n_cols = grid.n_cols;
  field.wraps = grid.wraps;
  field.dx = grid.wraps ? static_cast<double>(lattice.width()) / static_cast<double>(grid.n_cols)
                        : mosaic.lon_spacing_deg / step;
  field.dy = mosaic.lat_spacing_deg / step;
  field.x0 = (mosaic.west_deg + 180.0) / step - static_cast<double>(rim_x) * field.dx;
  if (field.x0 < 0) field.x0 += static_cast<double>(lattice.width());
  field.y0 = std::max(0.0, (mosaic.south_deg + 90.0) / step - static_cast<double>(rim_south) * field.dy);
  field.base_height_m = options.base_height_m;
  field.continues_south = field.y0 <= field.dy * (1 + 1e-9);
  field.continues_north = north_gap() <= field.dy * (1 + 1e-9);
  return falloff;
}

Result<void> HeightGrid::Impl::make_arrays(const HeightGridOptions& options) {
  auto made = PostArrays::create(options.scratch_dir, grid.n_rows, grid.n_cols, options.in_memory_bytes);
  if (!made) return tl::unexpected(made.error());
  arrays = std::move(*made);
  const bool wraps = grid.wraps;
  grid = arrays.grid();
  grid.wraps = wraps;
  grid.cancel = options.cancel;
  arrays.attach(field);
  return {};
}

bool HeightGrid::Impl::can_be_packed(const RasterMosaic& mosaic, std::int64_t falloff) const {
  return !grid.wraps && !field.continues_south && !field.continues_north && frame.west_col == falloff &&
         frame.south_row == falloff && grid.n_rows == mosaic.n_rows + 2 * falloff &&
         grid.n_cols == mosaic.n_cols + 2 * falloff && PackedPosts::is_room_for(grid.n_rows, grid.n_cols, falloff);
}

Result<bool> HeightGrid::Impl::merge_into_pages(const RasterMosaic& mosaic, int n_workers, std::int64_t falloff,
                                                const std::function<void(double)>& progress) {
  auto made = PackedPosts::create(grid.n_rows, grid.n_cols, falloff);
  if (!made) return tl::unexpected(made.error());
  packed = std::move(*made);
  const auto strips = [&](std::int64_t k) {
    const auto [begin, end] = packed->rows_of(k);
    return std::pair(begin - falloff, end - falloff);
  };
  const auto take = [&](RowMerge& rows, std::int64_t k) -> Result<bool> {
    const auto [begin, end] = strips(k);
    if (rows.has_one_source()) {
      const auto plain = rows.plain(begin, end);
      if (!plain) return tl::unexpected(plain.error());
      if (plain->first != nullptr) packed->take(k, plain->first, plain->stride);
      return plain->first != nullptr;
    }
    const auto any = rows.merge(begin, end);
    if (!any || !*any) return any;
    const std::int64_t west = falloff, east = grid.n_cols - falloff;
    for (std::int64_t r = 0; r < end - begin; ++r) {
      if (next_void(rows.origins().data() + r * grid.n_cols, west, east) < east) return false;
    }
    packed->take(k, rows.heights_m().data() + west, grid.n_cols);
    return true;
  };
  const auto done = merge(mosaic, n_workers, progress, packed->n_page_rows(), strips, take);
  if (!done || !*done) {
    packed.reset();
    counts = {};
    field.disagreement_m = 0;
    return done;
  }
  grid = packed->rim();
  return true;
}

Result<void> HeightGrid::Impl::merge_into_arrays(const RasterMosaic& mosaic, int n_workers,
                                                 const std::function<void(double)>& progress) {
  const std::size_t row_bytes = kBytesPerStripPost * static_cast<std::size_t>(mosaic.n_cols);
  const auto strip_rows = static_cast<std::int64_t>(
      std::clamp<std::size_t>(kStripBytes / static_cast<std::size_t>(n_workers) / row_bytes, 1, kMaxStripRows));
  const auto strips = [&](std::int64_t k) {
    return std::pair(k * strip_rows, std::min((k + 1) * strip_rows, mosaic.n_rows));
  };
  const auto take = [&](RowMerge& rows, std::int64_t k) -> Result<bool> {
    const auto [begin, end] = strips(k);
    const auto any = rows.merge(begin, end);
    if (!any) return any;
    if (*any) {
      const std::int64_t at = (frame.south_row + begin) * grid.n_cols;
      if (auto taken = arrays.take(at, rows.heights_m(), rows.origins()); !taken) return tl::unexpected(taken.error());
    }
    return true;
  };
  const auto done = merge(mosaic, n_workers, progress, (mosaic.n_rows + strip_rows - 1) / strip_rows, strips, take);
  if (!done) return tl::unexpected(done.error());
  return {};
}

Result<bool> HeightGrid::Impl::merge(const RasterMosaic& mosaic, int n_workers,
                                     const std::function<void(double)>& progress, std::int64_t n_strips,
                                     const Strips& strips, const Take& take) {
  std::vector<RowMerge> workers(static_cast<std::size_t>(n_workers),
                                RowMerge(mosaic, grid.n_cols, frame.west_col, grid.cancel));
  std::mutex mutex;
  std::optional<Error> failure;
  std::atomic<bool> has_ended{false};
  for_each_job({n_workers, grid.cancel, {}}, n_strips, [&](int w, std::int64_t k) {
    const auto [begin, end] = strips(k);
    if (has_ended || begin == end) return;
    const auto taken = take(workers[static_cast<std::size_t>(w)], k);
    if (!taken) {
      const std::lock_guard lock(mutex);
      if (!failure) failure = taken.error();
    }
    if (!taken || !*taken) {
      has_ended = true;
    } else if (w == 0 && progress) {
      progress(0.7 * static_cast<double>(end) / static_cast<double>(mosaic.n_rows));
    }
  });
  if (failure) return tl::unexpected(*failure);
  if (is_set(grid.cancel)) return interrupted();
  if (has_ended) return false;
  for (const RowMerge& worker : workers) {
    counts.source += worker.counts().source;
    counts.overlapping += worker.counts().overlapping;
    counts.disagreeing += worker.counts().disagreeing;
    counts.implausible += worker.counts().implausible;
    field.disagreement_m = std::max(field.disagreement_m, worker.disagreement_m());
  }
  return true;
}

double HeightGrid::Impl::settle_pole(std::int64_t row, bool on_pole) {
  float* heights = grid.heights_m + row * grid.n_cols;
  PostOrigin* origins = grid.origins + row * grid.n_cols;
  const bool any_source = std::find(origins, origins + grid.n_cols, PostOrigin::kSource) != origins + grid.n_cols;
  double sum = 0;
  std::int64_t n = 0;
  for (std::int64_t c = 0; c < grid.n_cols; ++c) {
    if (any_source && origins[c] != PostOrigin::kSource) continue;
    sum += heights[c];
    ++n;
  }
  // A float, so that the pole row and the pole itself have the very same height.
  const auto pole = static_cast<float>(sum / static_cast<double>(n));
  if (!on_pole) return pole;
  double moved = 0;
  for (std::int64_t c = 0; c < grid.n_cols; ++c) {
    if (origins[c] == PostOrigin::kSource) moved = std::max(moved, std::abs(static_cast<double>(heights[c]) - pole));
    if (origins[c] == PostOrigin::kBase && pole != static_cast<float>(field.base_height_m)) {
      origins[c] = PostOrigin::kFalloff;
      ++counts.falloff;
    }
    heights[c] = pole;
  }
  if (moved > 0) {
    field.disagreement_m = std::max(field.disagreement_m, moved);
    notes.push_back(fmt::format(
        "the posts on a pole are one point but differ by up to {:.2f} m from their mean, which is used", moved));
  }
  return pole;
}

HeightGrid::HeightGrid(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
HeightGrid::HeightGrid(HeightGrid&&) noexcept = default;
HeightGrid& HeightGrid::operator=(HeightGrid&&) noexcept = default;
HeightGrid::~HeightGrid() = default;
const HeightField& HeightGrid::field() const { return impl_->field; }
Result<void> HeightGrid::turn_into_pages(const std::string& scratch_dir, std::size_t held_bytes, int threads,
                                         CancelFlag cancel) {
  return impl_->arrays.turn_into_pages(impl_->field, scratch_dir, held_bytes, threads, cancel);
}
const HeightGridCounts& HeightGrid::counts() const { return impl_->counts; }
const std::vector<std::string>& HeightGrid::notes() const { return impl_->notes; }

Result<HeightGrid> HeightGrid::load(const RasterMosaic& mosaic, const Lattice& lattice,
                                    const HeightGridOptions& options, const std::function<void(double)>& progress) {
  if (options.falloff_posts < 1) return fail(ErrorKind::kInvalidInput, "the falloff needs at least 1 post");
  if (!(std::abs(options.base_height_m) <= kMaxHeightM)) {
    return fail(ErrorKind::kInvalidInput,
                fmt::format("base height {} m is beyond +-{} m", options.base_height_m, kMaxHeightM));
  }
  HeightGrid result(std::make_unique<Impl>());
  Impl& impl = *result.impl_;
  const auto falloff = impl.lay_out(mosaic, lattice, options);
  if (!falloff) return tl::unexpected(falloff.error());
  const int n_workers = mosaic.reads_in_parallel() ? options.threads : 1;
  bool is_packed = options.may_be_pages && impl.can_be_packed(mosaic, *falloff) &&
                   PostArrays::n_bytes(impl.field) <= options.in_memory_bytes;
  if (is_packed) {
    const auto merged = impl.merge_into_pages(mosaic, n_workers, *falloff, progress);
    if (!merged) return tl::unexpected(merged.error());
    is_packed = *merged;
  }
  if (!is_packed) {
    if (auto made = impl.make_arrays(options); !made) return tl::unexpected(made.error());
    if (auto merged = impl.merge_into_arrays(mosaic, n_workers, progress); !merged) {
      return tl::unexpected(merged.error());
    }
  }
  if (impl.counts.source == 0) {
    return fail(
        ErrorKind::kInvalidInput,
        fmt::format(
            "{}: every post is a void; check the nodata value (--nodata) and the vertical unit (--metres-per-unit)",
            mosaic.sources.front().path));
  }
  if (impl.counts.implausible > 0) {
    impl.notes.push_back(
        fmt::format("{} posts beyond +-{} m are taken as voids (--nodata declares the value that marks them)",
                    impl.counts.implausible, kMaxHeightM));
  }
  auto suspicions = mosaic.suspicions();
  if (!suspicions) return tl::unexpected(suspicions.error());
  impl.notes.insert(impl.notes.end(), suspicions->begin(), suspicions->end());
  if (!is_packed) impl.counts.filled = fill_interior_voids(impl.grid, impl.frame);
  if (progress) progress(0.8);
  impl.counts.falloff = add_falloff(impl.grid, options.base_height_m, *falloff, options.threads);

  HeightField& field = impl.field;
  if (field.continues_south) field.south_pole_m = impl.settle_pole(0, field.y0 <= 0.5);
  if (field.continues_north) field.north_pole_m = impl.settle_pole(field.n_rows - 1, impl.north_gap() <= 0.5);
  if (is_packed) {
    impl.packed->attach(field, options.threads, options.cancel);
  } else {
    impl.arrays.build_blocks(field, options.threads, options.cancel);
  }
  if (is_set(options.cancel)) return interrupted();
  if (progress) progress(1.0);
  return result;
}

}  // namespace tind
