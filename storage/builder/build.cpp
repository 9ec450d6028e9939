// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/build.hpp"

#include <fmt/format.h>
#include <malloc.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <optional>
#include <thread>

#include "storage/builder/earlier_pyramid.hpp"
#include "storage/builder/output_file.hpp"
#include "storage/builder/resident_limit.hpp"
#include "storage/builder/source_levels.hpp"
#include "storage/builder/unfinished_output.hpp"
#include "storage/builder/version.hpp"
#include "storage/readers/post_arrays.hpp"
#include "storage/tile_store.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

// Share of the whole work that reading takes, for the progress line.
constexpr double kReadShare = 0.08;
constexpr double kLineShare = 0.1;
// Pages of posts and of the store are dropped beyond such a share of BuildOptions::memory_bytes: looking and dropping
// take a moment, in which drainage and loading touch more than tiles do.
constexpr double kMapsWhileReading = 0.4;
constexpr double kMapsWhileBuilding = 0.48;
// Posts and their blocks stay arrays up to such a share of it: pages are not needed to bound memory then, and cost a
// twentieth of the build.
constexpr double kPostsAsArrays = 0.3;
// Share of it that pages of posts take, of all threads together.
constexpr double kPagesOfPosts = 0.2;

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

const char* mode_name(LevelMode mode) { return mode == LevelMode::kStandard ? "standard" : "non-standard"; }

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

// What the user asked for, as far as it shapes the bytes.
nlohmann::json asked_for(const BuildOptions& options, bool has_points) {
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
    if (options.lines.drainage_cells) j["drainage_cells"] = *options.lines.drainage_cells;
    j["drainage_growth"] = options.lines.drainage_growth;
    if (options.lines.lake_area_m2) j["lake_area_m2"] = *options.lines.lake_area_m2;
    if (options.lines.sea_level_m) j["sea_level_m"] = *options.lines.sea_level_m;
  }
  return j;
}

// The same for the manifest: with what was chosen where the user left it open.
nlohmann::json options_to_json(nlohmann::json j, const BuildOptions& options, const SurfaceLines& lines) {
  if (options.lines.drainage) {
    j["drainage_cells"] = lines.drainage_cells;
    j["drainage_cells_chosen"] = !options.lines.drainage_cells;
    j["lake_area_m2"] = lines.lake_area_m2;
    j["lake_area_chosen"] = !options.lines.lake_area_m2;
  }
  for (const BreakLineSource& given : lines.given_sources) {
    j["break_lines"].push_back({{"name", given.name}, {"sha256", given.sha256}, {"lakes", given.lakes}});
  }
  return j;
}

// What an unfinished output is made of, as far as it is known before the work begins.
nlohmann::json job_of(const BuildOptions& options, const ElevationSource& source) {
  Manifest m;
  source.describe(m);
  nlohmann::json sources = nlohmann::json::object();
  for (const SourceInfo& s : m.sources) sources[s.name] = s.sha256;
  nlohmann::json lines = nlohmann::json::array();
  for (const BreakLineFile& file : options.lines.given) lines.push_back({{"file", file.spec}, {"lakes", file.lakes}});
  nlohmann::json job = {{"builder", std::string(kGenerator)},
                        {"attribution", options.attribution},
                        {"mode", mode_name(options.levels.mode)},
                        {"resampling", options.source.raster.resampling == Resampling::kCubic ? "cubic" : "bilinear"},
                        {"options", asked_for(options, source.has_points())},
                        {"sources", std::move(sources)},
                        {"break_lines", std::move(lines)}};
  if (options.shard) job["shard"] = {{"index", options.shard->index}, {"count", options.shard->count}};
  return job;
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

// The manifest of the output, if that is what `expected` would become: then there is nothing to go on with.
std::optional<Manifest> complete_output(const std::string& output, const Manifest& expected,
                                        const nlohmann::json& asked) {
  auto file = EarlierPyramid::open(output);
  if (!file) return std::nullopt;
  Manifest& m = file->manifest;
  const auto name_and_hash = [](const SourceInfo& a, const SourceInfo& b) {
    return a.name == b.name && a.sha256 == b.sha256;
  };
  if (m.generator != expected.generator || m.attribution != expected.attribution || m.mode != expected.mode ||
      m.shard_index != expected.shard_index || m.shard_count != expected.shard_count ||
      !std::equal(m.sources.begin(), m.sources.end(), expected.sources.begin(), expected.sources.end(),
                  name_and_hash)) {
    return std::nullopt;
  }
  const nlohmann::json options = nlohmann::json::parse(m.options_json);
  const bool same = std::all_of(asked.items().begin(), asked.items().end(), [&](const auto& item) {
    return options.contains(item.key()) && options[item.key()] == item.value();
  });
  if (!same) return std::nullopt;
  return std::move(m);
}

// Tiles with a changed piece, and tiles of the earlier pyramid that are gone.
std::vector<TileKey> changed_tiles(const Manifest& now, const Manifest& earlier, const std::vector<PieceKey>& changed) {
  std::vector<TileKey> tiles;
  for (const PieceKey& key : changed) {
    for (const TileKey& tile : tiles_of(key)) {
      if (now.has_tile(tile)) tiles.push_back(tile);
    }
  }
  for (const LevelInfo& level : earlier.levels) {
    for (const TileRun& run : level.rows) {
      for (std::uint32_t x = run.x_first; x <= run.x_last; ++x) {
        const TileKey tile{static_cast<std::uint8_t>(level.level), x, run.y};
        if (!now.has_tile(tile)) tiles.push_back(tile);
      }
    }
  }
  const auto before = [](const TileKey& a, const TileKey& b) {
    return a.level != b.level ? a.level < b.level : morton_code(a.x, a.y) < morton_code(b.x, b.y);
  };
  std::sort(tiles.begin(), tiles.end(), before);
  tiles.erase(std::unique(tiles.begin(), tiles.end()), tiles.end());
  return tiles;
}

}  // namespace

