// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/rebuild_options.hpp"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace tind {
namespace {

using nlohmann::json;

template <class T>
void take(const json& options, const char* name, T& value) {
  if (const auto at = options.find(name); at != options.end()) value = at->get<T>();
}

template <class T>
void take(const json& options, const char* name, std::optional<T>& value) {
  if (const auto at = options.find(name); at != options.end()) value = at->get<T>();
}

void read(const json& j, const Manifest& manifest, BuildOptions& options) {
  std::string metres = "equator";
  take(j, "metres_per_degree", metres);
  options.metres = metres == "auto"           ? BuildOptions::Metres::kAuto
                   : metres == "mid-latitude" ? BuildOptions::Metres::kMidLatitude
                                              : BuildOptions::Metres::kEquator;
  options.levels.mode = manifest.mode == "standard" ? LevelMode::kStandard : LevelMode::kNonStandard;
  take(j, "max_level", options.levels.max_level);
  take(j, "tolerance_m", options.levels.tolerance_m);
  take(j, "coarser_tolerances_m", options.levels.coarser_tolerances_m);
  take(j, "finest_m", options.levels.finest_m);
  options.base_height_m = manifest.base_height_m;
  options.falloff_posts = manifest.falloff_posts;
  options.attribution = manifest.attribution;

  RasterOptions& raster = options.source.raster;
  raster.resampling = manifest.resampling == "cubic" ? Resampling::kCubic : Resampling::kBilinear;
  take(j, "nodata", raster.nodata);
  take(j, "metres_per_unit", raster.metres_per_unit);
  take(j, "vertical_datum", raster.vertical_datum);
  take(j, "geoid", raster.geoid);
  PointOptions& points = options.source.points;
  take(j, "source_crs", points.source_crs);
  take(j, "spacing_m", points.spacing_m);
  if (const auto at = j.find("classes"); at != j.end()) {
    if (const auto classes = parse_class_filter(at->get<std::string>())) points.classes = *classes;
  }

  LineOptions& lines = options.lines;
  lines.drainage = false;  // files of the first builders have none
  take(j, "drainage", lines.drainage);
  take(j, "drainage_cells", lines.drainage_cells);
  take(j, "drainage_growth", lines.drainage_growth);
  take(j, "lake_area_m2", lines.lake_area_m2);
  take(j, "sea_level_m", lines.sea_level_m);
}

}  // namespace

Result<BuildOptions> rebuild_options(const Manifest& manifest, const SourceHints& hints) {
  BuildOptions options;
  const json j = json::parse(manifest.options_json, nullptr, false);
  if (!j.is_object()) return fail(ErrorKind::kCorrupt, "the manifest's options are no JSON object");
  try {
    read(j, manifest, options);
  } catch (const json::exception& e) {
    return fail(ErrorKind::kCorrupt, fmt::format("the manifest's options are not those of a builder: {}", e.what()));
  }
  RasterOptions& raster = options.source.raster;
  PointOptions& points = options.source.points;
  options.source.inputs = hints.inputs;
  if (hints.nodata) raster.nodata = hints.nodata;
  if (hints.metres_per_unit) raster.metres_per_unit = hints.metres_per_unit;
  if (!hints.vertical_datum.empty()) raster.vertical_datum = hints.vertical_datum;
  if (!hints.source_crs.empty()) points.source_crs = hints.source_crs;
  if (hints.spacing_m) points.spacing_m = hints.spacing_m;
  if (hints.classes) points.classes = *hints.classes;
  points.metres_per_unit = raster.metres_per_unit;
  if (!raster.geoid.empty() && hints.geoid.empty()) {
    return fail(ErrorKind::kInvalidInput,
                fmt::format("the pyramid was built with the geoid grid {}: give its path with --geoid", raster.geoid));
  }
  raster.geoid = hints.geoid;
  return options;
}

DrainageOptions drainage_options(const Manifest& manifest) {
  const json j = json::parse(manifest.options_json, nullptr, false);
  DrainageOptions drainage;
  take(j, "drainage_cells", drainage.cells);
  take(j, "drainage_growth", drainage.growth);
  take(j, "lake_area_m2", drainage.lake_area_m2);
  take(j, "sea_level_m", drainage.sea_level_m);
  drainage.bottom_level = manifest.bottom_level;
  drainage.max_change_m = manifest.levels.back().tolerance_m / 2;
  return drainage;
}

}  // namespace tind
