// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/point_grid.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>

#include <fmt/format.h>

#include "core/delaunay_surface.hpp"
#include "core/drainage/flow_run.hpp"
#include "storage/readers/falloff.hpp"
#include "storage/readers/gdal_raster.hpp"
#include "storage/readers/point_scatter.hpp"
#include "storage/readers/post_arrays.hpp"
#include "storage/readers/void_fill.hpp"

namespace tind {
namespace {

/// Spacings along a block of points: 256 points on average.
constexpr double kBlockSpacings = 16;
/// Radius, in spacings, of the largest circle through three points between which the surface is theirs.
constexpr double kMaxRadius = 16;
/// Points that far around a window decide about its posts (core/delaunay_surface.hpp); one more for rounding.
constexpr double kHalo = 2 * kMaxRadius + 1;
constexpr std::int64_t kWindowPosts = 256;
/// A window with more points around it is taken in quarters, down to kMinWindowPosts.
constexpr std::size_t kMaxSites = std::size_t{1} << 20;
constexpr std::int64_t kMinWindowPosts = 16;
/// Grid posts a point, beyond a grid of some size: points scattered more thinly are a mistake (two countries at once).
constexpr double kMaxPostsPerPoint = 4096, kSomePosts = 1e8;
/// Rows that stay free between the rim and a pole, so that the field never has to meet there in one point.
constexpr std::int64_t kRowsToPole = 2;

/// Posts [row, row + n_rows) x [col, col + n_cols) of the grid.
struct Window {
  std::int64_t row = 0, col = 0, n_rows = 0, n_cols = 0;
};

}  // namespace

struct PointGrid::Impl {
  PostArrays arrays;
  ScatteredPoints points;
  HeightField field;
  PointGridCounts counts;
  std::vector<std::string> notes;
  PostGrid grid;
  DataFrame frame;
  double x_turn = 0;

