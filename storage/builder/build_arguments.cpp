// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/build_arguments.hpp"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <charconv>

namespace tind {
namespace {

constexpr double kM2PerKm2 = 1e6;
constexpr const char* kSourceGroup = "Sources";
constexpr const char* kLineGroup = "Drainage and break lines";

/// The decimal number that `text` is, without sign; nullopt: it is none.
template <class Integer>
std::optional<Integer> number(std::string_view text) {
  Integer value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || text.front() == '-' || error != std::errc() || end != text.data() + text.size())
    return std::nullopt;
  return value;
}

}  // namespace

Result<std::uint64_t> parse_memory(const std::string& text) {
  std::string_view digits = text;
  int shift = 20;
  if (!digits.empty() &&
      (digits.back() == 'M' || digits.back() == 'm' || digits.back() == 'G' || digits.back() == 'g')) {
    if (digits.back() == 'G' || digits.back() == 'g') shift = 30;
    digits.remove_suffix(1);
  }
  const auto value = number<std::uint64_t>(digits);
  if (!value || *value > (std::uint64_t{1} << 50 >> shift)) {
    return fail(ErrorKind::kInvalidInput, text + ": give a size as 512M or 2G");
  }
  if (*value << shift < kLeastMemoryBytes) {
    return fail(ErrorKind::kInvalidInput, fmt::format("{}: at least {}M are needed", text, kLeastMemoryBytes >> 20));
  }
  return *value << shift;
}

Result<BuildOptions::Shard> parse_shard(const std::string& text) {
  const auto slash = std::string_view(text).find('/');
  if (slash != std::string_view::npos) {
    const auto index = number<int>(std::string_view(text).substr(0, slash));
    const auto count = number<int>(std::string_view(text).substr(slash + 1));
    if (index && count && *index < *count && *count <= kMostShards) return BuildOptions::Shard{*index, *count};
  }
  return fail(ErrorKind::kInvalidInput,
              fmt::format("{}: give I/N with 0 <= I < N <= {}, for example 0/4, 1/4, 2/4 and 3/4", text, kMostShards));
}

void BuildArguments::add_source(CLI::App& app) {
  RasterOptions& raster = options_.source.raster;
  PointOptions& points = options_.source.points;
  app.add_option("--nodata", raster.nodata, "Value that marks voids, instead of the file's")
      ->type_name("V")
      ->group(kSourceGroup);
  app.add_option("--metres-per-unit", raster.metres_per_unit, "Vertical unit of the input, e.g. 0.3048 for feet")
      ->check(CLI::PositiveNumber)
      ->type_name("M")
      ->group(kSourceGroup);
  app.add_option("--resampling", resampling_, "How projected rasters are warped to geographic posts")
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
  app.add_option("--class", classes_, "Point classes of LAS files to take: numbers, or all")
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
}

void BuildArguments::add_lines(CLI::App& app) {
  LineOptions& lines = options_.lines;
  app.add_flag("--no-drainage", no_drainage_, "No streams and shores in the surface")->group(kLineGroup);
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
  app.add_option("--lake-area", lake_km2_,
                 "Smallest level water whose shore is drawn at the bottom level, km2 (default: 4 times the area that a "
                 "vertex stands for, at least 0.25)")
      ->check(CLI::NonNegativeNumber)
      ->type_name("KM2")
      ->group(kLineGroup);
  app.add_option("--sea-level", lines.sea_level_m,
                 "Everything at or below is the sea (default: bodies at or below 0 m of 100,000 km2 and more)")
      ->type_name("M")
      ->group(kLineGroup);
  app.add_option("--breaklines", break_lines_, "Lines or polygons that the surface shall follow, any OGR source")
      ->type_name("FILE[:LAYER]")
      ->allow_extra_args(false)
      ->group(kLineGroup);
  app.add_option("--lakes", lakes_, "Polygons whose shores are level, any OGR source")
      ->type_name("FILE[:LAYER]")
      ->allow_extra_args(false)
      ->group(kLineGroup);
  app.add_option("--drainage-out", lines.lines_out, "Write the lines of every level for QGIS")
      ->type_name("FILE.gpkg")
      ->group(kLineGroup);
}

