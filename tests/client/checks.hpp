// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <functional>
#include <mutex>
#include <string>
#include <vector>

#include "tests/client/pyramid.hpp"
#include "tests/client/terrain_decode.hpp"
#include "tests/client/verify.hpp"

namespace tind::client {

/// A border of a .terrain tile as its neighbour must have it too.
struct TerrainBorder {
  std::vector<std::uint16_t> positions;
  std::vector<double> heights_m;
  std::vector<std::array<std::uint8_t, 2>> normals;
};

/// What all checks work on.
struct Run {
  TileSource& source;
  const SourcePosts* posts;
  const VerifyOptions& options;
  const ManifestView& manifest;
  Pyramid& pyramid;
  Report& report;
  std::mutex figures_mutex{};                                   ///< Guards report.levels and report.cuts.
  std::vector<std::array<TerrainBorder, 4>> terrain_borders{};  ///< Per node; west, south, east, north.

  std::string route(const std::string& rest) const { return "/" + options.dataset + "/" + rest; }
  Check& check(const char* id) const { return *report.find(id); }
  LevelFigures& figures(int level) const { return report.levels[static_cast<std::size_t>(level)]; }
  double tolerance_m(int level) const { return manifest.levels[static_cast<std::size_t>(level)].tolerance_m; }
};

/// Sets up the checks in the order of the summary.
void add_checks(Report& report);

/// The manifest against its own rules; tiles that must not exist; the single-piece and code routes on a sample.
void check_manifest(Run& run);
void check_outside(Run& run);
void check_pieces(Run& run);
void check_codes(Run& run);
/// Fetches and decodes every tile in scope into the pyramid, compares with its parts, and looks at it on its own.
void fetch_tiles(Run& run);
/// Counts of the manifest against what was fetched.
void check_totals(Run& run);
/// Same-level neighbours, corners, poles; nesting from level to level; runs against finer lines.
void check_shared_borders(Run& run);
void check_nested_borders(Run& run);
void check_runs(Run& run);
/// Random and adversarial quadtree cuts of the whole globe.
void check_cuts(Run& run);
/// The manifest's grid of posts, or its number of points, against the sources.
void check_source_grid(Run& run);
void check_warped_spacing(Run& run);
void check_kept_points(Run& run);
/// |TIN - h| at the source's posts: as stored, and with all four sides tessellated against each finer level.
void check_source_errors(Run& run);
void check_tessellated_errors(Run& run);
/// Largest error of the posts in the re-triangulated virtual triangles of `tile`; findings go to `check`. Returns
/// metres, 0 when no post lies in one.
struct TessellatedTile;
double scan_changed_triangles(const Run& run, const TileId& id, const TessellatedTile& mesh, Check& check,
                              const std::string& situation);
/// Largest error of the posts in `triangles` of a tile, each post in each triangle that it lies in; findings go to
/// `check`. Metres, 0 when no post lies in one.
struct SurfacePoint;
/// `is_excused(x, y, height_m)`: asked of a post (steps from the SW corner) that is beyond E_L, whether that is only to
/// be noted; none is where it is null.
using IsExcused = std::function<bool(double x, double y, double height_m)>;
double scan_surface(const Run& run, const TileId& id, const std::vector<std::array<SurfacePoint, 3>>& triangles,
                    Check& check, const std::string& situation, const IsExcused& is_excused = nullptr);
/// .terrain tiles and layer.json.
void fetch_terrain(Run& run);
void check_terrain_borders(Run& run);
void check_layer_json(Run& run);

}  // namespace tind::client
