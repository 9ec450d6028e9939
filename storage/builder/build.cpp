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

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

std::string options_to_json(const BuildOptions& options) {
  nlohmann::json j = {{"base_height_m", options.base_height_m},
                      {"falloff_posts", options.falloff_posts},
                      {"metres_per_degree", options.mid_latitude_metres ? "mid-latitude" : "equator"}};
  if (options.levels.max_level) j["max_level"] = *options.levels.max_level;
  if (options.levels.tolerance_m) j["tolerance_m"] = *options.levels.tolerance_m;
  if (options.levels.finest_m) j["finest_m"] = *options.levels.finest_m;
  if (options.raster.nodata) j["nodata"] = *options.raster.nodata;
  if (options.raster.metres_per_unit) j["metres_per_unit"] = *options.raster.metres_per_unit;
  return j.dump();
}

}  // namespace

Result<BuildReport> build_pyramid(const BuildOptions& options, Progress& progress) {
  const auto start = std::chrono::steady_clock::now();
  if (auto checked = check_output(options.output, options.force); !checked) return tl::unexpected(checked.error());
  progress.update(0, "reading");
  auto mosaic = RasterMosaic::open(options.inputs, options.raster);
  if (!mosaic) return tl::unexpected(mosaic.error());
  for (const std::string& note : mosaic->notes) progress.note(note);

  Lattice lattice;
  const double north_deg = mosaic->south_deg + mosaic->lat_spacing_deg * static_cast<double>(mosaic->n_rows - 1);
  const double east_deg = mosaic->west_deg + mosaic->lon_spacing_deg * static_cast<double>(mosaic->n_cols - 1);
  LevelOptions level_options = options.levels;
  level_options.metres_per_degree = lattice.ellipsoid.semi_major_m * std::numbers::pi / 180;
  if (options.mid_latitude_metres) {
    level_options.metres_per_degree *= std::cos((mosaic->south_deg + north_deg) / 2 * std::numbers::pi / 180);
  }
  const auto table = make_level_table(mosaic->lon_spacing_deg, mosaic->lat_spacing_deg, level_options);
  if (!table) return tl::unexpected(table.error());
  lattice.level = table->lattice_level;
  lattice.height_exponent = table->height_exponent;

  // The output's name is taken before the long work begins, so that an unwritable folder is known at once.
  TemporaryFile temporary(fmt::format("{}-{}.tmp", options.output, ::getpid()));
  auto writer = TileStoreWriter::create(temporary.path());
  if (!writer) return tl::unexpected(writer.error());

  HeightGridOptions grid_options;
  grid_options.base_height_m = options.base_height_m;
  grid_options.falloff_posts = options.falloff_posts;
  const auto folder = std::filesystem::path(options.output).parent_path();
  grid_options.scratch_dir = folder.empty() ? "." : folder.string();
  const auto grid = HeightGrid::load(*mosaic, lattice, grid_options,
                                     [&](double fraction) { progress.update(kReadShare * fraction, "reading"); });
  if (!grid) return tl::unexpected(grid.error());
  for (const std::string& note : grid->notes()) progress.note(note);

  BuildReport report;
  report.read_seconds = seconds_since(start);
  report.counts = grid->counts();
  report.threads =
      options.threads > 0 ? options.threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  Manifest& m = report.manifest;
  m.generator = kGenerator;
  m.attribution = options.attribution;
  m.vertical_datum = mosaic->vertical_datum;
  m.mode = options.levels.mode == LevelMode::kStandard ? "standard" : "non-standard";
  m.lattice = lattice;
  m.bottom_level = table->bottom_level();
  m.base_height_m = options.base_height_m;
  m.falloff_posts = options.falloff_posts;
  m.disagreement_m = grid->field().disagreement_m;
  m.bounds_deg = {mosaic->west_deg, mosaic->south_deg, east_deg, north_deg};
  m.spacing_deg = {mosaic->lon_spacing_deg, mosaic->lat_spacing_deg};
  for (const RasterSource& s : mosaic->sources) m.sources.push_back({s.name, s.sha256, s.n_cols, s.n_rows});
  m.n_source_posts = report.counts.source;
  m.n_filled_posts = report.counts.filled;
  m.n_falloff_posts = report.counts.falloff;
  m.options_json = options_to_json(options);

  const LinePyramid lines;
  const PyramidInput input{grid->field(), *table, lines, report.threads, options.cancel};
  if (auto built = build_levels(input, *writer, progress, kReadShare, m, report.breakdown); !built) {
    return tl::unexpected(built.error());
  }
  m.content_hash = writer->content_hash();
  const std::string manifest = encode_manifest(m);
  if (auto done = writer->finish(pack_value(Bytes(manifest.begin(), manifest.end()))); !done) {
    return tl::unexpected(done.error());
  }
  std::error_code code;
  report.file_bytes = std::filesystem::file_size(temporary.path(), code);
  if (auto renamed = temporary.rename_to(options.output); !renamed) return tl::unexpected(renamed.error());
  report.seconds = seconds_since(start);
  progress.update(1, "done");
  progress.finish();
  return report;
}

}  // namespace tind
