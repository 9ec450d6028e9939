// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/height_field.hpp"
#include "core/result.hpp"
#include "storage/builder/elevation_source.hpp"
#include "storage/manifest.hpp"

namespace tind {

/// The source that a pyramid was built from, read again: the same posts on the same lattice.
struct SourceGrid {
  ElevationSource source;
  /// The rows [first_row, first_row + n_rows) and columns of the field's grid that hold all its source posts.
  std::int64_t first_row = 0, first_col = 0, n_rows = 0, n_cols = 0;
  std::uint64_t n_posts = 0;       ///< Posts that carry the promise: of a raster, or points.
  std::uint64_t n_grid_posts = 0;  ///< Posts of the grid in the data: n_posts, or those interpolated between points.
  double area_km2 = 0;             ///< Of the cells around these grid posts, on the ellipsoid.

  const HeightField& field() const { return source.field(); }
};

/// Reads the files as the pyramid's sources were read. kInvalidInput when they are not the manifest's (SHA-256, place,
/// number of posts): the message names the difference and what to try. `progress(fraction)` is called from this thread.
Result<SourceGrid> load_source(const Manifest& manifest, const SourceOptions& options, const std::string& scratch_dir,
                               int threads, const std::function<void(double)>& progress);

/// Area in km2 of the cell around a post in row `row` (one spacing wide and high, cut off at the poles), on the
/// ellipsoid.
double cell_area_km2(const HeightField& field, std::int64_t row);

}  // namespace tind
