// SPDX-License-Identifier: GPL-3.0-or-later
// tind-build: elevation data in, one .tind pyramid out.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string_view>

#include "storage/builder/build.hpp"
#include "storage/builder/build_arguments.hpp"
#include "storage/builder/interrupt.hpp"
#include "storage/builder/merge_command.hpp"
#include "storage/builder/plan_command.hpp"
#include "storage/builder/report.hpp"
#include "storage/builder/update_command.hpp"
#include "storage/builder/version.hpp"
#include "storage/report/report_command.hpp"

namespace {

struct Command {
  std::string_view name;
  int (*run)(int argc, char** argv);
};
constexpr Command kCommands[] = {{"merge", tind::merge_main},
                                 {"plan", tind::plan_main},
                                 {"report", tind::report_main},
                                 {"update", tind::update_main}};

// A report that cannot be written is known before the long work starts.
bool can_write(const std::string& path) { return path.empty() || std::ofstream(path, std::ios::app).good(); }

// Without what a hundred libraries tidy up, which takes as long as a small update's tile.
[[noreturn]] void leave(int status) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  std::exit(status);  // with what they find
#else
  std::fflush(nullptr);
  std::_Exit(status);
#endif
}

}  // namespace

int main(int argc, char** argv) {
  for (const Command& command : kCommands) {
    if (argc > 1 && argv[1] == command.name) leave(command.run(argc - 1, argv + 1));
  }
  CLI::App app{"Builds a pyramid of seamless TIN tiles from elevation data: tind-build INPUT... -o NAME.tind"};
  app.footer(
      "Examples:\n"
      "  tind-build dem.tif -o dem.tind\n"
      "  tind-build N36W118.hgt N36W119.hgt -o sierra.tind --finest 20\n"
      "  tind-build dem.tif -o dem.tind --tolerance 10 --report report.json\n"
      "  tind-build utm.tif -o dem.tind --drainage-out streams.gpkg\n"
      "  tind-build ground.las -o ground.tind --class 2,9\n"
      "Exit status: 0 built, 1 failed (an earlier output is untouched), 2 wrong usage.\n"
      "The manual is tind-build(1).");
  tind::BuildArguments arguments;
  std::string report_path;
  bool json = false, quiet = false;
  arguments.add_to(app, true);
  app.add_option("--report", report_path, "Write a report with a table per level")->type_name("FILE.json");
  app.add_flag("--json", json, "Print the report as JSON on standard output");
  app.add_flag("-q,--quiet", quiet, "No progress and no table");
  app.set_version_flag("--version", std::string(tind::kGenerator));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : tind::kExitUsage;
  }
  auto options = arguments.finish();
  if (!options) {
    fmt::print(stderr, "tind-build: {}\n", options.error().message);
    return tind::kExitUsage;
  }
  if (!can_write(report_path)) {
    fmt::print(stderr, "tind-build: {}: cannot be written\n", report_path);
    return tind::kExitFailed;
  }
  options->cancel = tind::cancel_on_signals();

  try {
    tind::Progress progress(quiet ? nullptr : stderr);
    const auto report = tind::build_pyramid(*options, progress);
    progress.finish();
    if (!report) {
      fmt::print(stderr, "tind-build: {}\n", report.error().message);
      return tind::kExitFailed;
    }
    if (!report_path.empty()) {
      std::ofstream file(report_path, std::ios::trunc);
      file << tind::report_json(*report);
      if (!file.flush()) {
        fmt::print(stderr, "tind-build: {}: the report could not be written; the pyramid is complete\n", report_path);
        return tind::kExitFailed;
      }
    }
    if (json) {
      fmt::print("{}", tind::report_json(*report));
    } else if (!quiet) {
      fmt::print("{}", tind::report_text(*report));
    }
    return 0;
  } catch (const std::exception& e) {
    fmt::print(stderr, "tind-build: {} (out of memory? fewer --threads take less)\n", e.what());
    return tind::kExitFailed;
  }
}
