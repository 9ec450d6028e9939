// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/elevation_source.hpp"

#include <algorithm>
#include <utility>

namespace tind {

Result<ElevationSource> ElevationSource::open(const SourceOptions& options) {
  ElevationSource source;
  const auto n_point_files = std::count_if(options.inputs.begin(), options.inputs.end(), PointSource::is_point_file);
  if (n_point_files > 0 && static_cast<std::size_t>(n_point_files) < options.inputs.size()) {
    const auto raster = std::find_if_not(options.inputs.begin(), options.inputs.end(), PointSource::is_point_file);
    const auto points = std::find_if(options.inputs.begin(), options.inputs.end(), PointSource::is_point_file);
    return fail(ErrorKind::kInvalidInput, *points + " holds points and " + *raster +
                                              " is a raster: a pyramid is made of one kind; build two, or turn one "
                                              "into the other first");
  }
  if (n_point_files > 0) {
    auto points = PointSource::open(options.inputs, options.points);
    if (!points) return tl::unexpected(points.error());
    source.points_.emplace(std::move(*points));
    source.notes_ = source.points_->notes;
    return source;
  }
  auto raster = RasterMosaic::open(options.inputs, options.raster);
  if (!raster) return tl::unexpected(raster.error());
  source.raster_.emplace(std::move(*raster));
  source.notes_ = source.raster_->notes;
  return source;
}

std::array<double, 4> ElevationSource::bounds_deg() const {
  if (points_) return {points_->west_deg, points_->south_deg, points_->east_deg, points_->north_deg};
  const RasterMosaic& m = *raster_;
  return {m.west_deg, m.south_deg, m.west_deg + m.lon_spacing_deg * static_cast<double>(m.n_cols - 1),
          m.south_deg + m.lat_spacing_deg * static_cast<double>(m.n_rows - 1)};
}

std::optional<double> ElevationSource::own_spacing_m() const {
  if (points_) return points_->spacing_m;
  if (raster_->warped) return raster_->native_spacing_m;
  return std::nullopt;
}

Result<void> ElevationSource::load(const Lattice& lattice, double base_height_m, int falloff_posts,
                                   const std::string& scratch_dir, int threads,
                                   const std::function<void(double)>& progress, CancelFlag cancel,
                                   std::uint64_t in_memory_bytes, bool may_be_pages) {
  if (points_) {
    PointGridOptions options;
    options.base_height_m = base_height_m;
    options.falloff_posts = falloff_posts;
    options.scratch_dir = scratch_dir;
    options.threads = threads;
    options.cancel = cancel;
    auto grid = PointGrid::load(*points_, lattice, options, progress);
    if (!grid) return tl::unexpected(grid.error());
    point_grid_.emplace(std::move(*grid));
    const PointGridCounts& c = point_grid_->counts();
    counts_ = {c.kept, c.filled, c.falloff, c.interpolated, 0, 0, c.duplicates};
    notes_.insert(notes_.end(), point_grid_->notes().begin(), point_grid_->notes().end());
    return {};
  }
  HeightGridOptions options;
  options.base_height_m = base_height_m;
  options.falloff_posts = falloff_posts;
  options.scratch_dir = scratch_dir;
  options.threads = threads;
  options.cancel = cancel;
  options.in_memory_bytes = in_memory_bytes;
  options.may_be_pages = may_be_pages;
  auto grid = HeightGrid::load(*raster_, lattice, options, progress);
  if (!grid) return tl::unexpected(grid.error());
  grid_.emplace(std::move(*grid));
  const HeightGridCounts& c = grid_->counts();
  counts_ = {c.source, c.filled, c.falloff, 0, c.overlapping, c.disagreeing, 0};
  notes_.insert(notes_.end(), grid_->notes().begin(), grid_->notes().end());
  return {};
}

Result<void> ElevationSource::turn_into_pages(const std::string& scratch_dir, std::size_t held_bytes, int threads,
                                              CancelFlag cancel) {
  return grid_ ? grid_->turn_into_pages(scratch_dir, held_bytes, threads, cancel)
               : point_grid_->turn_into_pages(scratch_dir, held_bytes, threads, cancel);
}

void ElevationSource::describe(Manifest& m) const {
  m.bounds_deg = bounds_deg();
  m.spacing_deg = {lon_spacing_deg(), lat_spacing_deg()};
  m.sources.clear();
  if (grid_ || point_grid_) {
    m.disagreement_m = field().disagreement_m;
    m.n_source_posts = counts_.source;
    m.n_filled_posts = counts_.filled;
    m.n_falloff_posts = counts_.falloff;
  }
  if (points_) {
    m.source_kind = "points";
    m.vertical_datum = points_->vertical_datum;
    m.heights = points_->height_kind;
    m.vertical_operation = points_->vertical_operation;
    for (const PointFile& f : points_->files) m.sources.push_back({f.name, f.sha256, 0, 0, f.n_points, f.crs, ""});
    return;
  }
  m.source_kind = raster_->warped ? "warped" : "raster";
  m.resampling = raster_->resampling;
  m.vertical_datum = raster_->vertical_datum;
  m.heights = raster_->height_kind;
  m.vertical_operation = raster_->vertical_operation;
  for (const RasterSource& s : raster_->sources) {
    m.sources.push_back({s.name, s.sha256, s.n_cols, s.n_rows, 0, s.crs, s.operation});
  }
}

}  // namespace tind
