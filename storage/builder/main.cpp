// SPDX-License-Identifier: GPL-3.0-or-later
// tind-build: elevation data in, one .tind pyramid out.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <fstream>
#include <optional>
#include <string_view>

#include "storage/builder/build.hpp"
#include "storage/builder/report.hpp"
#include "storage/report/report_command.hpp"

namespace {

constexpr int kFailed = 1;
constexpr int kUsage = 2;
constexpr double kM2PerKm2 = 1e6;
constexpr const char* kSourceGroup = "Sources";
constexpr const char* kLineGroup = "Drainage and break lines";

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
  if (argc > 1 && std::string_view(argv[1]) == "report") return tind::report_main(argc - 1, argv + 1);
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
  tind::BuildOptions options;
  std::string mode = "non-standard", metres = "auto", resampling = "bilinear", classes = "2", report_path;
  std::vector<double> tolerances;
  std::optional<double> lake_km2;
  std::vector<std::string> break_lines, lakes;
  bool no_drainage = false, json = false, quiet = false;
  app.add_option("INPUT", options.source.inputs,
                 "Elevation rasters (any GDAL format and CRS; .zip too), or points (.las, .xyz, .csv)")
      ->required()
      ->type_name("FILE");
  app.add_option("-o,--output", options.output, "The pyramid to write")->required()->type_name("NAME.tind");
  app.add_flag("--force", options.force, "Replace an output that exists");
  app.add_option("--mode", mode, "Bottom level: the source's own spacing (non-standard) or the nearest dyadic one")
      ->check(CLI::IsMember({"standard", "non-standard"}))
      ->capture_default_str();
  app.add_option("--max-level", options.levels.max_level, "Stop at this level")->type_name("N");
  app.add_option("--tolerance", tolerances,
                 "E of the bottom level in metres, instead of 4/5 of the spacing; further values are those of the "
                 "coarser levels, upwards (beyond the list E doubles)")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->type_name("M[,M...]");
  app.add_option("--finest", options.levels.finest_m, "Go on below the bottom level, halving E, until E <= M metres")
      ->type_name("M");
  app.add_option("--metres-per-degree", metres,
                 "Where spacing is measured for the 4/5 rule; auto: the source's own metres where it has them, else a "
                 "degree of longitude on the equator")
      ->check(CLI::IsMember({"auto", "equator", "mid-latitude"}))
      ->capture_default_str();
  tind::RasterOptions& raster = options.source.raster;
  tind::PointOptions& points = options.source.points;
  app.add_option("--nodata", raster.nodata, "Value that marks voids, instead of the file's")
      ->type_name("V")
      ->group(kSourceGroup);
  app.add_option("--metres-per-unit", raster.metres_per_unit, "Vertical unit of the input, e.g. 0.3048 for feet")
      ->check(CLI::PositiveNumber)
      ->type_name("M")
      ->group(kSourceGroup);
  app.add_option("--resampling", resampling, "How projected rasters are warped to geographic posts")
      ->check(CLI::IsMember({"bilinear", "cubic"}))
      ->capture_default_str()
      ->group(kSourceGroup);
  auto* datum = app.add_option("--vertical-datum", raster.vertical_datum,
                               "What the input's heights count from (EPSG:5773 is EGM96); they become ellipsoidal")
                    ->type_name("CRS")
                    ->group(kSourceGroup);
  app.add_option("--geoid", raster.geoid, "Grid of geoid heights to add (.gtx, .tif); heights become ellipsoidal")
      ->type_name("FILE")
      ->excludes(datum)
      ->group(kSourceGroup);
  app.add_option("--class", classes, "Point classes of LAS files to take: numbers, or all")
      ->type_name("N[,N...]")
      ->capture_default_str()
      ->group(kSourceGroup);
  app.add_option("--source-crs", points.source_crs, "CRS of points, instead of the file's")
      ->type_name("CRS")
      ->group(kSourceGroup);
  app.add_option("--spacing", points.spacing_m, "Spacing of points in metres, instead of what their density gives")
      ->check(CLI::PositiveNumber)
      ->type_name("M")
      ->group(kSourceGroup);
  tind::LineOptions& lines = options.lines;
  app.add_flag("--no-drainage", no_drainage, "No streams and shores in the surface")->group(kLineGroup);
  app.add_option(
         "--drainage-cells", lines.drainage_cells,
         "Posts that must drain into a stream to draw it at the bottom level (default: 44 times the posts that a "
         "vertex stands for)")
      ->check(CLI::Range(std::int64_t{1}, std::int64_t{1} << 40))
      ->type_name("N")
      ->group(kLineGroup);
  app.add_option("--drainage-growth", lines.drainage_growth, "That number grows so many times per coarser level")
      ->check(CLI::Range(1.0, 1000.0))
      ->type_name("F")
      ->capture_default_str()
      ->group(kLineGroup);
  app.add_option("--lake-area", lake_km2,
                 "Smallest level water whose shore is drawn at the bottom level, km2 (default: 4 times the area that a "
                 "vertex stands for, at least 0.25)")
      ->check(CLI::NonNegativeNumber)
      ->type_name("KM2")
      ->group(kLineGroup);
  app.add_option("--sea-level", lines.sea_level_m,
                 "Everything at or below is the sea (default: bodies at or below 0 m of 100,000 km2 and more)")
      ->type_name("M")
      ->group(kLineGroup);
  app.add_option("--breaklines", break_lines, "Lines or polygons that the surface shall follow, any OGR source")
      ->type_name("FILE[:LAYER]")
      ->allow_extra_args(false)
      ->group(kLineGroup);
  app.add_option("--lakes", lakes, "Polygons whose shores are level, any OGR source")
      ->type_name("FILE[:LAYER]")
      ->allow_extra_args(false)
      ->group(kLineGroup);
  app.add_option("--drainage-out", lines.lines_out, "Write the lines of every level for QGIS")
      ->type_name("FILE.gpkg")
      ->group(kLineGroup);
  app.add_option("--base-height", options.base_height_m, "Height of the surface far outside the data, metres")
      ->check(CLI::Range(-tind::kMaxHeightM, tind::kMaxHeightM))
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
  options.metres = metres == "equator"        ? tind::BuildOptions::Metres::kEquator
                   : metres == "mid-latitude" ? tind::BuildOptions::Metres::kMidLatitude
                                              : tind::BuildOptions::Metres::kAuto;
  raster.resampling = resampling == "cubic" ? tind::Resampling::kCubic : tind::Resampling::kBilinear;
  points.metres_per_unit = raster.metres_per_unit;
  points.vertical_datum = raster.vertical_datum;
  points.geoid = raster.geoid;
  const auto filter = tind::parse_class_filter(classes);
  if (!filter) {
    fmt::print(stderr, "tind-build: --class: {}\n", filter.error().message);
    return kUsage;
  }
  points.classes = *filter;
  lines.drainage = !no_drainage;
  for (const std::string& spec : break_lines) lines.given.push_back({spec, false});
  for (const std::string& spec : lakes) lines.given.push_back({spec, true});
  if (lake_km2) lines.lake_area_m2 = *lake_km2 * kM2PerKm2;
  if (!tolerances.empty()) {
    options.levels.tolerance_m = tolerances.front();
    options.levels.coarser_tolerances_m.assign(tolerances.begin() + 1, tolerances.end());
  }
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