  /// Lays the grid around the points. Returns the falloff that fits.
  Result<std::int64_t> lay_out(const PointSource& source, const Lattice& lattice, const PointGridOptions& options);
  Result<void> scatter(const PointSource& source, const PointGridOptions& options,
                       const std::function<void(double)>& progress);
  Result<void> interpolate(int threads, const std::function<void(double)>& progress);
  void interpolate_window(const Window& w) const;
};

Result<std::int64_t> PointGrid::Impl::lay_out(const PointSource& source, const Lattice& lattice,
                                              const PointGridOptions& options) {
  const auto bad = [&](const std::string& what) {
    return fail(ErrorKind::kInvalidInput, fmt::format("{}: {}", source.files.front().path, what));
  };
  const double step = lattice.step_deg();
  const double width = static_cast<double>(lattice.width()), height = static_cast<double>(lattice.height());
  field.lattice = lattice;
  field.dx = source.lon_spacing_deg / step;
  field.dy = source.lat_spacing_deg / step;
  field.base_height_m = options.base_height_m;
  // Posts lie at whole spacings from the lattice's south-west corner; every point has posts within one spacing on all
  // sides.
  const auto first_post = [](double at, double spacing) {
    return static_cast<std::int64_t>(std::ceil(at / spacing)) - 1;
  };
  const auto last_post = [](double at, double spacing) {
    return static_cast<std::int64_t>(std::floor(at / spacing)) + 1;
  };
  const double rows_to_pole = height / field.dy, cols_around = width / field.dx;
  if (!(rows_to_pole < 1e12) || !(cols_around < 1e12))
    return bad("the spacing of its points is too small; give --spacing M");
  const std::int64_t south_row = first_post(lattice_y(lattice, source.south_deg), field.dy);
  const std::int64_t north_row = last_post(lattice_y(lattice, source.north_deg), field.dy);
  const std::int64_t west_col = first_post(lattice_x(lattice, source.west_deg), field.dx);
  const std::int64_t east_col = last_post(lattice_x(lattice, source.east_deg), field.dx);
  const std::int64_t n_data_rows = north_row - south_row + 1, n_data_cols = east_col - west_col + 1;

  const std::int64_t wanted = options.falloff_posts;
  const std::int64_t to_south = south_row - kRowsToPole;
  const std::int64_t to_north = static_cast<std::int64_t>(std::floor(rows_to_pole)) - kRowsToPole - north_row;
  const std::int64_t around = (static_cast<std::int64_t>(std::floor(cols_around)) - n_data_cols) / 2;
  if (around < 1) return bad("its points reach all around the globe; make a raster of them first: gdal_grid");
  if (to_south < 1 || to_north < 1) return bad("its points reach a pole; make a raster of them first: gdal_grid");
  const std::int64_t falloff = std::min({wanted, to_south, to_north, around});
  if (falloff < wanted) {
    notes.push_back(fmt::format("the points leave little room on the globe: the falloff is {} posts instead of {}",
                                falloff, wanted));
  }
  const double n_posts =
      static_cast<double>(n_data_rows + 2 * falloff) * static_cast<double>(n_data_cols + 2 * falloff);
  if (n_posts > kSomePosts + kMaxPostsPerPoint * static_cast<double>(source.n_used)) {
    return bad(
        fmt::format("{} points {:.3g} m apart lie scattered over {:.3g} grid posts; build their parts one by one, or "
                    "give a coarser --spacing M",
                    source.n_used, source.spacing_m, n_posts));
  }
  grid.n_rows = n_data_rows + 2 * falloff;
  grid.n_cols = n_data_cols + 2 * falloff;
  frame = {falloff, falloff + n_data_rows - 1, falloff, falloff + n_data_cols - 1, true, true};
  auto made = PostArrays::create(options.scratch_dir, grid.n_rows, grid.n_cols);
  if (!made) return tl::unexpected(made.error());
  arrays = std::move(*made);
  grid = arrays.grid();
  grid.cancel = options.cancel;
  field.n_rows = grid.n_rows;
  field.n_cols = grid.n_cols;
  field.x0 = static_cast<double>(west_col - falloff) * field.dx;
  field.y0 = static_cast<double>(south_row - falloff) * field.dy;
  if (field.x0 < 0) {
    field.x0 += width;
    x_turn = width;
  }
  arrays.attach(field);
  return falloff;
}

Result<void> PointGrid::Impl::scatter(const PointSource& source, const PointGridOptions& options,
                                      const std::function<void(double)>& progress) {
  ScatterOptions o;
  o.lattice = field.lattice;
  o.x_turn = x_turn;
  // Points lie at least a spacing from the grid's corner, so that half a step does not matter.
  o.x0 = std::floor(field.x0) + 0.5;
  o.y0 = std::floor(field.y0) + 0.5;
  o.side = std::max(1.0, std::round(kBlockSpacings * std::sqrt(field.dx * field.dy)));
  o.n_rows = static_cast<std::int64_t>(std::floor((field.post_y(frame.north_row) - o.y0) / o.side)) + 1;
  o.n_cols = static_cast<std::int64_t>(std::floor((field.post_x(frame.east_col) - o.x0) / o.side)) + 1;
  o.scratch_dir = options.scratch_dir;
  o.memory_bytes = options.memory_bytes;
  o.cancel = options.cancel;
  auto scattered = scatter_points(source, o, progress);
  if (!scattered) return tl::unexpected(scattered.error());
  points = std::move(*scattered);
  field.points = {o.x0, o.y0, o.side, o.n_rows, o.n_cols, points.first.data(), points.posts()};
  counts.kept = points.first.back();
  counts.duplicates = points.n_duplicates;
  return {};
}

void PointGrid::Impl::interpolate_window(const Window& w) const {
  // In spacings from the grid's corner: posts have whole coordinates, east and north are alike, and every window sees
  // the same numbers.
  const auto first_col = static_cast<double>(w.col), last_col = static_cast<double>(w.col + w.n_cols - 1);
  const auto first_row = static_cast<double>(w.row), last_row = static_cast<double>(w.row + w.n_rows - 1);
  std::vector<SurfaceSite> sites;
  const auto x_of = [&](double u) { return field.x0 + u * field.dx; };
  const auto y_of = [&](double v) { return field.y0 + v * field.dy; };
  field.points.for_blocks(
      x_of(first_col - kHalo), y_of(first_row - kHalo), x_of(last_col + kHalo), y_of(last_row + kHalo),
      [&](const PointPost& p) {
        const SurfaceSite s{(p.x - field.x0) / field.dx, (p.y - field.y0) / field.dy, p.height_m};
        if (s.x < first_col - kHalo || s.x > last_col + kHalo || s.y < first_row - kHalo || s.y > last_row + kHalo)
          return;
        sites.push_back(s);
      });
  if (sites.empty()) return;
  if (sites.size() > kMaxSites && std::max(w.n_rows, w.n_cols) > kMinWindowPosts) {
    const std::int64_t south = (w.n_rows + 1) / 2, west = (w.n_cols + 1) / 2;
    for (const Window& quarter :
         {Window{w.row, w.col, south, west}, Window{w.row, w.col + west, south, w.n_cols - west},
          Window{w.row + south, w.col, w.n_rows - south, west},
          Window{w.row + south, w.col + west, w.n_rows - south, w.n_cols - west}}) {
      if (quarter.n_rows > 0 && quarter.n_cols > 0) interpolate_window(quarter);
    }
    return;
  }
  const auto n = static_cast<std::size_t>(w.n_rows * w.n_cols);
  std::vector<float> heights(n);
  interpolate_posts(sites, {first_col, first_row, 1, w.n_rows, w.n_cols}, kMaxRadius, heights);

  // No point may lie outside the data: posts within one spacing of a point that no triangle covers get the nearest
  // one's height.
  const auto distance2 = [](const SurfaceSite& s, double x, double y) {
    return (s.x - x) * (s.x - x) + (s.y - y) * (s.y - y);
  };
  std::vector<const SurfaceSite*> nearest(n, nullptr);
  for (const SurfaceSite& s : sites) {
    const auto c_first = std::max(w.col, static_cast<std::int64_t>(std::ceil(s.x - 1)));
    const auto c_last = std::min(w.col + w.n_cols - 1, static_cast<std::int64_t>(std::floor(s.x + 1)));
    const auto r_first = std::max(w.row, static_cast<std::int64_t>(std::ceil(s.y - 1)));
    const auto r_last = std::min(w.row + w.n_rows - 1, static_cast<std::int64_t>(std::floor(s.y + 1)));
    for (std::int64_t r = r_first; r <= r_last; ++r) {
      for (std::int64_t c = c_first; c <= c_last; ++c) {
        const SurfaceSite*& best = nearest[static_cast<std::size_t>((r - w.row) * w.n_cols + c - w.col)];
        const auto x = static_cast<double>(c), y = static_cast<double>(r);
        const auto key = [&](const SurfaceSite& site) {
          return std::make_tuple(distance2(site, x, y), site.y, site.x);
        };
        if (best == nullptr || key(s) < key(*best)) best = &s;
      }
    }
  }
  for (std::size_t i = 0; i < n; ++i) {
    if (std::isnan(heights[i])) {
      if (nearest[i] == nullptr) continue;
      heights[i] = nearest[i]->height_m;
    }
    const auto k = static_cast<std::int64_t>(i);
    const std::int64_t at = (w.row + k / w.n_cols) * grid.n_cols + w.col + k % w.n_cols;
    grid.heights_m[at] = heights[i];
    grid.origins[at] = PostOrigin::kSource;
  }
}

Result<void> PointGrid::Impl::interpolate(int threads, const std::function<void(double)>& progress) {
  std::vector<Window> windows;
  for (std::int64_t r = frame.south_row; r <= frame.north_row; r += kWindowPosts) {
    for (std::int64_t c = frame.west_col; c <= frame.east_col; c += kWindowPosts) {
      windows.push_back(
          {r, c, std::min(kWindowPosts, frame.north_row - r + 1), std::min(kWindowPosts, frame.east_col - c + 1)});
    }
  }
  // Windows write their own posts alone, so their order does not matter.
  const auto n_windows = static_cast<std::int64_t>(windows.size());
  for_each_job({threads, grid.cancel, {}}, n_windows, [&](int worker, std::int64_t i) {
    interpolate_window(windows[static_cast<std::size_t>(i)]);
    if (worker == 0 && progress) progress(static_cast<double>(i + 1) / static_cast<double>(n_windows));
  });
  if (is_set(grid.cancel)) return interrupted();
  return {};
}

PointGrid::PointGrid(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PointGrid::PointGrid(PointGrid&&) noexcept = default;
PointGrid& PointGrid::operator=(PointGrid&&) noexcept = default;
PointGrid::~PointGrid() = default;
const HeightField& PointGrid::field() const { return impl_->field; }
Result<void> PointGrid::turn_into_pages(const std::string& scratch_dir, std::size_t held_bytes, int threads,
                                        CancelFlag cancel) {
  return impl_->arrays.turn_into_pages(impl_->field, scratch_dir, held_bytes, threads, cancel);
}
const PointGridCounts& PointGrid::counts() const { return impl_->counts; }
const std::vector<std::string>& PointGrid::notes() const { return impl_->notes; }

Result<PointGrid> PointGrid::load(const PointSource& source, const Lattice& lattice, const PointGridOptions& options,
                                  const std::function<void(double)>& progress) {
  if (options.falloff_posts < 1) return fail(ErrorKind::kInvalidInput, "the falloff needs at least 1 post");
  if (!(std::abs(options.base_height_m) <= kMaxHeightM)) {
    return fail(ErrorKind::kInvalidInput,
                fmt::format("base height {} m is beyond +-{} m", options.base_height_m, kMaxHeightM));
  }
  const auto part = [&](double from, double to) -> std::function<void(double)> {
    if (!progress) return {};
    return [&progress, from, to](double fraction) { progress(from + fraction * (to - from)); };
  };
  PointGrid result(std::make_unique<Impl>());
  Impl& impl = *result.impl_;
  const auto falloff = impl.lay_out(source, lattice, options);
  if (!falloff) return tl::unexpected(falloff.error());
  if (auto ok = impl.scatter(source, options, part(0, 0.5)); !ok) return tl::unexpected(ok.error());
  if (auto ok = impl.interpolate(options.threads, part(0.5, 0.9)); !ok) return tl::unexpected(ok.error());

  // The fills know posts of the source only; what they leave as such is interpolated.
  impl.counts.filled = fill_interior_voids(impl.grid, impl.frame);
  impl.counts.falloff = add_falloff(impl.grid, options.base_height_m, *falloff, options.threads);
  for (std::int64_t i = 0; i < impl.grid.n_rows * impl.grid.n_cols; ++i) {
    if (impl.grid.origins[i] != PostOrigin::kSource) continue;
    impl.grid.origins[i] = PostOrigin::kInterpolated;
    ++impl.counts.interpolated;
  }
  impl.arrays.build_blocks(impl.field, options.threads, options.cancel);
  if (is_set(options.cancel)) return interrupted();
  if (impl.counts.duplicates > 0) {
    impl.notes.push_back(
        fmt::format("{} points lie within a lattice step of a lower one and are left out", impl.counts.duplicates));
  }
  if (progress) progress(1.0);
  return result;
}

}  // namespace tind
