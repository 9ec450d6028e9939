// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "tests/client/byte_cursor.hpp"
#include "tests/client/tile_id.hpp"

namespace tind::client {

/// A run of stored tiles of one coverage in one row.
struct StoredRun {
  std::uint32_t y = 0, x_first = 0, x_last = 0;
  int coverage = 0;
};

/// What meta.json says of one level; members as in docs/format.md 9.
struct LevelView {
  int level = 0;
  double tolerance_m = 0, spacing_m = 0, height_step_m = 0, max_error_m = 0, rmse_m = 0;
  std::uint64_t n_tiles = 0, n_real = 0, n_partial = 0, n_filler = 0;
  std::uint64_t n_vertices = 0, n_border_vertices = 0, n_seed_vertices = 0, n_triangles = 0, n_posts = 0, bytes = 0;
  std::vector<StoredRun> rows;

  /// True iff the tile is in `rows`; `rows` must be sorted.
  bool has(const TileId& id) const;
};

/// What meta.json says.
struct ManifestView {
  std::string format, mode, horizontal_crs, vertical_datum;
  int format_version = 0, root_count_x = 0, bottom_level = 0;
  LatticeFrame frame;
  double semi_major_m = 0, inverse_flattening = 0;
  double disagreement_m = 0;
  std::array<double, 4> bounds_deg{};
  std::array<double, 2> spacing_deg{};
  std::uint64_t n_source_posts = 0;
  std::string source_kind = "raster";  ///< Or "warped" or "points".
  std::string resampling = "none";     ///< Of warped posts: "bilinear" or "cubic".
  std::vector<LevelView> levels;

  bool has(const TileId& id) const {
    return id.valid() && static_cast<std::size_t>(id.level) < levels.size() &&
           levels[static_cast<std::size_t>(id.level)].has(id);
  }
  std::uint64_t n_tiles() const;
};

/// Reads meta.json. Refuses text that is no JSON, members that are missing or of the wrong type, and numbers that the
/// rest could not work with (lattice or levels out of range, rows outside the level). All else is for the checks.
Outcome<ManifestView> read_manifest(BlobView json);

/// Every rule that docs/format.md 9 states about the manifest alone: one line per violation.
std::vector<std::string> find_manifest_faults(const ManifestView& manifest);

}  // namespace tind::client
