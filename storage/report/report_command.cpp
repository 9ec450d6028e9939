// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/report/report_command.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <charconv>
#include <cstdio>
#include <exception>
#include <fstream>
#include <optional>
#include <string>

#include "storage/builder/build_arguments.hpp"
#include "storage/builder/interrupt.hpp"
#include "storage/builder/output_file.hpp"
#include "storage/report/picture.hpp"
#include "storage/report/pyramid_report.hpp"
#include "storage/report/report_text.hpp"

namespace tind {
namespace {

int complain(const std::string& what) {
  fmt::print(stderr, "tind-build report: {}\n", what);
  return kExitFailed;
}

/// "8-12", "8-", "-12" or "10". False: none of these.
bool parse_levels(const std::string& text, std::optional<int>& first, std::optional<int>& last) {
  const auto number = [](const std::string& part, std::optional<int>& value) {
    if (part.empty()) return true;
    int n = 0;
    const auto [end, error] = std::from_chars(part.data(), part.data() + part.size(), n);
    value = n;
    return error == std::errc() && end == part.data() + part.size() && n >= 0;
  };
  const auto dash = text.find('-');
  if (text.empty() || text == "-") return false;
  if (dash == std::string::npos) {
    const bool ok = number(text, first);
    last = first;
    return ok;
  }
  // An open end is a level all the same, so that the default range is not meant.
  if (dash == 0) first = 0;
  return number(text.substr(0, dash), first) && number(text.substr(dash + 1), last);
}

}  // namespace

int report_main(int argc, char** argv) {
  CLI::App app{
      "Measures a pyramid against its source, level by level: tind-build report NAME.tind --source FILE...\n"
      "Prints points, RMSE and E_max of the TIN and of bilinear rasters, and how well streams are kept."};
  app.name("tind-build report");
  app.footer(
      "Examples:\n"
      "  tind-build report dem.tind --source dem.tif --compare bilinear\n"
      "  tind-build report dem.tind --source dem.tif --compare bilinear --picture dem.svg --json > dem.json\n"
      "Exit status: 0 measured, 1 failed, 2 wrong usage. The manual is tind-build-report(1).");
  ReportOptions options;
  SourceHints& source = options.source;
  std::string compare, levels, classes, picture;
  bool no_streams = false, json = false, quiet = false;
  app.add_option("PYRAMID", options.pyramid, "The pyramid to measure")->required()->type_name("NAME.tind");
  app.add_option("--source", source.inputs, "The files it was built from")->required()->type_name("FILE");
  app.add_option("--compare", compare, "Measure rasters of the same spacing and number of points, too")
      ->check(CLI::IsMember({"bilinear"}))
      ->type_name("bilinear");
  app.add_option("--levels", levels,
                 "Levels to measure, e.g. 8-12, 8- or 10; default: those finer than the data is long")
      ->type_name("A-B");
  app.add_option("--unconstrained", options.unconstrained,
                 "The same source built with --no-drainage, instead of building it here for the comparison")
      ->type_name("FILE.tind");
  app.add_flag("--no-streams", no_streams, "No comparison of streams, and no unconstrained TIN");
  app.add_option("--buffer", options.buffer_cells, "Streams so many cells apart are the same")
      ->check(CLI::Range(0.0, 100.0))
      ->type_name("CELLS")
      ->capture_default_str();
  app.add_option("--drainage-cells", options.drainage_cells,
                 "Threshold of streams at the bottom level; default: what the pyramid was built with")
      ->check(CLI::Range(std::int64_t{1}, std::int64_t{1} << 40))
      ->type_name("N");
  app.add_option("--drainage-growth", options.drainage_growth, "That threshold grows so many times per coarser level")
      ->check(CLI::Range(1.0, 1000.0))
      ->type_name("F");
  app.add_option("--nodata", source.nodata, "As tind-build was told; default: what the pyramid says it was told")
      ->type_name("V");
  app.add_option("--metres-per-unit", source.metres_per_unit, "The same")->check(CLI::PositiveNumber)->type_name("M");
  app.add_option("--vertical-datum", source.vertical_datum, "The same")->type_name("CRS");
  app.add_option("--geoid", source.geoid, "The same")->type_name("FILE");
  app.add_option("--class", classes, "The same")->type_name("N[,N...]");
  app.add_option("--source-crs", source.source_crs, "The same")->type_name("CRS");
  app.add_option("--spacing", source.spacing_m, "The same")->check(CLI::PositiveNumber)->type_name("M");
  app.add_option("--threads", options.threads, "Worker threads; 0: all cores. The figures do not depend on it")
      ->check(CLI::Range(0, 1024))
      ->type_name("N")
      ->capture_default_str();
  app.add_option("--picture", picture, "Draw the report, with hill-shades of the source and of the TIN")
      ->type_name("FILE.svg");
  app.add_option("--picture-level", options.picture_level,
                 "Level of that hill-shade; default: the coarsest with 3000 points")
      ->type_name("N");
  app.add_flag("--json", json, "Print the report as JSON");
  app.add_flag("-q,--quiet", quiet, "No progress");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : kExitUsage;
  }
  if (!levels.empty() && !parse_levels(levels, options.first_level, options.last_level)) {
    complain(fmt::format("--levels {}: give levels as 8-12, 8- or 10", levels));
    return kExitUsage;
  }
  if (!classes.empty()) {
    const auto filter = parse_class_filter(classes);
    if (!filter) {
      complain("--class: " + filter.error().message);
      return kExitUsage;
    }
    source.classes = *filter;
  }
  if (!picture.empty()) {
    if (picture.size() < 5 || picture.substr(picture.size() - 4) != ".svg") {
      complain(
          fmt::format("--picture {}: pictures are drawn as SVG; name it FILE.svg (a browser or rsvg-convert turns "
                      "that into PNG)",
                      picture));
      return kExitUsage;
    }
  }
  options.picture = !picture.empty();
  options.bilinear = !compare.empty();
  options.streams = !no_streams;
  options.cancel = cancel_on_signals();

  try {
    // A picture that cannot be written is known before the long work starts.
    TemporaryFile drawn(fmt::format("{}-{}.tmp", picture, ::getpid()));
    std::ofstream drawing_file;
    if (!picture.empty()) {
      if (const auto checked = check_output(picture, true); !checked) return complain(checked.error().message);
      drawing_file.open(drawn.path(), std::ios::trunc);
      if (!drawing_file) return complain(picture + ": cannot be written there");
    }
    const auto report = measure_pyramid(options, quiet ? nullptr : stderr);
    if (!report) return complain(report.error().message);
    if (!picture.empty()) {
      const auto drawing = draw_report(*report);
      if (!drawing) return complain(fmt::format("{}: {}", picture, drawing.error().message));
      drawing_file << *drawing;
      drawing_file.close();
      if (!drawing_file) return complain(picture + ": could not be written; is the disk full?");
      if (const auto named = drawn.rename_to(picture); !named) return complain(named.error().message);
    }
    fmt::print("{}", json ? pyramid_report_json(*report) : pyramid_report_text(*report));
    return 0;
  } catch (const std::exception& e) {
    return complain(fmt::format("{} (out of memory? fewer --threads take less)", e.what()));
  }
}

}  // namespace tind
