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
                      {"vertices_inserted", parts.inserted},
                      {"vertices_outside", parts.outside},
                      {"triangles", info.n_triangles},
                      {"percent_of_posts", percent_of_posts(info.n_vertices, report)},
                      {"posts", info.n_posts},
                      {"rmse_m", info.rmse_m},
                      {"max_error_m", info.max_error_m},
                      {"height_step_m", info.height_step_m},
                      {"bytes", info.bytes},
                      {"seconds", parts.seconds}});
  }
  json sources = json::array();
  for (const SourceInfo& s : m.sources) sources.push_back(s.name);
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
                 {"overlapping", report.counts.overlapping},
                 {"disagreeing", report.counts.disagreeing}}},
               {"disagreement_m", m.disagreement_m},
               {"levels", std::move(levels)},
               {"file_bytes", report.file_bytes},
               {"threads", report.threads},
               {"seconds", report.seconds},
               {"read_seconds", report.read_seconds}})
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
  if (report.counts.disagreeing) {
    out += fmt::format("; {} of {} shared posts disagree, by at most {:.2f} m from their mean",
                       report.counts.disagreeing, report.counts.overlapping, m.disagreement_m);
  }
  return out + fmt::format("\n{:.1f} MB in {:.1f} s with {} threads\n", static_cast<double>(report.file_bytes) / 1e6,
                           report.seconds, report.threads);
}

}  // namespace tind
