// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/plan_problems.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numbers>
#include <system_error>
#include <utility>

#include "storage/builder/output_file.hpp"
#include "storage/builder/unfinished_output.hpp"

namespace tind {
namespace {

using Weight = PlanProblem::Weight;

// Nothing on Earth is higher, or deeper under the sea.
constexpr double kEverestM = 8850, kDeepestM = -11050;
// Zeros beside voids are suspicious where everything else is higher than this.
constexpr double kStrayAboveM = 10;
constexpr double kMostAnisotropy = 2.5;
constexpr double kManyVoids = 0.01;
// As the builder: sources that disagree by more than this part of E_bottom may break the promise for one of them.
constexpr double kDisagreementShare = 1.0 / 8;
constexpr double kWholeMetreTolerance = 0.5;
constexpr double kAmpleSpace = 1.5;

// The readers' notes that are more than notes, by their words.
struct KnownNote {
  const char* words;
  const char* kind;
  Weight weight;
  const char* advice;
};
constexpr KnownNote kKnownNotes[] = {
    {"no CRS;", "missing_crs", Weight::kWarning,
     "if that is wrong, give the file its CRS: gdal_translate -a_srs EPSG:N IN OUT"},
    {"beyond +-", "implausible_heights", Weight::kWarning,
     "look where they lie with gdalinfo -hist; --nodata declares the value that marks voids"},
    {"of exactly 0 m", "zeros_beside_voids", Weight::kWarning, "if they mark voids give --nodata 0"},
    {"vertical datum differs", "vertical_datums_differ", Weight::kWarning,
     "bring them to one datum first, or build them apart: nothing is shifted between inputs"},
    {"without a shift", "old_datum", Weight::kWarning, "warp it with gdalwarp -t_srs EPSG:4326 first"},
};

void add(Forecast& forecast, Weight weight, const char* kind, std::string text, std::string advice) {
  forecast.problems.push_back({weight, kind, std::move(text), std::move(advice)});
}

std::string percent(double share) { return fmt::format("{:.{}f} %", share * 100, share < 0.1 ? 2 : 1); }

// "in the sample" where not everything was looked at.
const char* extent(const Forecast& forecast) { return forecast.whole_source_read ? "" : " of those looked at"; }

void add_notes(Forecast& forecast) {
  for (const std::string& note : forecast.notes) {
    const auto* known = std::find_if(std::begin(kKnownNotes), std::end(kKnownNotes),
                                     [&](const KnownNote& k) { return note.find(k.words) != std::string::npos; });
    if (known == std::end(kKnownNotes)) {
      add(forecast, Weight::kNote, "note", note, "");
    } else {
      add(forecast, known->weight, known->kind, note, known->advice);
    }
  }
}

void add_height_problems(const ElevationSource& source, const BuildOptions& options, Forecast& forecast) {
  const PostSigns& signs = forecast.signs;
  if (signs.heights == 0) {
    add(forecast, Weight::kWarning, "no_data", fmt::format("all {} posts{} are voids", signs.posts, extent(forecast)),
        "check the nodata value (--nodata) and the vertical unit (--metres-per-unit)");
    return;
  }
  const bool unit_given = options.source.raster.metres_per_unit.has_value();
  bool assumed = false, crs_in_feet = false;
  if (const RasterMosaic* raster = source.raster()) {
    for (const RasterSource& s : raster->sources) {
      assumed = assumed || s.unit_is_assumed;
      crs_in_feet = crs_in_feet || (s.unit_is_assumed && s.crs.find("(ft") != std::string::npos);
    }
  }
  if (signs.highest_m > kEverestM || signs.lowest_m < kDeepestM) {
    add(forecast, Weight::kWarning, "odd_vertical_unit",
        fmt::format("heights run from {:.0f} to {:.0f} m, beyond anything on Earth: feet or another unit are taken as "
                    "metres, or a value that marks voids is taken as a height",
                    signs.lowest_m, signs.highest_m),
        unit_given ? "check --metres-per-unit and the file's scale with gdalinfo"
                   : "give --metres-per-unit 0.3048 for feet, or --nodata for the value that marks voids");
  } else if (crs_in_feet && !unit_given) {
    add(forecast, Weight::kWarning, "odd_vertical_unit",
        fmt::format("the CRS counts feet and no vertical unit is named: the heights ({:.0f} to {:.0f}) are taken as "
                    "metres",
                    signs.lowest_m, signs.highest_m),
        "if they are feet, too, give --metres-per-unit 0.3048");
  }
  if (signs.zeros_beside_voids > 0 && signs.lowest_other_m > kStrayAboveM) {
    add(forecast, Weight::kWarning, "zeros_beside_voids",
        fmt::format("{} posts{} of exactly 0 m ({} of them beside voids) while all others are above {:.1f} m",
                    signs.zeros, extent(forecast), signs.zeros_beside_voids,
                    std::floor(signs.lowest_other_m * 10) / 10),
        "if they mark voids give --nodata 0");
  }
  if (signs.implausible > 0) {
    add(forecast, Weight::kWarning, "implausible_heights",
        fmt::format("{} posts{} lie beyond +-{} m and are taken as voids", signs.implausible, extent(forecast),
                    kMaxHeightM),
        "look where they lie with gdalinfo -hist; --nodata declares the value that marks voids");
  }
  if (signs.whole_metres && !source.has_points() && forecast.table.levels.back().tolerance_m < kWholeMetreTolerance) {
    add(forecast, Weight::kNote, "rounded_heights",
        fmt::format("heights are whole metres: the bottom level's E of {} m follows their steps, not the terrain",
                    forecast.table.levels.back().tolerance_m),
        "a tolerance of 0.5 m or more takes far fewer vertices");
  }
}

void add_void_problems(Forecast& forecast) {
  const PostSigns& signs = forecast.signs;
  if (signs.voids == 0 || signs.heights == 0) return;
  const double share = static_cast<double>(signs.voids) / static_cast<double>(signs.posts);
  add(forecast, share < kManyVoids ? Weight::kNote : Weight::kWarning, "voids",
      fmt::format("{} of the posts{} are voids ({} of {})", percent(share), extent(forecast), signs.voids, signs.posts),
      "inside the data they are filled smoothly, at its edge the surface falls off; where that is not wanted, name a "
      "second source that has data there as another INPUT");
}

void add_overlap_problems(Forecast& forecast) {
  const PostSigns& signs = forecast.signs;
  if (signs.disagreeing == 0 || signs.overlapping == 0) return;
  const double limit = forecast.table.levels.back().tolerance_m * kDisagreementShare;
  const bool far = signs.largest_disagreement_m > limit;
  add(forecast, far ? Weight::kWarning : Weight::kNote, "overlaps_disagree",
      fmt::format("{} of {} posts{} that several inputs have differ, by up to {:.2f} m", signs.disagreeing,
                  signs.overlapping, extent(forecast), signs.largest_disagreement_m),
      far ? "their mean is used, and the promise holds for that mean; leave the worse source out where it matters"
          : "their mean is used; the promise holds for each of them");
}

}  // namespace

void add_data_problems(const ElevationSource& source, const BuildOptions& options, Forecast& forecast) {
  add_notes(forecast);
  add_height_problems(source, options, forecast);
  add_void_problems(forecast);
  add_overlap_problems(forecast);
  const RasterMosaic* raster = source.raster();
  if (raster != nullptr && raster->vertical_datum == "unknown") {
    add(forecast, Weight::kNote, "unknown_vertical_datum",
        "nothing says what the heights count from; they are served as they are",
        "globes expect heights above the ellipsoid: --vertical-datum EPSG:5773 (EGM96, as SRTM) or the right one");
  }
  if (raster != nullptr && !raster->warped) {
    const auto [west, south, east, north] = forecast.bounds_deg;
    const double cosine = std::max(1e-3, std::cos((south + north) / 2 * std::numbers::pi / 180));
    const double ratio = raster->lon_spacing_deg * cosine / raster->lat_spacing_deg;
    if (ratio > kMostAnisotropy || ratio < 1 / kMostAnisotropy) {
      add(forecast, Weight::kNote, "anisotropic_posts",
          fmt::format("posts are {:.1f} times as far apart {} as {}", std::max(ratio, 1 / ratio),
                      ratio > 1 ? "eastwards" : "northwards", ratio > 1 ? "northwards" : "eastwards"),
          "the levels follow the spacing in longitude; --max-level or --tolerance fit them to the coarser one");
    }
  }
}

void add_output_problems(const BuildOptions& options, Forecast& forecast) {
  if (options.output.empty()) return;
  namespace fs = std::filesystem;
  if (const auto checked = check_output(options.output, options.force || options.resume); !checked) {
    std::error_code code;
    const bool exists = fs::is_regular_file(options.output, code);
    add(forecast, Weight::kError, exists ? "output_exists" : "output", checked.error().message,
        exists ? "give --force to replace it, or another name" : "");
    if (!exists) return;
  }
  std::error_code code;
  const fs::path output(options.output);
  const fs::path folder = output.has_parent_path() ? output.parent_path() : fs::path(".");
  if (!options.resume && UnfinishedOutput::exists_for(options.output)) {
    add(forecast, Weight::kNote, "interrupted_build",
        fmt::format("{}: a build of it did not come to its end, or is still running", options.output),
        "--resume goes on with it where its inputs and options are the same; --force drops it");
  }
  const auto space = fs::space(folder, code);
  if (code) return;
  const double needed = static_cast<double>(forecast.output_bytes + forecast.scratch_bytes);
  const auto free = static_cast<double>(space.available);
  if (needed * kAmpleSpace <= free) return;
  add(forecast, needed > free ? Weight::kError : Weight::kWarning, "disk_space",
      fmt::format("{}: {:.1f} GB are free, {:.1f} GB are needed ({:.1f} GB of them only while building)",
                  folder.string(), free / 1e9, needed / 1e9, static_cast<double>(forecast.scratch_bytes) / 1e9),
      "name an output on another disk, or make room");
}

}  // namespace tind
