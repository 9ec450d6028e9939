// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/report/report_text.hpp"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace tind {
namespace {

using nlohmann::json;

double thousands(std::uint64_t n) { return static_cast<double>(n) / 1e3; }

double rmse_share(const SurfaceErrors& errors) { return errors.max_m > 0 ? errors.rmse_m() / errors.max_m : 0; }

bool any_level(const PyramidReport& report, const std::optional<SurfaceFigures> LevelReport::*surface) {
  for (const LevelReport& row : report.levels) {
    if (row.*surface) return true;
  }
  return false;
}

std::string errors_text(const std::optional<SurfaceFigures>& figures) {
  if (!figures || figures->errors.n_posts == 0) return fmt::format("{:>8} {:>7} {:>8}", "-", "-", "-");
  return fmt::format("{:>8.2f} {:>7.2f} {:>8.2f}", thousands(figures->n_points), figures->errors.rmse_m(),
                     figures->errors.max_m);
}

std::string surface_table(const PyramidReport& report) {
  const bool rasters = any_level(report, &LevelReport::same_spacing);
  std::string out = fmt::format("{:<73}", "TIN");
  if (rasters) out += fmt::format(" | {:<25}| {:<25}", "bilinear, level's spacing", "bilinear, as many points");
  out += fmt::format("\n{:>5} {:>8} {:>8} {:>9} {:>7} {:>8} {:>8} {:>7} {:>5}", "level", "E_L m", "spacing m",
                     "points k", "% posts", "per km2", "E_max m", "RMSE m", "R/E");
  const std::string errors_head = fmt::format("{:>8} {:>7} {:>8}", "points k", "RMSE m", "E_max m");
  if (rasters) out += fmt::format(" | {}| {}", errors_head, errors_head);
  out += '\n';
  for (const LevelReport& row : report.levels) {
    out += fmt::format("{:>5} {:>8.2f} {:>8.1f} {:>9.2f} {:>7.3f} {:>8.2f} {:>8.2f} {:>7.2f} {:>5.2f}", row.level,
                       row.tolerance_m, row.spacing_m, thousands(row.tin.n_points), report.percent_of_posts(row.tin),
                       report.points_per_km2(row.tin), row.tin.errors.max_m, row.tin.errors.rmse_m(),
                       rmse_share(row.tin.errors));
    if (rasters) out += fmt::format(" | {}| {}", errors_text(row.same_spacing), errors_text(row.same_points));
    out += '\n';
  }
  out +=
      "spc.: spacing; points: vertices whose nearest post is of the source (10^3); R/E: RMSE / E_max; errors at the "
      "posts.\n";
  if (rasters) {
    out +=
        "bilinear: a raster taken from the source's posts, interpolated bilinearly at the posts; beside voids only "
        "where"
        "\nall four of its nodes are data. \"-\": there is none.\n";
  }
  return out;
}

std::string extra_table(const PyramidReport& report) {
  const bool plain = any_level(report, &LevelReport::unconstrained);
  bool native = false;
  for (const LevelReport& row : report.levels) native = native || row.native;
  std::string out =
      fmt::format("\n{:>5} {:>9} {:>9} {:>9} {:>9}", "level", "in voids", "beyond", "RMSE mf", "E_max mf");
  if (plain) out += fmt::format(" | {:>8} {:>7} {:>8} {:>8}", "points k", "RMSE m", "E_max m", "lines +%");
  if (native) out += fmt::format(" | {:>8} {:>7} {:>8}", "cells k", "RMSE m", "E_max m");
  out += '\n';
  for (const LevelReport& row : report.levels) {
    out += fmt::format("{:>5} {:>9.2f} {:>9.2f} {:>9.3f} {:>9.3f}", row.level, thousands(row.n_void_points),
                       thousands(row.n_outside_points), row.manifest_rmse_m, row.manifest_max_error_m);
    if (plain) {
      out += " | " + errors_text(row.unconstrained);
      const double before = row.unconstrained ? static_cast<double>(row.unconstrained->n_points) : 0;
      out += before > 0 ? fmt::format(" {:>8.2f}", (static_cast<double>(row.tin.n_points) / before - 1) * 100)
                        : fmt::format(" {:>8}", "-");
    }
    if (native && row.native) {
      out += fmt::format(" | {:>8.2f} {:>7.2f} {:>8.2f}", thousands(row.native->n_posts), row.native->rmse_m(),
                         row.native->max_m);
    }
    out += '\n';
  }
  out +=
      "in voids, beyond: further vertices (10^3) in interior voids and beyond the data; RMSE mf, E_max mf: by the "
      "manifest.\n";
  if (plain) out += "Second part: the TIN without lines (unconstrained), and the points that the lines add to it.\n";
  if (native) {
    out += fmt::format(
        "Last part: the TIN at the source's own cells, before they were warped to posts ({} cells beside voids or on "
        "the "
        "rim left out).\n",
        report.n_native_left_out);
  }
  return out;
}

std::string match_text(const std::optional<SurfaceFigures>& figures) {
  if (!figures || !figures->streams || figures->streams->reference_length == 0)
    return fmt::format("{:>5} {:>5} {:>5} {:>5}", "-", "-", "-", "-");
  const StreamMatch& m = *figures->streams;
  return fmt::format("{:>5.3f} {:>5.3f} {:>5.3f} {:>5.2f}", m.completeness(), m.correctness(), m.quality(),
                     m.mean_distance);
}

std::string stream_table(const PyramidReport& report) {
  bool any = false;
  for (const LevelReport& row : report.levels) any = any || row.tin.streams;
  if (!any) return "";
  const bool plain = any_level(report, &LevelReport::unconstrained);
  const bool rasters = any_level(report, &LevelReport::same_spacing);
  const std::string head = fmt::format("{:>5} {:>5} {:>5} {:>5}", "compl", "corr", "qual", "dist");
  std::string first = fmt::format("\n{:<24} | {:<23}", "streams", report.has_lines ? "TIN with lines" : "TIN");
  std::string second = fmt::format("{:>5} {:>9} {:>8} | {}", "level", "threshold", "length", head);
  const auto add = [&](const char* name) {
    first += fmt::format(" | {:<23}", name);
    second += " | " + head;
  };
  if (plain) add("TIN without lines");
  if (rasters) add("bilinear, spacing");
  if (rasters) add("bilinear, points");
  std::string out = first + '\n' + second + '\n';
  for (const LevelReport& row : report.levels) {
    if (!row.tin.streams) continue;
    out += fmt::format("{:>5} {:>9.0f} {:>8.0f} | {}", row.level, *row.stream_cells, row.tin.streams->reference_length,
                       match_text(row.tin));
    if (plain) out += " | " + match_text(row.unconstrained);
    if (rasters) out += " | " + match_text(row.same_spacing) + " | " + match_text(row.same_points);
    out += '\n';
  }
  return out + fmt::format(
                   "Streams extracted anew from each surface at the posts, against those of the posts themselves: both "
                   "with `threshold` cells of\narea; length of the latter in cells. compl: share of them within {:g} "
                   "cells of the former; corr: the other way round; qual:\nmatched / (extracted + missed); dist: mean "
                   "distance of what matched, in cells.\n",
                   report.buffer_cells);
}

json match_json(const StreamMatch& m) {
  return {{"completeness", m.completeness()},
          {"correctness", m.correctness()},
          {"quality", m.quality()},
          {"mean_distance_cells", m.mean_distance},
          {"reference_length_cells", m.reference_length},
          {"extracted_length_cells", m.extracted_length}};
}

json figures_json(const PyramidReport& report, const SurfaceFigures& f) {
  json j = {{"points", f.n_points},
            {"percent_of_posts", report.percent_of_posts(f)},
            {"points_per_km2", report.points_per_km2(f)},
            {"posts_measured", f.errors.n_posts},
            {"rmse_m", f.errors.rmse_m()},
            {"max_error_m", f.errors.max_m}};
  if (f.streams) j["streams"] = match_json(*f.streams);
  if (f.shape) j["nodes"] = {f.shape->n_rows, f.shape->n_cols};
  return j;
}

}  // namespace

