// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/verify.hpp"

#include <fmt/format.h>

#include <chrono>
#include <nlohmann/json.hpp>

#include "tests/client/checks.hpp"

namespace tind::client {

void add_checks(Report& report) {
  report.add("manifest", "meta.json keeps the rules of docs/format.md 9", "levels");
  report.add("tiles-answer", "every stored tile answers .vn, .parts and .terrain with its media type", "answers");
  report.add("outside", "tiles that are not stored answer 404", "answers");
  report.add("decode", "every answer decodes, bounds-checked, to the last byte", "bodies");
  report.add("totals", "counts, errors and coverage in meta.json are those of the tiles", "figures");
  report.add("assembly", "the assembled tile is the client's own assembly of its nine parts", "tiles");
  report.add("pieces", "the single-piece routes give the records of the bundle", "pieces");
  report.add("tile-header", "level, E_L, height range, coverage and errors of a tile are right", "tiles");
  report.add("outline", "outline = four corners and four edges, strictly monotone in ring order", "tiles");
  report.add("interior", "interior vertices strictly inside, distinct, in Morton order", "vertices");
  report.add("triangles", "positive plan areas sum exactly to the tile; each inner edge once each way", "triangles");
  report.add("virtual-triangles", "the VT list is exactly the triangles with a border edge", "VTs");
  report.add("shared-edges", "both tiles beside an edge have the same vertices, heights and entry levels", "edges");
  report.add("shared-corners", "all tiles around a corner, and around a pole, have one height there", "corners");
  report.add("nested-borders", "every border vertex of a level is on the next one's line, same height and entry",
             "edges");
  report.add("runs", "run codes = entry-level decoding of the finer lines, for every gap", "runs");
  report.add("codes", "the codes route counts what the entry levels say, for every coarser gap", "borders");
  report.add("cuts", "random quadtree cuts of the globe are watertight in integers", "cuts");
  report.add("source-grid", "meta.json's kind, spacing and bounds are those of the source's posts", "figures");
  report.add("warped-spacing", "warped posts are nowhere coarser than the source's cells, at multiples of the spacing",
             "figures");
  report.add("kept-points", "meta.json and every level count exactly the source's kept points", "counts");
  report.add("source-error", "|TIN - h| <= E_L at every source post on every level", "posts");
  report.add("stored-error", "each tile's stored post count, max error and RMSE are the measured ones", "tiles");
  report.add("tessellated-error", "|TIN - h| <= E_L in VTs re-triangulated against each finer level", "posts");
  report.add("cut-error", "|TIN - h| <= E_L in the re-triangulated VTs of the cuts", "posts");
  report.add("terrain", ".terrain meshes cover the tile, no flat or turned triangle, sorted edge lists", "tiles");
  report.add("terrain-error", "|TIN - h| <= E_L at every source post in .terrain tiles that rounding leaves whole",
             "posts");
  report.add("terrain-borders", "same-level .terrain borders decode to the same positions, heights, normals",
             "borders");
  report.add("layer-json", "layer.json names exactly the stored tiles, with every field clients need", "levels");
}

Outcome<std::string> find_only_dataset(TileSource& source) {
  const auto answer = source.get("/datasets");
  if (!answer) return refuse(answer.error());
  if (answer->status != 200) return refuse(fmt::format("/datasets answers {}", answer->status));
  const auto json = nlohmann::json::parse(answer->body.begin(), answer->body.end(), nullptr, false);
  if (!json.is_object() || !json.contains("datasets") || !json["datasets"].is_array()) {
    return refuse("/datasets is not the JSON that docs/http.md describes");
  }
  std::string names;
  for (const auto& dataset : json["datasets"]) {
    if (!dataset.is_object() || !dataset.contains("name") || !dataset["name"].is_string()) {
      return refuse("/datasets lists a dataset without a name");
    }
    names += (names.empty() ? "" : ", ") + dataset["name"].get<std::string>();
  }
  const std::size_t n = json["datasets"].size();
  if (n == 1) return names;
  return refuse(n == 0 ? std::string("the server has no dataset")
                       : fmt::format("the server has {} datasets ({}): add one's name to the URL", n, names));
}

Outcome<ManifestView> fetch_manifest(TileSource& source, const std::string& dataset) {
  const std::string path = "/" + dataset + "/meta.json";
  const auto answer = source.get(path);
  if (!answer) return refuse(answer.error());
  if (answer->status != 200) {
    return refuse(fmt::format("{} answers {}: is '{}' the name of a dataset there?", path, answer->status, dataset));
  }
  return read_manifest(answer->body);
}

GridClaim claim_of(const ManifestView& manifest) {
  return {manifest.frame, manifest.spacing_deg, manifest.resampling == "cubic"};
}

Outcome<std::unique_ptr<Report>> verify(TileSource& source, const SourcePosts* posts, const VerifyOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  options.progress("reading the manifest");
  const auto manifest = fetch_manifest(source, options.dataset);
  if (!manifest) return refuse(manifest.error());

  auto report = std::make_unique<Report>();
  add_checks(*report);
  report->dataset = options.dataset;
  report->seed = options.seed;
  report->sample = options.sample;
  report->tiles_stored = manifest->n_tiles();
  report->disagreement_m = manifest->disagreement_m;
  if (posts != nullptr) report->sources = posts->names;
  for (const auto& level : manifest->levels) {
    LevelFigures figures;
    figures.level = level.level;
    figures.tolerance_m = level.tolerance_m;
    report->levels.push_back(figures);
  }
  options.progress(fmt::format("{} tiles on {} levels", report->tiles_stored, report->levels.size()));
  Pyramid pyramid(*manifest, options.sample, options.seed);
  report->tiles_checked = pyramid.nodes().size();
  Run run{source, posts, options, *manifest, pyramid, *report};

  const auto step = [&](const char* what, void (*check)(Run&)) {
    options.progress(what);
    check(run);
  };
  step("manifest", check_manifest);
  step("tiles outside the data", check_outside);
  step("fetching tiles", fetch_tiles);
  step("totals", check_totals);
  step("single pieces", check_pieces);
  step("codes", check_codes);
  step("shared borders", check_shared_borders);
  step("nested borders", check_nested_borders);
  step("runs", check_runs);
  step("grid of posts", check_source_grid);
  step("spacing of warped posts", check_warped_spacing);
  step("kept points", check_kept_points);
  step("source posts", check_source_errors);
  step("source posts in re-triangulated virtual triangles", check_tessellated_errors);
  step("cuts", check_cuts);
  step("fetching .terrain", fetch_terrain);
  step(".terrain borders", check_terrain_borders);
  step("layer.json", check_layer_json);
  report->seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return report;
}

}  // namespace tind::client
