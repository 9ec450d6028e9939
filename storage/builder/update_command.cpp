// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/update_command.hpp"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "storage/builder/build.hpp"
#include "storage/builder/build_arguments.hpp"
#include "storage/builder/earlier_pyramid.hpp"
#include "storage/builder/interrupt.hpp"
#include "storage/builder/rebuild_options.hpp"
#include "storage/builder/report.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;

struct UpdateArguments {
  std::string file;
  std::vector<std::string> inputs, changed, break_lines, lakes;
  std::string geoid, memory = "512M", report_path, tiles_path;
  std::vector<double> bbox;
  int threads = 0;
  bool resume = false, json = false, quiet = false;
};

// The inputs by name, where the user did not list them: beside a changed file, here, beside the pyramid.
class InputFinder {
 public:
  explicit InputFinder(const UpdateArguments& arguments) : arguments_(arguments) {
    for (const std::string& path : arguments.changed) folders_.push_back(fs::path(path).parent_path());
    folders_.emplace_back();
    folders_.push_back(fs::path(arguments.file).parent_path());
  }

  Result<std::string> find(const std::string& name) const {
    for (const std::string& path : arguments_.changed) {
      if (fs::path(path).filename() == name) return path;
    }
    for (const fs::path& folder : folders_) {
      std::error_code code;
      if (fs::exists(folder / name, code)) return (folder / name).string();
    }
    return fail(ErrorKind::kInvalidInput,
                fmt::format("{}: {} was made of it, and it is neither here, beside the pyramid nor "
                            "beside a changed file: list all inputs after the pyramid",
                            name, arguments_.file));
  }

 private:
  const UpdateArguments& arguments_;
  std::vector<fs::path> folders_;
};

Result<std::vector<std::string>> inputs_of(const UpdateArguments& arguments, const Manifest& manifest) {
  if (!arguments.inputs.empty()) return arguments.inputs;
  std::vector<std::string> inputs;
  const InputFinder finder(arguments);
  for (const SourceInfo& source : manifest.sources) {
    auto path = finder.find(source.name);
    if (!path) return tl::unexpected(path.error());
    inputs.push_back(std::move(*path));
  }
  for (const std::string& path : arguments.changed) {  // new ones, too
    if (std::find(inputs.begin(), inputs.end(), path) == inputs.end()) inputs.push_back(path);
  }
  return inputs;
}

// The break lines that the pyramid was made with, each by its path.
Result<std::vector<BreakLineFile>> lines_of(const UpdateArguments& arguments, const nlohmann::json& options) {
  std::vector<BreakLineFile> lines;
  for (const std::string& spec : arguments.break_lines) lines.push_back({spec, false});
  for (const std::string& spec : arguments.lakes) lines.push_back({spec, true});
  if (!lines.empty() || !options.contains("break_lines")) return lines;
  const InputFinder finder(arguments);
  for (const nlohmann::json& line : options["break_lines"]) {
    const std::string name = line.value("name", "");
    const std::size_t colon = name.find(':');
    auto path = finder.find(name.substr(0, colon));
    if (!path) return tl::unexpected(path.error());
    lines.push_back({colon == std::string::npos ? *path : *path + name.substr(colon), line.value("lakes", false)});
  }
  return lines;
}

Result<BuildOptions> options_of(const UpdateArguments& arguments, const Manifest& manifest) {
  auto inputs = inputs_of(arguments, manifest);
  if (!inputs) return tl::unexpected(inputs.error());
  SourceHints hints;
  hints.inputs = std::move(*inputs);
  hints.geoid = arguments.geoid;
  auto options = rebuild_options(manifest, hints);
  if (!options) return options;
  // What the builder chose it chooses again.
  const nlohmann::json given = nlohmann::json::parse(manifest.options_json);
  if (given.value("drainage_cells_chosen", false)) options->lines.drainage_cells.reset();
  if (given.value("lake_area_chosen", false)) options->lines.lake_area_m2.reset();
  auto lines = lines_of(arguments, given);
  if (!lines) return tl::unexpected(lines.error());
  options->lines.given = std::move(*lines);
  options->output = options->earlier = arguments.file;
  options->force = true;
  options->resume = arguments.resume;
  options->threads = arguments.threads;
  if (manifest.shard_count > 1) options->shard = {manifest.shard_index, manifest.shard_count};
  const auto memory = parse_memory(arguments.memory);
  if (!memory) return tl::unexpected(memory.error());
  options->memory_bytes = *memory;
  return options;
}

std::string name_of(const TileKey& tile) { return fmt::format("{}/{}/{}", tile.level, tile.x, tile.y); }

bool meets(const TileKey& tile, const std::vector<double>& bbox) {
  const double side = 180.0 / TileKey::count_y(tile.level), west = -180 + side * tile.x, south = -90 + side * tile.y;
  return west <= bbox[2] && west + side >= bbox[0] && south <= bbox[3] && south + side >= bbox[1];
}

// Lines for the user where the change went beyond what was said of it.
void note_surprises(const UpdateArguments& arguments, const Manifest& earlier, const BuildReport& report,
                    Progress& progress) {
  if (!arguments.changed.empty()) {
    for (const SourceInfo& now : report.manifest.sources) {
      const bool named = std::any_of(arguments.changed.begin(), arguments.changed.end(),
                                     [&](const std::string& path) { return fs::path(path).filename() == now.name; });
      const bool same = std::any_of(earlier.sources.begin(), earlier.sources.end(),
                                    [&](const SourceInfo& before) { return before.sha256 == now.sha256; });
      if (!named && !same) progress.note(now.name + ": has changed, too, and was taken as it is now");
    }
  }
  if (arguments.bbox.empty()) return;
  std::size_t n_beyond = 0;
  for (const TileKey& tile : report.changed_tiles) n_beyond += !meets(tile, arguments.bbox);
  if (n_beyond > 0) {
    progress.note(
        fmt::format("{} changed tiles lie beyond --bbox: streams, voids and heights' steps reach further than "
                    "the posts that changed",
                    n_beyond));
  }
}

