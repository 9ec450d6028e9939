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
#include "storage/readers/post_arrays.hpp"
#include "storage/readers/void_fill.hpp"

namespace tind {
namespace {

/// Rows of the mosaic's grid while overlapping sources are merged.
struct Strip {
  std::vector<double> sum;
  std::vector<float> low, high;
  std::vector<std::uint16_t> count;

  explicit Strip(std::size_t n) : sum(n), low(n), high(n), count(n) {}
  void clear() { std::fill(count.begin(), count.end(), std::uint16_t{0}); }
  void add(std::size_t i, float height) {
    if (count[i] == 0) {
      sum[i] = height;
      low[i] = high[i] = height;
    } else {
      sum[i] += height;
      low[i] = std::min(low[i], height);
      high[i] = std::max(high[i], height);
    }
    ++count[i];
  }
};

constexpr std::size_t kStripBytes = std::size_t{16} << 20;
constexpr std::size_t kMaxStripRows = 512;
constexpr std::size_t kBytesPerStripPost = 40;  // Strip, one source's floats, GDAL's doubles, and the grid's posts

}  // namespace

struct HeightGrid::Impl {
  PostArrays arrays;
  HeightField field;
  HeightGridCounts counts;
  std::vector<std::string> notes;
  PostGrid grid;
  DataFrame frame;

  /// Lays the extended grid around the mosaic's and reserves its memory. Returns the falloff that fits.
  Result<std::int64_t> lay_out(const RasterMosaic& mosaic, const Lattice& lattice, const HeightGridOptions& options);
  /// What a thread works with that reads rows.
  struct Worker {
    std::vector<float> heights_m;  ///< Of one source.
    std::optional<Strip> strip;    ///< Made when sources share rows.
    /// Rows of the grid.
    std::vector<float> grid_heights_m;
    std::vector<PostOrigin> grid_origins;
    HeightGridCounts counts;
    double disagreement_m = 0;
  };
  /// Takes `n` posts of a source for the worker's rows from index `at` on.
  static void take_row(const float* from, std::int64_t n, std::int64_t at, Worker& worker);
  /// Takes the mean of overlapping sources for the worker's rows.
  void take_mean(std::int64_t n_strip_rows, std::int64_t n_cols, Worker& worker);
  /// Rows [begin, end) of the mosaic, from all its sources.
  Result<void> merge_strip(const RasterMosaic& mosaic, std::int64_t begin, std::int64_t end, Worker& worker);
  Result<void> merge(const RasterMosaic& mosaic, int threads, const std::function<void(double)>& progress);
  /// One height for a pole; `row` is the grid's last row at it, `on_pole` iff it lies on the pole itself.
  double settle_pole(std::int64_t row, bool on_pole);
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

