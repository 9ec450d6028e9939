// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/build.hpp"

#include <fmt/format.h>
#include <malloc.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <memory>
#include <optional>
#include <thread>

#include "storage/builder/duration.hpp"
#include "storage/builder/earlier_pyramid.hpp"
#include "storage/builder/output_file.hpp"
#include "storage/builder/patched_pieces.hpp"
#include "storage/builder/plan.hpp"
#include "storage/builder/resident_limit.hpp"
#include "storage/builder/source_levels.hpp"
#include "storage/builder/unfinished_output.hpp"
#include "storage/builder/version.hpp"
#include "storage/readers/post_arrays.hpp"
#include "storage/tile_store.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

// Share of the whole work that reading and lines take, for the progress line: it is not known before levels are built.
constexpr double kReadShare = 0.08;
constexpr double kLineShare = 0.1;
// Pages of posts and of the store are dropped beyond such a share of BuildOptions::memory_bytes: looking and dropping
// take a moment, in which drainage and loading touch more than tiles do.
constexpr double kMapsWhileReading = 0.4;
constexpr double kMapsWhileBuilding = 0.48;
// How fast tiles bring in pages, at most, on each thread and the one that stores them.
constexpr std::uint64_t kTileBytesPerMs = std::uint64_t{6} << 20;
// Posts and their blocks stay arrays up to such a share of it: pages are not needed to bound memory then, and cost a
// twentieth of the build.
constexpr double kPostsAsArrays = 0.3;
// Share of it that the arrays of flow may take beside posts in memory.
constexpr double kFlowInMemory = 0.55;
// Share of it that pages of posts take, of all threads together.
constexpr double kPagesOfPosts = 0.2;

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

// Whether the grids of posts lie alike: the sources' common one, and the rim around it.
bool has_same_grid(const Manifest& a, const Manifest& b) {
  return a.bounds_deg == b.bounds_deg && a.spacing_deg == b.spacing_deg && a.falloff_posts == b.falloff_posts;
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
  std::sort(tiles.begin(), tiles.end(), TileOrder());
  tiles.erase(std::unique(tiles.begin(), tiles.end()), tiles.end());
  return tiles;
}

// One build, step by step: each leaves what the next one needs.
class Build {
 public:
  Build(const BuildOptions& options, Progress& progress) : options_(options), progress_(progress) {}

  Result<BuildReport> run() {
    const bool goes_on = options_.resume && UnfinishedOutput::exists_for(options_.output);
    if (auto ok = check_output(options_.output, options_.force || options_.resume); !ok) return stop(ok);
    if (auto ok = check_lines_out(options_); !ok) return stop(ok);
    if (auto ok = open_source(); !ok) return stop(ok);
    if (!is_begun_late()) {
      if (auto ok = describe_source(); !ok) return stop(ok);
    }
    if (options_.resume && !goes_on) {
      if (is_complete()) return std::move(report_);
      if (auto ok = check_output(options_.output, options_.force); !ok) return stop(ok);
    }
    if (auto ok = open_earlier(); !ok) return stop(ok);
    if (auto ok = open_output(); !ok) return stop(ok);
    if (!is_begun_late()) {
      if (auto ok = begin_output(); !ok) return stop(ok);
    }
    for (const auto step :
         {&Build::load_posts, &Build::begin_output, &Build::make_lines, &Build::bound_memory, &Build::build}) {
      if (auto ok = (this->*step)(); !ok) return give_up(ok.error());
    }
    if (auto ok = put_in_place(); !ok) return stop(ok);
    report_.seconds = seconds_since(start_);
    progress_.update(1, "done");
    progress_.finish();
    return std::move(report_);
  }

 private:
  static tl::unexpected<Error> stop(const Result<void>& step) { return tl::unexpected(step.error()); }

  // What is stored stays for a later run.
  tl::unexpected<Error> give_up(Error error) {
    if (error.kind != ErrorKind::kIo && error.kind != ErrorKind::kInterrupted) return tl::unexpected(std::move(error));
    if (writer_ && writer_->has_pieces()) {
      unfinished_->keep();
      error.message += "; what is done is kept: the same command with --resume goes on from there";
    } else {
      error.message += "; nothing was written";
    }
    return tl::unexpected(std::move(error));
  }

  void print_notes() {
    for (; n_notes_ < source_->notes().size(); ++n_notes_) progress_.note(source_->notes()[n_notes_]);
  }

  void limit_maps(double share, std::uint64_t most_bytes_per_ms) {
    limit_.reset();
    limit_.emplace(static_cast<std::uint64_t>(static_cast<double>(options_.memory_bytes) * share), most_bytes_per_ms);
  }

