// SPDX-License-Identifier: GPL-3.0-or-later
// tind-build: elevation rasters in, one .tind pyramid out.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <fstream>

#include "storage/builder/build.hpp"
#include "storage/builder/report.hpp"

namespace {

constexpr int kFailed = 1;
constexpr int kUsage = 2;

std::atomic<bool> g_cancel{false};
static_assert(std::atomic<bool>::is_always_lock_free, "set from a signal handler");

void on_signal(int signal) {
  g_cancel = true;
  std::signal(signal, SIG_DFL);  // a second Ctrl-C ends at once
}

// A report that cannot be written is known before the long work starts.
bool can_write(const std::string& path) { return path.empty() || std::ofstream(path, std::ios::app).good(); }

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Builds a pyramid of seamless TIN tiles from elevation rasters: tind-build INPUT... -o NAME.tind"};
  app.footer(
      "Examples:\n"
      "  tind-build dem.tif -o dem.tind\n"
      "  tind-build N36W118.hgt N36W119.hgt -o sierra.tind --finest 20\n"
      "  tind-build dem.tif -o dem.tind --tolerance 10 --report report.json\n"
      "Exit status: 0 built, 1 failed (an earlier output is untouched), 2 wrong usage.\n"
      "The manual is tind-build(1).");
  tind::BuildOptions options;
  std::string mode = "non-standard", metres = "equator", report_path;
  bool json = false, quiet = false;
  app.add_option("INPUT", options.inputs, "Elevation rasters with geographic coordinates (any GDAL format; .zip too)")
      ->required()
      ->type_name("FILE");
  app.add_option("-o,--output", options.output, "The pyramid to write")->required()->type_name("NAME.tind");
  app.add_flag("--force", options.force, "Replace an output that exists");
  app.add_option("--mode", mode, "Bottom level: the source's own spacing (non-standard) or the nearest dyadic one")
      ->check(CLI::IsMember({"standard", "non-standard"}))
      ->capture_default_str();
  app.add_option("--max-level", options.levels.max_level, "Stop at this level")->type_name("N");
  app.add_option("--tolerance", options.levels.tolerance_m,
                 "E of the bottom level in metres, instead of 4/5 of the spacing")
      ->type_name("M");
  app.add_option("--finest", options.levels.finest_m, "Go on below the bottom level, halving E, until E <= M metres")
      ->type_name("M");
  app.add_option("--metres-per-degree", metres, "Where a degree of longitude is measured for the 4/5 rule")
      ->check(CLI::IsMember({"equator", "mid-latitude"}))
      ->capture_default_str();
  app.add_option("--nodata", options.raster.nodata, "Value that marks voids, instead of the file's")->type_name("V");
  app.add_option("--metres-per-unit", options.raster.metres_per_unit,
                 "Vertical unit of the input, e.g. 0.3048 for feet")
      ->check(CLI::PositiveNumber)
      ->type_name("M");
  app.add_option("--base-height", options.base_height_m, "Height of the surface far outside the data, metres")
      ->check(CLI::Range(-12000.0, 100000.0))
      ->type_name("M")
      ->capture_default_str();
  app.add_option("--falloff", options.falloff_posts, "Posts over which the surface falls to the base height")
      ->check(CLI::Range(1, 4096))
      ->type_name("N")
      ->capture_default_str();
  app.add_option("--attribution", options.attribution, "Credit line that clients show")->type_name("TEXT");
  app.add_option("--threads", options.threads, "Worker threads; 0: all cores. The bytes do not depend on it")
      ->check(CLI::Range(0, 1024))
      ->type_name("N")
      ->capture_default_str();
  app.add_option("--report", report_path, "Write a report with a table per level")->type_name("FILE.json");
  app.add_flag("--json", json, "Print the report as JSON on standard output");
  app.add_flag("-q,--quiet", quiet, "No progress and no table");
  app.set_version_flag("--version", "tind-build 0.1.0");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : kUsage;
  }
  options.levels.mode = mode == "standard" ? tind::LevelMode::kStandard : tind::LevelMode::kNonStandard;
  options.mid_latitude_metres = metres == "mid-latitude";
  options.cancel = &g_cancel;
  if (!can_write(report_path)) {
    fmt::print(stderr, "tind-build: {}: cannot be written\n", report_path);
    return kFailed;
  }
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  std::signal(SIGXFSZ, SIG_IGN);  // a file size limit is then an error of the write

  try {
    tind::Progress progress(quiet ? nullptr : stderr);
    const auto report = tind::build_pyramid(options, progress);
    progress.finish();
    if (!report) {
      fmt::print(stderr, "tind-build: {}\n", report.error().message);
      return kFailed;
    }
    if (!report_path.empty()) {
      std::ofstream file(report_path, std::ios::trunc);
      file << tind::report_json(*report);
      if (!file.flush()) {
        fmt::print(stderr, "tind-build: {}: the report could not be written; the pyramid is complete\n", report_path);
        return kFailed;
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
    return kFailed;
  }
}