  auto made = PostArrays::create(options.scratch_dir, grid.n_rows, grid.n_cols);
  if (!made) return tl::unexpected(made.error());
  arrays = std::move(*made);
  const bool wraps = grid.wraps;
  grid = arrays.grid();
  grid.wraps = wraps;
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
  arrays.attach(field);
  return falloff;
}

void HeightGrid::Impl::take_row(const float* from, std::int64_t n, std::int64_t at, Worker& worker) {
  float* __restrict heights = worker.grid_heights_m.data() + at;
  PostOrigin* __restrict origins = worker.grid_origins.data() + at;
  std::uint32_t n_voids = 0;
  for (std::int64_t c = 0; c < n; ++c) {
    const bool is_void = std::isnan(from[c]);
    heights[c] = is_void ? 0 : from[c];
    origins[c] = is_void ? PostOrigin::kBase : PostOrigin::kSource;
    n_voids += is_void ? 1u : 0u;
  }
  worker.counts.source += static_cast<std::uint64_t>(n) - n_voids;
}

void HeightGrid::Impl::take_mean(std::int64_t n_strip_rows, std::int64_t n_cols, Worker& worker) {
  const Strip& strip = *worker.strip;
  for (std::int64_t r = 0; r < n_strip_rows; ++r) {
    const std::int64_t out = r * grid.n_cols + frame.west_col;
    for (std::int64_t c = 0; c < n_cols; ++c) {
      const auto i = static_cast<std::size_t>(r * n_cols + c), o = static_cast<std::size_t>(out + c);
      if (strip.count[i] == 0) continue;
      const auto height = static_cast<float>(strip.sum[i] / strip.count[i]);
      worker.grid_heights_m[o] = height;
      worker.grid_origins[o] = PostOrigin::kSource;
      ++worker.counts.source;
      if (strip.count[i] < 2) continue;
      ++worker.counts.overlapping;
      if (strip.low[i] == strip.high[i]) continue;
      ++worker.counts.disagreeing;
      const double mean = height, low = strip.low[i], high = strip.high[i];
      worker.disagreement_m = std::max({worker.disagreement_m, high - mean, mean - low});
    }
  }
}

Result<void> HeightGrid::Impl::merge_strip(const RasterMosaic& mosaic, std::int64_t begin, std::int64_t end,
                                           Worker& worker) {
  const auto n_cols = static_cast<std::size_t>(mosaic.n_cols);
  std::vector<std::size_t> present;
  for (std::size_t s = 0; s < mosaic.sources.size(); ++s) {
    const RasterSource& source = mosaic.sources[s];
    if (source.grid_row < end && source.grid_row + source.n_used_rows > begin) present.push_back(s);
  }
  if (present.empty()) return {};
  const bool alone = present.size() == 1 && mosaic.sources[present[0]].n_used_cols <= mosaic.n_cols;
  if (!alone) {
    const std::size_t n_strip_posts = static_cast<std::size_t>(end - begin) * n_cols;
    if (!worker.strip || worker.strip->count.size() < n_strip_posts) worker.strip.emplace(n_strip_posts);
    worker.strip->clear();
  }
  const auto n_posts = static_cast<std::size_t>((end - begin) * grid.n_cols);
  worker.grid_heights_m.assign(n_posts, 0.0f);
  worker.grid_origins.assign(n_posts, PostOrigin::kBase);
  for (const std::size_t s : present) {
    if (is_set(grid.cancel)) return interrupted();
    const RasterSource& source = mosaic.sources[s];
    const std::int64_t from = std::max(begin, source.grid_row),
                       to = std::min(end, source.grid_row + source.n_used_rows);
    if (auto read = mosaic.read_rows(s, from - source.grid_row, to - from, worker.heights_m, worker.counts.implausible);
        !read) {
      return read;
    }
    for (std::int64_t r = from; r < to; ++r) {
      const float* row = worker.heights_m.data() + (r - from) * source.n_used_cols;
      if (alone) {
        const std::int64_t out = (r - begin) * grid.n_cols + frame.west_col;
        // Columns that pass the mosaic's eastern end go on at its western one.
        const std::int64_t n_east = std::min(source.n_used_cols, mosaic.n_cols - source.grid_col);
        take_row(row, n_east, out + source.grid_col, worker);
        take_row(row + n_east, source.n_used_cols - n_east, out, worker);
        continue;
      }
      const std::size_t row_at = static_cast<std::size_t>(r - begin) * n_cols;
      auto col = static_cast<std::size_t>(source.grid_col);
      for (std::int64_t c = 0; c < source.n_used_cols; ++c) {
        if (!std::isnan(row[c])) worker.strip->add(row_at + col, row[c]);
        if (++col == n_cols) col = 0;
      }
    }
  }
  if (!alone) take_mean(end - begin, mosaic.n_cols, worker);
  return arrays.take((frame.south_row + begin) * grid.n_cols, worker.grid_heights_m, worker.grid_origins);
}

Result<void> HeightGrid::Impl::merge(const RasterMosaic& mosaic, int threads,
                                     const std::function<void(double)>& progress) {
  const int n_workers = mosaic.reads_in_parallel() ? threads : 1;
  const std::size_t row_bytes = kBytesPerStripPost * static_cast<std::size_t>(mosaic.n_cols);
  const auto strip_rows = static_cast<std::int64_t>(
      std::clamp<std::size_t>(kStripBytes / static_cast<std::size_t>(n_workers) / row_bytes, 1, kMaxStripRows));
  const std::int64_t n_strips = (mosaic.n_rows + strip_rows - 1) / strip_rows;
  std::vector<Worker> workers(static_cast<std::size_t>(n_workers));
  std::mutex mutex;
  std::optional<Error> failure;
  std::atomic<bool> has_failed{false};
  for_each_job({n_workers, grid.cancel, {}}, n_strips, [&](int w, std::int64_t job) {
    if (has_failed) return;
    const std::int64_t begin = job * strip_rows, end = std::min(begin + strip_rows, mosaic.n_rows);
    if (auto merged = merge_strip(mosaic, begin, end, workers[static_cast<std::size_t>(w)]); !merged) {
      const std::lock_guard lock(mutex);
      if (!failure) failure = merged.error();
      has_failed = true;
    } else if (w == 0 && progress) {
      progress(0.7 * static_cast<double>(end) / static_cast<double>(mosaic.n_rows));
    }
  });
  if (failure) return tl::unexpected(*failure);
  if (is_set(grid.cancel)) return interrupted();
  for (const Worker& worker : workers) {
    counts.source += worker.counts.source;
    counts.overlapping += worker.counts.overlapping;
    counts.disagreeing += worker.counts.disagreeing;
    counts.implausible += worker.counts.implausible;
    field.disagreement_m = std::max(field.disagreement_m, worker.disagreement_m);
  }
  return {};
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
  if (auto merged = impl.merge(mosaic, options.threads, progress); !merged) return tl::unexpected(merged.error());
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
  impl.counts.filled = fill_interior_voids(impl.grid, impl.frame);
  if (progress) progress(0.8);
  impl.counts.falloff = add_falloff(impl.grid, options.base_height_m, *falloff, options.threads);

  HeightField& field = impl.field;
  const double height = static_cast<double>(lattice.height());
  const double north_gap = height - field.post_y(field.n_rows - 1);
  field.continues_south = field.y0 <= field.dy * (1 + 1e-9);
  field.continues_north = north_gap <= field.dy * (1 + 1e-9);
  if (field.continues_south) field.south_pole_m = impl.settle_pole(0, field.y0 <= 0.5);
  if (field.continues_north) field.north_pole_m = impl.settle_pole(field.n_rows - 1, north_gap <= 0.5);
  impl.arrays.build_blocks(field, options.threads, options.cancel, options.on_demand_bytes);
  if (is_set(options.cancel)) return interrupted();
  if (progress) progress(1.0);
  return result;
}

}  // namespace tind