  // An update reads its posts while its input is still hashed. What is gone on with must be known before.
  bool is_begun_late() const { return !options_.earlier.empty() && !options_.resume; }

  // The source, its level table, and what the manifest says of both.
  Result<void> open_source() {
    progress_.update(0, "reading");
    SourceOptions of_source = options_.source;
    of_source.raster.hash_later = is_begun_late();
    auto source = ElevationSource::open(of_source);
    if (!source) return tl::unexpected(source.error());
    source_.emplace(std::move(*source));
    print_notes();
    auto table = make_source_levels(*source_, options_);
    if (!table) return tl::unexpected(table.error());
    table_ = std::move(*table);
    lattice_.level = table_.lattice_level;
    lattice_.height_exponent = table_.height_exponent;
    asked_ = asked_for(options_, source_->has_points());

    Manifest& m = report_.manifest;
    m.generator = kGenerator;
    m.attribution = options_.attribution;
    m.mode = mode_name(options_.levels.mode);
    m.lattice = lattice_;
    m.bottom_level = table_.bottom_level();
    m.base_height_m = options_.base_height_m;
    m.falloff_posts = options_.falloff_posts;
    if (options_.shard) {
      m.shard_index = options_.shard->index;
      m.shard_count = options_.shard->count;
    }
    return {};
  }

  Result<void> describe_source() {
    if (auto hashed = source_->finish_hashing(); !hashed) return hashed;
    source_->describe(report_.manifest);
    return {};
  }

  // Whether the output is there already as this build would make it; the report says so then.
  bool is_complete() {
    auto done = complete_output(options_.output, report_.manifest, asked_);
    if (!done) return false;
    progress_.note(options_.output + ": complete already; nothing to go on with");
    report_.manifest = std::move(*done);
    report_.breakdown.resize(report_.manifest.levels.size());
    return true;
  }

  // Bodies are taken over from it as they are: its content is checked while the source is read.
  Result<void> open_earlier() {
    if (options_.earlier.empty()) return {};
    auto opened = EarlierPyramid::open(options_.earlier);
    if (!opened) return tl::unexpected(opened.error());
    earlier_.emplace(std::move(*opened));
    checker_ = std::jthread([this] { sound_ = earlier_->check_content(options_.earlier); });
    return {};
  }

  // The output's name is taken before the long work begins, so that an unwritable folder is known at once.
  Result<void> open_output() {
    auto unfinished = UnfinishedOutput::open(options_.output, options_.resume, options_.force);
    if (!unfinished) return tl::unexpected(unfinished.error());
    unfinished_.emplace(std::move(*unfinished));
    report_.threads =
        options_.threads > 0 ? options_.threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
    const auto folder = std::filesystem::path(options_.output).parent_path();
    scratch_dir_ = folder.empty() ? "." : folder.string();
    return {};
  }

  // Notes what the output is made of, and opens it: the unfinished file is empty until then.
  Result<void> begin_output() {
    if (writer_) return {};
    if (auto described = describe_source(); !described) return described;
    if (auto checked = unfinished_->check_job(job_of(options_, *source_)); !checked) return checked;
    auto writer = TileStoreWriter::go_on(unfinished_->path());
    if (!writer) return tl::unexpected(writer.error());
    writer_.emplace(std::move(*writer));
    if (writer_->has_pieces()) progress_.note(options_.output + ": going on with the interrupted build");
    return {};
  }

  // An update looks at posts once and at few of their blocks, and is soon over: it takes memory where there is some,
  // not files whose pages come and go.
  std::uint64_t in_memory_bytes(double share) const {
    return options_.earlier.empty() ? 0
                                    : static_cast<std::uint64_t>(share * static_cast<double>(options_.memory_bytes));
  }

  Result<void> load_posts() {
    limit_maps(kMapsWhileReading, ResidentLimit::kFullSpeed);
    if (auto loaded = source_->load(
            lattice_, options_.base_height_m, options_.falloff_posts, scratch_dir_, report_.threads,
            [this](double fraction) { progress_.update_stage(kReadShare * fraction, "reading", fraction); },
            options_.cancel, in_memory_bytes(kPostsAsArrays), !options_.lines.drainage);
        !loaded) {
      return loaded;
    }
    print_notes();
    report_.read_seconds = seconds_since(start_);
    report_.counts = source_->counts();
    return {};
  }