std::string summary(const BuildReport& report) {
  std::uint64_t n_tiles = 0, n_built = 0;
  for (const LevelInfo& level : report.manifest.levels) n_tiles += level.n_tiles;
  for (const LevelBreakdown& level : report.breakdown) n_built += level.built;
  return fmt::format("{} of {} tiles rebuilt, {} are served otherwise than before, {:.1f} MB in {:.1f} s\n", n_built,
                     n_tiles, report.changed_tiles.size(), static_cast<double>(report.file_bytes) / 1e6,
                     report.seconds);
}

bool write_text(const std::string& path, const std::string& text) {
  std::ofstream file(path, std::ios::trunc);
  file << text;
  return static_cast<bool>(file.flush());
}

int run(const UpdateArguments& arguments) {
  const auto complain = [](const std::string& message) {
    fmt::print(stderr, "tind-build update: {}\n", message);
    return kExitFailed;
  };
  auto earlier = EarlierPyramid::open(arguments.file, TreeExtent::kLastPath);  // for its manifest
  if (!earlier) return complain(earlier.error().message);
  auto options = options_of(arguments, earlier->manifest);
  if (!options) return complain(options.error().message);
  options->cancel = cancel_on_signals();
  Progress progress(arguments.quiet ? nullptr : stderr);
  const auto report = build_pyramid(*options, progress);
  progress.finish();
  if (!report) return complain(report.error().message);
  note_surprises(arguments, earlier->manifest, *report, progress);
  if (!arguments.tiles_path.empty()) {
    std::string text;
    for (const TileKey& tile : report->changed_tiles) text += name_of(tile) + "\n";
    if (!write_text(arguments.tiles_path, text)) {
      return complain(arguments.tiles_path + ": cannot be written; the pyramid is updated");
    }
  }
  if (!arguments.report_path.empty() && !write_text(arguments.report_path, report_json(*report))) {
    return complain(arguments.report_path + ": cannot be written; the pyramid is updated");
  }
  if (arguments.json) {
    fmt::print("{}", report_json(*report));
  } else if (!arguments.quiet) {
    fmt::print("{}", summary(*report));
  }
  return 0;
}

}  // namespace

int update_main(int argc, char** argv) {
  CLI::App app{"Brings a pyramid up to date with its inputs: tind-build update NAME.tind [INPUT...]"};
  app.footer(
      "Only tiles that are made of something else than before are built; the file then has the same bytes as a whole\n"
      "rebuild with the options that it was built with. It is replaced at once, at the end: a server that has it open\n"
      "goes on with the old one.\n"
      "Examples:\n"
      "  tind-build update sierra.tind --changed N36W118.hgt\n"
      "  tind-build update dem.tind dem.tif --bbox -118.5,36.2,-118.2,36.4 --changed-tiles purge.txt\n"
      "Exit status: 0 up to date, 1 failed (the file is untouched), 2 wrong usage.");
  UpdateArguments arguments;
  app.add_option("PYRAMID", arguments.file, "The pyramid to update")->required()->type_name("NAME.tind");
  app.add_option(
         "INPUT", arguments.inputs,
         "All inputs as they are now (default: those it was made of, sought by name beside the changed ones, here "
         "and beside the pyramid)")
      ->type_name("FILE");
  app.add_option("--changed", arguments.changed, "An input that has changed or is new; others that have are noted")
      ->allow_extra_args(false)
      ->type_name("FILE");
  app.add_option("--bbox", arguments.bbox, "Where the data changed, degrees; changes beyond are noted")
      ->delimiter(',')
      ->expected(4)
      ->type_name("W,S,E,N");
  app.add_option("--breaklines", arguments.break_lines, "As in the build, when they are somewhere else now")
      ->allow_extra_args(false)
      ->type_name("FILE[:LAYER]");
  app.add_option("--lakes", arguments.lakes, "As in the build, when they are somewhere else now")
      ->allow_extra_args(false)
      ->type_name("FILE[:LAYER]");
  app.add_option("--geoid", arguments.geoid, "Path of the geoid grid that the pyramid was built with")
      ->type_name("FILE");
  app.add_option("--threads", arguments.threads, "Worker threads; 0: all cores")
      ->check(CLI::Range(0, 1024))
      ->type_name("N")
      ->capture_default_str();
  app.add_option("--memory", arguments.memory, "What the process may hold in memory")
      ->type_name("SIZE")
      ->capture_default_str();
  app.add_flag("--resume", arguments.resume, "Go on with an interrupted update");
  app.add_option("--changed-tiles", arguments.tiles_path,
                 "Write the tiles that are served otherwise now, level/x/y a line, to purge caches")
      ->type_name("FILE");
  app.add_option("--report", arguments.report_path, "Write a report with a table per level")->type_name("FILE.json");
  app.add_flag("--json", arguments.json, "Print the report as JSON on standard output");
  app.add_flag("-q,--quiet", arguments.quiet, "No progress and no summary");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : kExitUsage;
  }
  return run(arguments);
}

}  // namespace tind
