// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/build.hpp"

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <numbers>
#include <thread>

#include "storage/builder/output_file.hpp"
#include "storage/tile_store.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

constexpr const char* kGenerator = "tind-build 0.1.0";
// Share of the whole work that reading takes, for the progress line.
constexpr double kReadShare = 0.08;
constexpr double kLineShare = 0.1;

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

const char* metres_name(BuildOptions::Metres metres) {
  switch (metres) {
    case BuildOptions::Metres::kEquator:
      return "equator";
    case BuildOptions::Metres::kMidLatitude:
      return "mid-latitude";
    case BuildOptions::Metres::kAuto:
      break;
  }
  return "auto";
}

// As parse_class_filter reads it.
std::string class_filter_text(const ClassFilter& classes) {
  if (classes.all()) return "all";
  std::string text;
  for (std::size_t k = 0; k < classes.size(); ++k) {
    if (classes[k]) text += fmt::format("{}{}", text.empty() ? "" : ",", k);
  }
  return text;
}

// What shapes the bytes, for the manifest.
std::string options_to_json(const BuildOptions& options, bool has_points, const SurfaceLines& lines) {
  nlohmann::json j = {{"base_height_m", options.base_height_m},
                      {"falloff_posts", options.falloff_posts},
                      {"metres_per_degree", metres_name(options.metres)},
                      {"drainage", options.lines.drainage}};
  if (options.levels.max_level) j["max_level"] = *options.levels.max_level;
  if (options.levels.tolerance_m) {
    j["tolerance_m"] = *options.levels.tolerance_m;
    if (!options.levels.coarser_tolerances_m.empty()) j["coarser_tolerances_m"] = options.levels.coarser_tolerances_m;
  }
  if (options.levels.finest_m) j["finest_m"] = *options.levels.finest_m;
  const RasterOptions& raster = options.source.raster;
  if (raster.nodata) j["nodata"] = *raster.nodata;
  if (raster.metres_per_unit) j["metres_per_unit"] = *raster.metres_per_unit;
  if (!raster.vertical_datum.empty()) j["vertical_datum"] = raster.vertical_datum;
  if (!raster.geoid.empty()) j["geoid"] = std::filesystem::path(raster.geoid).filename().string();
  if (has_points) j["classes"] = class_filter_text(options.source.points.classes);
  if (!options.source.points.source_crs.empty()) j["source_crs"] = options.source.points.source_crs;
  if (options.source.points.spacing_m) j["spacing_m"] = *options.source.points.spacing_m;
  if (options.lines.drainage) {
    j["drainage_cells"] = lines.drainage_cells;
    j["drainage_growth"] = options.lines.drainage_growth;
    j["lake_area_m2"] = lines.lake_area_m2;
    if (options.lines.sea_level_m) j["sea_level_m"] = *options.lines.sea_level_m;
  }
  for (const BreakLineSource& given : lines.given_sources) {
    j["break_lines"].push_back({{"name", given.name}, {"sha256", given.sha256}, {"lakes", given.lakes}});
  }
  return j.dump();
}

// What would fail at the end is known at the start.
Result<void> check_lines_out(const BuildOptions& options) {
  const std::string& path = options.lines.lines_out;
  if (path.empty()) return {};
  if (!path.ends_with(".gpkg")) {
    return fail(ErrorKind::kInvalidInput,
                path + ": lines are written as a GeoPackage; name it, for example streams.gpkg");
  }
  if (path == options.output) {
    return fail(ErrorKind::kInvalidInput, path + ": the pyramid and its lines need a file each");
  }
  return check_output(path, options.force);
}

}  // namespace

