// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/height_field.hpp"
#include "core/level_spec.hpp"
#include "core/result.hpp"
#include "storage/manifest.hpp"
#include "storage/readers/gdal_raster.hpp"
#include "storage/readers/height_grid.hpp"
#include "storage/readers/point_grid.hpp"
#include "storage/readers/point_source.hpp"

namespace tind {

/// What the user may say about the inputs, whatever they are.
struct SourceOptions {
  std::vector<std::string> inputs;
  RasterOptions raster;
  PointOptions points;
};

/// What became of the posts.
struct SourceCounts {
  std::uint64_t source = 0;        ///< Posts that the promise is about.
  std::uint64_t filled = 0;        ///< Grid posts inside interior voids, filled smoothly.
  std::uint64_t falloff = 0;       ///< Grid posts of the falloff.
  std::uint64_t interpolated = 0;  ///< Grid posts between irregular ones.
  std::uint64_t overlapping = 0;   ///< Posts that more than one source has.
  std::uint64_t disagreeing = 0;   ///< Of those, posts where the sources differ.
  std::uint64_t duplicates = 0;    ///< Points left out because a lower one rounds to their lattice point.
};

/// The elevation data of a build, rasters or points, as one height field. One thread at a time.
class ElevationSource {
 public:
  /// Opens and checks all inputs (see RasterMosaic::open and PointSource::open). kInvalidInput when rasters and points
  /// are mixed.
  static Result<ElevationSource> open(const SourceOptions& options);

  /// As RasterMosaic::finish_hashing; describe() has the hashes of files only then.
  Result<void> finish_hashing() { return raster_ ? raster_->finish_hashing() : Result<void>(); }

  /// Lines for the user; more of them after load().
  const std::vector<std::string>& notes() const { return notes_; }
  double lon_spacing_deg() const { return raster_ ? raster_->lon_spacing_deg : points_->lon_spacing_deg; }
  double lat_spacing_deg() const { return raster_ ? raster_->lat_spacing_deg : points_->lat_spacing_deg; }
  /// west, south, east, north of the source posts.
  std::array<double, 4> bounds_deg() const;
  /// The source's own spacing in metres; absent where it has only degrees.
  std::optional<double> own_spacing_m() const;
  bool has_points() const { return points_.has_value(); }
  /// Null for points. Valid as long as this object.
  const RasterMosaic* raster() const { return raster_ ? &*raster_ : nullptr; }

  /// Makes the height field; `progress(fraction)` is called from this thread. kInterrupted: `cancel` was set.
  /// `in_memory_bytes`, `may_be_pages`: as HeightGridOptions; those of point clouds are always in scratch files.
  Result<void> load(const Lattice& lattice, double base_height_m, int falloff_posts, const std::string& scratch_dir,
                    int threads, const std::function<void(double)>& progress, CancelFlag cancel = nullptr,
                    std::uint64_t in_memory_bytes = 0, bool may_be_pages = false);
  /// After load(): valid as long as this object.
  const HeightField& field() const { return grid_ ? grid_->field() : point_grid_->field(); }
  /// Moves the field's posts from arrays into pages (HeightField::pages), of which each thread holds so many bytes: for
  /// who looks at posts here and there. Copies of field() are void. kIo: no disk space; kInterrupted.
  Result<void> turn_into_pages(const std::string& scratch_dir, std::size_t held_bytes, int threads, CancelFlag cancel);
  const SourceCounts& counts() const { return counts_; }
  /// Sets the manifest's members about the source; those about its posts after load() only.
  void describe(Manifest& manifest) const;

 private:
  ElevationSource() = default;

  std::optional<RasterMosaic> raster_;
  std::optional<PointSource> points_;
  std::optional<HeightGrid> grid_;
  std::optional<PointGrid> point_grid_;
  SourceCounts counts_;
  std::vector<std::string> notes_;
};

}  // namespace tind