void BuildArguments::add_work(CLI::App& app) {
  app.add_option("--threads", options_.threads, "Worker threads; 0: all cores. The bytes do not depend on it")
      ->check(CLI::Range(0, 1024))
      ->type_name("N")
      ->capture_default_str();
  app.add_option("--memory", memory_, "What the build may hold in memory. The bytes do not depend on it")
      ->type_name("SIZE")
      ->capture_default_str();
  app.add_flag("--resume", options_.resume,
               "Go on where an interrupted build with the same inputs and options stopped");
  app.add_option("--shard", shard_, "Build part I of N, for `tind-build merge`")->type_name("I/N");
}

void BuildArguments::add_to(CLI::App& app, bool needs_output) {
  app.add_option("INPUT", options_.source.inputs,
                 "Elevation rasters (any GDAL format and CRS; .zip too), or points (.las, .xyz, .csv)")
      ->required()
      ->type_name("FILE");
  app.add_option("-o,--output", options_.output, "The pyramid to write")
      ->required(needs_output)
      ->type_name("NAME.tind");
  app.add_flag("--force", options_.force, "Replace an output that exists");
  app.add_option("--mode", mode_, "Bottom level: the source's own spacing (non-standard) or the nearest dyadic one")
      ->check(CLI::IsMember({"standard", "non-standard"}))
      ->capture_default_str();
  app.add_option("--max-level", options_.levels.max_level, "Stop at this level")->type_name("N");
  app.add_option("--tolerance", tolerances_,
                 "E of the bottom level in metres, instead of 4/5 of the spacing; further values are those of the "
                 "coarser levels, upwards (beyond the list E doubles)")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->type_name("M[,M...]");
  app.add_option("--finest", options_.levels.finest_m, "Go on below the bottom level, halving E, until E <= M metres")
      ->type_name("M");
  app.add_option("--metres-per-degree", metres_,
                 "Where spacing is measured for the 4/5 rule; auto: the source's own metres where it has them, else a "
                 "degree of longitude on the equator")
      ->check(CLI::IsMember({"auto", "equator", "mid-latitude"}))
      ->capture_default_str();
  add_source(app);
  add_lines(app);
  app.add_option("--base-height", options_.base_height_m, "Height of the surface far outside the data, metres")
      ->check(CLI::Range(-kMaxHeightM, kMaxHeightM))
      ->type_name("M")
      ->capture_default_str();
  app.add_option("--falloff", options_.falloff_posts, "Posts over which the surface falls to the base height")
      ->check(CLI::Range(1, 4096))
      ->type_name("N")
      ->capture_default_str();
  app.add_option("--attribution", options_.attribution, "Credit line that clients show")->type_name("TEXT");
  add_work(app);
}

Result<BuildOptions> BuildArguments::finish() const {
  BuildOptions options = options_;
  RasterOptions& raster = options.source.raster;
  PointOptions& points = options.source.points;
  LineOptions& lines = options.lines;
  options.levels.mode = mode_ == "standard" ? LevelMode::kStandard : LevelMode::kNonStandard;
  options.metres = metres_ == "equator"        ? BuildOptions::Metres::kEquator
                   : metres_ == "mid-latitude" ? BuildOptions::Metres::kMidLatitude
                                               : BuildOptions::Metres::kAuto;
  raster.resampling = resampling_ == "cubic" ? Resampling::kCubic : Resampling::kBilinear;
  points.metres_per_unit = raster.metres_per_unit;
  points.vertical_datum = raster.vertical_datum;
  points.geoid = raster.geoid;
  const auto filter = parse_class_filter(classes_);
  if (!filter) {
    return fail(ErrorKind::kInvalidInput, "--class: " + filter.error().message);
  }
  points.classes = *filter;
  lines.drainage = !no_drainage_;
  for (const std::string& spec : break_lines_) lines.given.push_back({spec, false});
  for (const std::string& spec : lakes_) lines.given.push_back({spec, true});
  if (lake_km2_) lines.lake_area_m2 = *lake_km2_ * kM2PerKm2;
  if (!tolerances_.empty()) {
    options.levels.tolerance_m = tolerances_.front();
    options.levels.coarser_tolerances_m.assign(tolerances_.begin() + 1, tolerances_.end());
  }
  auto memory = parse_memory(memory_);
  if (!memory) return fail(ErrorKind::kInvalidInput, "--memory " + memory.error().message);
  options.memory_bytes = *memory;
  if (!shard_.empty()) {
    auto shard = parse_shard(shard_);
    if (!shard) return fail(ErrorKind::kInvalidInput, "--shard " + shard.error().message);
    options.shard = *shard;
  }
  return options;
}

}  // namespace tind