  Result<void> make_lines() {
    const auto start = std::chrono::steady_clock::now();
    auto lines = make_surface_lines(
        source_->field(), table_, options_.lines, {scratch_dir_, in_memory_bytes(kFlowInMemory)}, report_.threads,
        options_.cancel,
        [this](double fraction) { progress_.update_stage(kReadShare + kLineShare * fraction, "drainage", fraction); },
        [this] { limit_->enforce(); });
    if (!lines) return tl::unexpected(lines.error());
    lines_ = std::move(*lines);
    for (const std::string& note : lines_.notes) progress_.note(note);
    report_.drainage = lines_.drainage;
    report_.drainage_cells = lines_.drainage_cells;
    report_.given = lines_.given;
    ::malloc_trim(0);  // many small blocks were freed
    report_.line_seconds = seconds_since(start);
    return {};
  }

  // From here on posts are looked at here and there.
  Result<void> bound_memory() {
    const auto memory_bytes = static_cast<double>(options_.memory_bytes);
    if (static_cast<double>(PostArrays::n_bytes(source_->field())) > kPostsAsArrays * memory_bytes) {
      // The calling thread looks at posts, too, and tiles that threads share have as many again.
      const auto held_bytes = static_cast<std::size_t>(memory_bytes * kPagesOfPosts / (2 * report_.threads + 1));
      if (auto turned = source_->turn_into_pages(scratch_dir_, held_bytes, report_.threads, options_.cancel); !turned) {
        return turned;
      }
    }
    limit_maps(kMapsWhileBuilding, kTileBytesPerMs * static_cast<std::uint64_t>(report_.threads + 1));
    return {};
  }

  Result<void> build() {
    if (checker_.joinable()) checker_.join();
    if (!sound_) return sound_;
    Manifest& m = report_.manifest;
    HeightField field = source_->field();
    field.pinned = lines_.pyramid.pinned();
    source_->describe(m);
    m.lines = lines_.counts;
    m.options_json = options_to_json(asked_, options_, lines_).dump();
    const PyramidInput input{field,
                             table_,
                             lines_.pyramid,
                             report_.threads,
                             options_.cancel,
                             m.shard_index,
                             m.shard_count,
                             earlier_ ? &*earlier_ : nullptr,
                             earlier_ && has_same_grid(earlier_->manifest, m)};
    auto built = build_levels(input, *writer_, progress_);
    if (!built) return tl::unexpected(built.error());
    m.levels = std::move(built->levels);
    m.shard_cut_level = built->shard_cut_level;
    report_.breakdown = std::move(built->breakdown);
    if (earlier_) report_.changed_tiles = changed_tiles(m, earlier_->manifest, built->changed);
    m.content_hash = built->content_hash;
    const std::string manifest = encode_manifest(m);
    const Bytes value = pack_value(Bytes(manifest.begin(), manifest.end()));
    patched_ = built->patched;
    if (patched_) {
      const auto stored = patched_->store(value, *writer_, options_.cancel);
      if (!stored) return tl::unexpected(stored.error());
      report_.is_copy = *stored;
      return {};
    }
    return writer_->finish(value);
  }

  Result<void> put_in_place() {
    std::error_code code;
    report_.file_bytes = std::filesystem::file_size(unfinished_->path(), code);
    if (!options_.lines.lines_out.empty()) {
      if (auto written = write_lines(options_.lines.lines_out, lines_.layers, options_.force); !written) {
        unfinished_->keep();
        return written;
      }
    }
    if (earlier_ && options_.earlier == options_.output &&
        encode_manifest(report_.manifest) == encode_manifest(earlier_->manifest)) {
      progress_.note(options_.output + ": up to date already; left as it is");
      return {};
    }
    auto renamed = unfinished_->put_in_place();
    if (!renamed) unfinished_->keep();
    return renamed;
  }

  const BuildOptions& options_;
  Progress& progress_;
  const std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
  BuildReport report_;
  std::optional<ElevationSource> source_;
  std::size_t n_notes_ = 0;  // of the source's that were printed
  LevelTable table_;
  Lattice lattice_;
  nlohmann::json asked_;
  std::optional<EarlierPyramid> earlier_;
  Result<void> sound_;  // what is taken over from it
  std::jthread checker_;
  std::optional<UnfinishedOutput> unfinished_;
  std::optional<TileStoreWriter> writer_;
  std::shared_ptr<PatchedPieces> patched_;  // holds the unfinished file's lock
  std::string scratch_dir_;
  std::optional<ResidentLimit> limit_;
  SurfaceLines lines_;
};

}  // namespace

Result<BuildReport> build_pyramid(const BuildOptions& options, Progress& progress) {
  return Build(options, progress).run();
}

}  // namespace tind