std::string pyramid_report_text(const PyramidReport& report) {
  std::string sources;
  for (const std::string& name : report.source_names) sources += (sources.empty() ? "" : ", ") + name;
  if (sources.size() > 60) sources = sources.substr(0, 57) + "...";
  std::string out = fmt::format("{} from {}: {} {}, {:.{}f} km2\n\n", report.name, sources, report.n_posts,
                                report.source_kind == "points"   ? "points"
                                : report.source_kind == "warped" ? "warped posts"
                                                                 : "posts",
                                report.area_km2, report.area_km2 < 10 ? 4 : 1);
  out += surface_table(report) + extra_table(report) + stream_table(report);
  for (const std::string& note : report.notes) out += "note: " + note + "\n";
  return out;
}

std::string pyramid_report_json(const PyramidReport& report) {
  json levels = json::array();
  for (const LevelReport& row : report.levels) {
    json j = {{"level", row.level},
              {"tolerance_m", row.tolerance_m},
              {"spacing_m", row.spacing_m},
              {"tin", figures_json(report, row.tin)},
              {"points_in_voids", row.n_void_points},
              {"points_outside", row.n_outside_points},
              {"manifest_rmse_m", row.manifest_rmse_m},
              {"manifest_max_error_m", row.manifest_max_error_m}};
    if (row.unconstrained) j["unconstrained"] = figures_json(report, *row.unconstrained);
    if (row.same_spacing) j["bilinear_same_spacing"] = figures_json(report, *row.same_spacing);
    if (row.same_points) j["bilinear_same_points"] = figures_json(report, *row.same_points);
    if (row.stream_cells) j["stream_threshold_cells"] = *row.stream_cells;
    if (row.native) {
      j["native"] = {
          {"cells", row.native->n_posts}, {"rmse_m", row.native->rmse_m()}, {"max_error_m", row.native->max_m}};
    }
    levels.push_back(std::move(j));
  }
  return json({{"name", report.name},
               {"sources", report.source_names},
               {"source_kind", report.source_kind},
               {"posts", report.n_posts},
               {"area_km2", report.area_km2},
               {"buffer_cells", report.buffer_cells},
               {"native_cells_left_out", report.n_native_left_out},
               {"levels", std::move(levels)},
               {"notes", report.notes}})
             .dump(2, ' ', false, json::error_handler_t::replace) +
         "\n";
}

}  // namespace tind