Result<BuildReport> build_pyramid(const BuildOptions& options, Progress& progress) {
  const auto start = std::chrono::steady_clock::now();
  const bool goes_on = options.resume && UnfinishedOutput::exists_for(options.output);
  if (auto checked = check_output(options.output, options.force || options.resume); !checked) {
    return tl::unexpected(checked.error());
  }
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
  const auto table = make_source_levels(*source, options);
  if (!table) return tl::unexpected(table.error());
  lattice.level = table->lattice_level;
  lattice.height_exponent = table->height_exponent;

  BuildReport report;
  Manifest& m = report.manifest;
  m.generator = kGenerator;
  m.attribution = options.attribution;
  m.mode = mode_name(options.levels.mode);
  m.lattice = lattice;
  m.bottom_level = table->bottom_level();
  m.base_height_m = options.base_height_m;
  m.falloff_posts = options.falloff_posts;
  if (options.shard) {
    m.shard_index = options.shard->index;
    m.shard_count = options.shard->count;
  }
  source->describe(m);
  const nlohmann::json asked = asked_for(options, source->has_points());
  if (options.resume && !goes_on) {
    if (auto done = complete_output(options.output, m, asked)) {
      progress.note(options.output + ": complete already; nothing to go on with");
      report.manifest = std::move(*done);
      report.breakdown.resize(report.manifest.levels.size());
      return report;
    }
    if (auto checked = check_output(options.output, options.force); !checked) return tl::unexpected(checked.error());
  }
  std::optional<EarlierPyramid> earlier;
  if (!options.earlier.empty()) {
    auto opened = EarlierPyramid::open(options.earlier);
    if (!opened) return tl::unexpected(opened.error());
    earlier.emplace(std::move(*opened));
  }

  Result<void> sound;  // what is taken over from it
  std::jthread checker;
  if (earlier) checker = std::jthread([&] { sound = earlier->check_content(options.earlier); });

  // The output's name is taken before the long work begins, so that an unwritable folder is known at once.
  auto unfinished = UnfinishedOutput::open(options.output, options.resume, options.force);
  if (!unfinished) return tl::unexpected(unfinished.error());
  if (auto checked = unfinished->check_job(job_of(options, *source)); !checked) return tl::unexpected(checked.error());
  auto writer = TileStoreWriter::go_on(unfinished->path());
  if (!writer) return tl::unexpected(writer.error());
  if (writer->has_pieces()) progress.note(options.output + ": going on with the interrupted build");

  std::optional<ResidentLimit> limit;
  const auto limit_maps = [&](double share) {
    limit.reset();
    limit.emplace(static_cast<std::uint64_t>(static_cast<double>(options.memory_bytes) * share));
  };
  limit_maps(kMapsWhileReading);

  report.threads =
      options.threads > 0 ? options.threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  const auto folder = std::filesystem::path(options.output).parent_path();
  const std::string scratch_dir = folder.empty() ? "." : folder.string();
  // What is stored stays for a later run.
  const auto give_up = [&](Error error) -> tl::unexpected<Error> {
    if (error.kind != ErrorKind::kIo && error.kind != ErrorKind::kInterrupted) return tl::unexpected(std::move(error));
    if (writer->has_pieces()) {
      unfinished->keep();
      error.message += "; what is done is kept: the same command with --resume goes on from there";
    } else {
      error.message += "; nothing was written";
    }
    return tl::unexpected(std::move(error));
  };
  if (auto loaded = source->load(
          lattice, options.base_height_m, options.falloff_posts, scratch_dir, report.threads,
          [&](double fraction) { progress.update(kReadShare * fraction, "reading"); }, options.cancel);
      !loaded) {
    return give_up(loaded.error());
  }
  print_notes();
  report.read_seconds = seconds_since(start);
  report.counts = source->counts();

  const auto line_start = std::chrono::steady_clock::now();
  const auto lines = make_surface_lines(
      source->field(), *table, options.lines, scratch_dir, report.threads, options.cancel,
      [&](double fraction) { progress.update(kReadShare + kLineShare * fraction, "drainage"); },
      [&limit] { limit->enforce(); });
  if (!lines) return give_up(lines.error());
  for (const std::string& note : lines->notes) progress.note(note);
  report.drainage = lines->drainage;
  report.drainage_cells = lines->drainage_cells;
  report.given = lines->given;
  ::malloc_trim(0);  // many small blocks were freed
  report.line_seconds = seconds_since(line_start);
  const auto memory_bytes = static_cast<double>(options.memory_bytes);
  if (static_cast<double>(PostArrays::n_bytes(source->field())) > kPostsAsArrays * memory_bytes) {
    // The calling thread looks at posts, too, and tiles that threads share have as many again.
    const auto held_bytes = static_cast<std::size_t>(memory_bytes * kPagesOfPosts / (2 * report.threads + 1));
    if (auto turned = source->turn_into_pages(scratch_dir, held_bytes, report.threads, options.cancel); !turned) {
      return give_up(turned.error());
    }
  }
  HeightField field = source->field();
  field.pinned = lines->pyramid.pinned();
  source->describe(m);
  m.lines = lines->counts;
  m.options_json = options_to_json(asked, options, *lines).dump();

  const double progress_from = options.lines.drainage ? kReadShare + kLineShare : kReadShare;
  const PyramidInput input{field,          *table,        lines->pyramid, report.threads,
                           options.cancel, m.shard_index, m.shard_count,  earlier ? &earlier->snapshot : nullptr};
  limit_maps(kMapsWhileBuilding);
  if (checker.joinable()) checker.join();
  if (!sound) return tl::unexpected(sound.error());
  auto built = build_levels(input, *writer, progress, progress_from);
  if (built) {
    m.levels = std::move(built->levels);
    m.shard_cut_level = built->shard_cut_level;
    report.breakdown = std::move(built->breakdown);
    m.content_hash = writer->content_hash();
    const std::string manifest = encode_manifest(m);
    auto done = writer->finish(pack_value(Bytes(manifest.begin(), manifest.end())));
    if (!done) built = tl::unexpected(done.error());
  }
  if (!built) return give_up(built.error());
  std::error_code code;
  report.file_bytes = std::filesystem::file_size(unfinished->path(), code);
  if (earlier) report.changed_tiles = changed_tiles(m, earlier->manifest, built->changed);
  if (!options.lines.lines_out.empty()) {
    if (auto written = write_lines(options.lines.lines_out, lines->layers, options.force); !written) {
      unfinished->keep();
      return tl::unexpected(written.error());
    }
  }
  if (earlier && options.earlier == options.output && encode_manifest(m) == encode_manifest(earlier->manifest)) {
    progress.note(options.output + ": up to date already; left as it is");
  } else if (auto renamed = unfinished->put_in_place(); !renamed) {
    unfinished->keep();
    return tl::unexpected(renamed.error());
  }
  report.seconds = seconds_since(start);
  progress.update(1, "done");
  progress.finish();
  return report;
}

}  // namespace tind