Result<BuildReport> build_pyramid(const BuildOptions& options, Progress& progress) {
  const auto start = std::chrono::steady_clock::now();
  if (auto checked = check_output(options.output, options.force); !checked) return tl::unexpected(checked.error());
  if (auto checked = check_lines_out(options); !checked) return tl::unexpected(checked.error());
  progress.update(0, "reading");
  auto source = ElevationSource::open(options.source);
  if (!source) return tl::unexpected(source.error());
  std::size_t n_notes = 0;
  const auto print_notes = [&] {
    for (; n_notes < source->notes().size(); ++n_notes) progress.note(source->notes()[n_notes]);
  };
  print_notes();

  Lattice lattice;
  LevelOptions level_options = options.levels;
  level_options.irregular_posts = source->has_points();
  level_options.metres_per_degree = lattice.ellipsoid.semi_major_m * std::numbers::pi / 180;
  if (options.metres == BuildOptions::Metres::kMidLatitude) {
    const auto [west, south, east, north] = source->bounds_deg();
    level_options.metres_per_degree *= std::cos((south + north) / 2 * std::numbers::pi / 180);
  } else if (const auto own = source->own_spacing_m(); own && options.metres == BuildOptions::Metres::kAuto) {
    level_options.metres_per_degree = *own / source->lon_spacing_deg();
  }
  const auto table = make_level_table(source->lon_spacing_deg(), source->lat_spacing_deg(), level_options);
  if (!table) return tl::unexpected(table.error());
  lattice.level = table->lattice_level;
  lattice.height_exponent = table->height_exponent;

  // The output's name is taken before the long work begins, so that an unwritable folder is known at once.
  TemporaryFile temporary(fmt::format("{}-{}.tmp", options.output, ::getpid()));
  auto writer = TileStoreWriter::create(temporary.path());
  if (!writer) return tl::unexpected(writer.error());

  BuildReport report;
  report.threads =
      options.threads > 0 ? options.threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  const auto folder = std::filesystem::path(options.output).parent_path();
  const std::string scratch_dir = folder.empty() ? "." : folder.string();
  if (auto loaded = source->load(lattice, options.base_height_m, options.falloff_posts, scratch_dir, report.threads,
                                 [&](double fraction) { progress.update(kReadShare * fraction, "reading"); });
      !loaded) {
    return tl::unexpected(loaded.error());
  }
  print_notes();
  report.read_seconds = seconds_since(start);
  report.counts = source->counts();

  const auto line_start = std::chrono::steady_clock::now();
  if (options.lines.drainage) progress.update(kReadShare, "drainage");
  const auto lines =
      make_surface_lines(source->field(), *table, options.lines, scratch_dir, report.threads, options.cancel,
                         [&](double fraction) { progress.update(kReadShare + kLineShare * fraction, "drainage"); });
  if (!lines) return tl::unexpected(lines.error());
  for (const std::string& note : lines->notes) progress.note(note);
  report.drainage = lines->drainage;
  report.drainage_cells = lines->drainage_cells;
  report.given = lines->given;
  report.line_seconds = seconds_since(line_start);
  HeightField field = source->field();
  field.pinned = lines->pyramid.pinned();

  Manifest& m = report.manifest;
  m.generator = kGenerator;
  m.attribution = options.attribution;
  m.mode = options.levels.mode == LevelMode::kStandard ? "standard" : "non-standard";
  m.lattice = lattice;
  m.bottom_level = table->bottom_level();
  m.base_height_m = options.base_height_m;
  m.falloff_posts = options.falloff_posts;
  source->describe(m);
  m.lines = lines->counts;
  m.options_json = options_to_json(options, source->has_points(), *lines);

  const double progress_from = options.lines.drainage ? kReadShare + kLineShare : kReadShare;
  const PyramidInput input{field, *table, lines->pyramid, report.threads, options.cancel};
  if (auto built = build_levels(input, *writer, progress, progress_from, m, report.breakdown); !built) {
    return tl::unexpected(built.error());
  }
  m.content_hash = writer->content_hash();
  const std::string manifest = encode_manifest(m);
  if (auto done = writer->finish(pack_value(Bytes(manifest.begin(), manifest.end()))); !done) {
    return tl::unexpected(done.error());
  }
  std::error_code code;
  report.file_bytes = std::filesystem::file_size(temporary.path(), code);
  if (!options.lines.lines_out.empty()) {
    if (auto written = write_lines(options.lines.lines_out, lines->layers, options.force); !written) {
      return tl::unexpected(written.error());
    }
  }
  if (auto renamed = temporary.rename_to(options.output); !renamed) return tl::unexpected(renamed.error());
  report.seconds = seconds_since(start);
  progress.update(1, "done");
  progress.finish();
  return report;
}

}  // namespace tind
