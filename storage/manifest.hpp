// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "core/format/bytes.hpp"
#include "core/lattice.hpp"
#include "core/result.hpp"
#include "core/virtual_node.hpp"

namespace tind {

inline constexpr int kFormatVersion = 1;

/// Stored tiles (level, x_first..x_last, y), all of one coverage.
struct TileRun {
  std::uint32_t y = 0;
  std::uint32_t x_first = 0;
  std::uint32_t x_last = 0;
  TileCoverage coverage = TileCoverage::kFiller;
};

/// One level of the manifest; members as in docs/format.md 9.
struct LevelInfo {
  int level = 0;
  double tolerance_m = 0;
  double spacing_m = 0;
  double height_step_m = 0;  ///< Quantized-mesh border heights are multiples of this power of two.
  std::uint64_t n_tiles = 0, n_real = 0, n_partial = 0, n_filler = 0;
  std::uint64_t n_vertices = 0, n_border_vertices = 0, n_seed_vertices = 0, n_triangles = 0, n_posts = 0;
  double max_error_m = 0, rmse_m = 0;
  std::uint64_t bytes = 0;
  std::vector<TileRun> rows;
};

struct SourceInfo {
  std::string name;
  std::string sha256;
  std::int64_t n_cols = 0, n_rows = 0;  ///< Of a raster.
  std::uint64_t n_points = 0;           ///< Of a point source, as read.
  std::string crs;                      ///< Name of its own CRS; empty: it says none.
  std::string operation;                ///< PROJ pipeline from EPSG:4326 to that CRS; empty: posts are not warped.
};

/// Break lines that the vertices of a pyramid follow; counts of chains.
struct LineCounts {
  std::uint64_t streams = 0, shores = 0, given = 0;
  std::uint64_t vertices = 0;  ///< Drawn at the deepest level.
};

/// The manifest record (docs/format.md 9) as a value.
struct Manifest {
  int format_version = kFormatVersion;
  std::string generator;
  std::string attribution;
  std::string vertical_datum;
  std::string heights = "unknown";     ///< "orthometric", "ellipsoidal" or "unknown".
  std::string vertical_operation;      ///< PROJ's, that made the heights ellipsoidal; empty: they are as in the source.
  std::string source_kind = "raster";  ///< "raster", "warped" or "points".
  std::string resampling = "none";     ///< "none", "bilinear" or "cubic".
  std::string mode;
  Lattice lattice;
  int bottom_level = 0;
  double base_height_m = 0;
  int falloff_posts = 0;
  double disagreement_m = 0;
  std::array<double, 4> bounds_deg{};   ///< west, south, east, north
  std::array<double, 2> spacing_deg{};  ///< longitude, latitude
  std::vector<SourceInfo> sources;
  std::uint64_t n_source_posts = 0, n_filled_posts = 0, n_falloff_posts = 0;
  LineCounts lines;
  std::string options_json = "{}";
  /// One of several parts of a pyramid: has the tiles above the cut level and its own below. count 1: the whole.
  int shard_index = 0, shard_count = 1, shard_cut_level = 0;
  std::string content_hash;  ///< Of all keys and values but the manifest's own (docs/format.md 9).
  std::vector<LevelInfo> levels;

  /// True iff the tile is in `levels[key.level].rows`.
  bool has_tile(const TileKey& key) const;
};

/// The manifest's JSON text (one line).
std::string encode_manifest(const Manifest& manifest);
/// Fails with kCorrupt on malformed JSON or values out of range, kUnsupported on another format version.
/// Untrusted-safe.
Result<Manifest> decode_manifest(ByteView json);

}  // namespace tind
