// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/report.hpp"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace tind {
namespace {

using nlohmann::json;

double percent_of_posts(std::uint64_t n, const BuildReport& report) {
  return report.manifest.n_source_posts
             ? 100.0 * static_cast<double>(n) / static_cast<double>(report.manifest.n_source_posts)
             : 0.0;
}

}  // namespace

std::string report_json(const BuildReport& report) {
  const Manifest& m = report.manifest;
  json levels = json::array();
  for (std::size_t l = 0; l < m.levels.size(); ++l) {
    const LevelInfo& info = m.levels[l];
    const LevelBreakdown& parts = report.breakdown[l];
    levels.push_back({{"level", info.level},
                      {"tolerance_m", info.tolerance_m},
                      {"spacing_m", info.spacing_m},
                      {"tiles", info.n_tiles},
                      {"tiles_real", info.n_real},
                      {"tiles_partial", info.n_partial},
                      {"tiles_filler", info.n_filler},
                      {"vertices", info.n_vertices},
                      {"vertices_corner", parts.corners},
                      {"vertices_border", parts.border},
                      {"vertices_seed", info.n_seed_vertices},
                      {"vertices_inherited", parts.inherited},
                      {"vertices_of_lines", parts.of_lines},
                      {"vertices_inserted", parts.inserted},
                      {"line_pieces", parts.line_pieces},
                      {"line_pieces_left_out", parts.left_out},
                      {"vertices_outside", parts.outside},
                      {"triangles", info.n_triangles},
                      {"percent_of_posts", percent_of_posts(info.n_vertices, report)},
                      {"posts", info.n_posts},
                      {"rmse_m", info.rmse_m},
                      {"max_error_m", info.max_error_m},
                      {"height_step_m", info.height_step_m},
                      {"bytes", info.bytes},
                      {"tiles_built", parts.built},
                      {"tiles_repeated", parts.repeated},
                      {"tiles_copied", parts.copied},
                      {"seconds", parts.seconds}});
  }
  json drainage;
  if (report.drainage_cells > 0) {
    const DrainageCounts& d = report.drainage;
    drainage = {{"cells", report.drainage_cells},
                {"streams", m.lines.streams},
                {"shores", m.lines.shores},
                {"posts", d.posts},
                {"filled_posts", d.filled_posts},
                {"flat_posts", d.flat_posts},
                {"sea_posts", d.sea_posts},
                {"lakes", d.lakes},
                {"lake_posts", d.lake_posts},
                {"basin_posts", d.basin_posts},
                {"channel_posts", d.channel_posts},
                {"stream_posts", d.stream_posts},
                {"deep_posts", d.deep_posts},
                {"clamped", d.clamped},
                {"uphill_steps", d.uphill_steps},
                {"largest_uphill_m", d.largest_uphill_m},
                {"largest_deviation_m", d.largest_deviation_m},
                {"stream_deviations", d.deviations_above}};
  }
  json given;
  if (m.lines.given > 0) {
    const BreakLineCounts& g = report.given;
    given = {{"features", g.features},
             {"chains", m.lines.given},
             {"vertices", g.vertices},
             {"outside", g.outside},
             {"cut", g.cut},
             {"repeated", g.repeated},
             {"meetings", g.meetings},
             {"shared", g.shared},
             {"points_left_out", g.points},
             {"heights_moved", g.limited},
             {"largest_move_m", g.largest_change_m}};
  }
  json sources = json::array();
  for (const SourceInfo& s : m.sources) sources.push_back(s.name);
  json changed = json::array();
  for (const TileKey& tile : report.changed_tiles) changed.push_back({tile.level, tile.x, tile.y});
  return json({{"generator", m.generator},
               {"sources", std::move(sources)},
               {"bottom_level", m.bottom_level},
               {"mode", m.mode},
               {"bounds_deg", m.bounds_deg},
               {"spacing_deg", m.spacing_deg},
               {"posts",
                {{"source", report.counts.source},
                 {"filled", report.counts.filled},
                 {"falloff", report.counts.falloff},
                 {"interpolated", report.counts.interpolated},
                 {"duplicates", report.counts.duplicates},
                 {"overlapping", report.counts.overlapping},
                 {"disagreeing", report.counts.disagreeing}}},
               {"disagreement_m", m.disagreement_m},
               {"drainage", std::move(drainage)},
               {"break_lines", std::move(given)},
               {"levels", std::move(levels)},
               {"changed_tiles", std::move(changed)},
               {"file_bytes", report.file_bytes},
               {"file_is_copy", report.is_copy},
               {"threads", report.threads},
               {"seconds", report.seconds},
               {"read_seconds", report.read_seconds},
               {"line_seconds", report.line_seconds}})
             .dump(2) +
         "\n";
}

std::string report_text(const BuildReport& report) {
  const Manifest& m = report.manifest;
  std::string out =
      fmt::format("{:>5} {:>11} {:>7} {:>10} {:>10} {:>8} {:>9} {:>10} {:>10} {:>11}\n", "level", "E_L m", "tiles",
                  "vertices", "of border", "% posts", "RMSE m", "max err m", "triangles", "bytes");
  for (const LevelInfo& info : m.levels) {
    out += fmt::format("{:>5} {:>11.2f} {:>7} {:>10} {:>10} {:>8.3f} {:>9.2f} {:>10.2f} {:>10} {:>11}\n", info.level,
                       info.tolerance_m, info.n_tiles, info.n_vertices, info.n_border_vertices,
                       percent_of_posts(info.n_vertices, report), info.rmse_m, info.max_error_m, info.n_triangles,
                       info.bytes);
  }
  out += fmt::format("{} source posts", report.counts.source);
  if (report.counts.filled) out += fmt::format(", {} in interior voids filled smoothly", report.counts.filled);
  out += fmt::format(", {} in the falloff to {} m", report.counts.falloff, m.base_height_m);
  if (report.counts.duplicates) out += fmt::format(", {} points left out as duplicates", report.counts.duplicates);
  if (report.counts.disagreeing) {
    out += fmt::format("; {} of {} shared posts disagree, by at most {:.2f} m from their mean",
                       report.counts.disagreeing, report.counts.overlapping, m.disagreement_m);
  }
  if (report.drainage_cells > 0) {
    out += fmt::format("\n{} streams from {} posts drained on, {} shores of lakes", m.lines.streams,
                       report.drainage_cells, m.lines.shores);
    if (report.drainage.uphill_steps > 0) {
      out += fmt::format("; {} steps of streams still run uphill, by at most {:.2f} m", report.drainage.uphill_steps,
                         report.drainage.largest_uphill_m);
    }
  }
  if (m.lines.given > 0) {
    out += fmt::format("\n{} break lines given", m.lines.given);
    if (report.given.limited > 0) {
      out += fmt::format(", {} of their heights moved towards the surface, by at most {:.2f} m", report.given.limited,
                         report.given.largest_change_m);
    }
  }
  return out + fmt::format("\n{:.1f} MB in {:.1f} s with {} threads\n", static_cast<double>(report.file_bytes) / 1e6,
                           report.seconds, report.threads);
}

}  // namespace tind
