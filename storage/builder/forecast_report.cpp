// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/forecast_report.hpp"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <cmath>

#include "storage/builder/duration.hpp"

namespace tind {
namespace {

using nlohmann::json;

const char* weight_name(PlanProblem::Weight weight) {
  switch (weight) {
    case PlanProblem::Weight::kError:
      return "error";
    case PlanProblem::Weight::kWarning:
      return "warning";
    case PlanProblem::Weight::kNote:
      break;
  }
  return "note";
}

// Two significant digits: the rest would pretend.
double rounded(double value) {
  if (!(value > 0)) return 0;
  const double step = std::pow(10.0, std::floor(std::log10(value)) - 2);
  return std::round(value / step) * step;
}

std::string bytes_text(double bytes) {
  if (bytes < 1e9) return fmt::format("{:.3g} MB", std::max(0.1, bytes / 1e6));
  return fmt::format("{:.3g} GB", bytes / 1e9);
}

}  // namespace

std::string forecast_text(const Forecast& f) {
  const auto [west, south, east, north] = f.bounds_deg;
  const std::string& first = f.sources.front();
  std::string out =
      fmt::format("{}: {} x {} posts, {:.6g} x {:.6g} degrees apart; {:.5f} to {:.5f} east, {:.5f} to {:.5f} north\n",
                  f.sources.size() == 1 ? first : fmt::format("{} and {} more", first, f.sources.size() - 1), f.n_cols,
                  f.n_rows, f.spacing_deg[0], f.spacing_deg[1], west, east, south, north);
  out += fmt::format("{:>5} {:>11} {:>11} {:>10} {:>12} {:>10}\n", "level", "E_L m", "spacing m", "tiles", "vertices",
                     "MB");
  for (std::size_t l = 0; l < f.levels.size(); ++l) {
    const LevelCost& cost = f.levels[l];
    out += fmt::format("{:>5} {:>11.2f} {:>11.2f} {:>10.0f} {:>12.0f} {:>10.2f}\n", l, f.table.levels[l].tolerance_m,
                       f.table.levels[l].spacing_m, cost.tiles, rounded(cost.vertices), cost.bytes / 1e6);
  }
  out += fmt::format("{:>5} {:>11} {:>11} {:>10.0f} {:>12.0f} {:>10.2f}\n", "all", "", "", f.total(&LevelCost::tiles),
                     rounded(f.total(&LevelCost::vertices)), static_cast<double>(f.output_bytes) / 1e6);
  out += fmt::format("time    about {} with 1 thread", duration_text(f.seconds_one));
  if (f.threads > 1) out += fmt::format(", {} with {}", duration_text(f.seconds), f.threads);
  out += fmt::format("\nmemory  about {}\ndisk    about {} for the pyramid, {} beside it while it is built\n",
                     bytes_text(static_cast<double>(f.memory_bytes)), bytes_text(static_cast<double>(f.output_bytes)),
                     bytes_text(static_cast<double>(f.scratch_bytes)));
  out += fmt::format("From {} of {} regions built to try{}.\n", f.n_regions, f.n_all_regions,
                     f.whole_source_read ? "" : fmt::format(" and {} posts looked at", f.signs.posts));
  for (const PlanProblem& p : f.problems) {
    out += fmt::format("{}: {}\n", weight_name(p.weight), p.text);
    if (!p.advice.empty()) out += fmt::format("    {}\n", p.advice);
  }
  return out;
}

std::string forecast_json(const Forecast& f) {
  json levels = json::array();
  for (std::size_t l = 0; l < f.levels.size(); ++l) {
    const LevelCost& cost = f.levels[l];
    levels.push_back({{"level", l},
                      {"tolerance_m", f.table.levels[l].tolerance_m},
                      {"spacing_m", f.table.levels[l].spacing_m},
                      {"tiles", std::llround(cost.tiles)},
                      {"vertices", std::llround(cost.vertices)},
                      {"bytes", std::llround(cost.bytes)},
                      {"seconds", cost.seconds}});
  }
  json problems = json::array();
  for (const PlanProblem& p : f.problems) {
    problems.push_back({{"weight", weight_name(p.weight)}, {"kind", p.kind}, {"text", p.text}, {"advice", p.advice}});
  }
  return json({{"source_kind", f.source_kind},
               {"sources", f.sources},
               {"bounds_deg", f.bounds_deg},
               {"spacing_deg", f.spacing_deg},
               {"n_cols", f.n_cols},
               {"n_rows", f.n_rows},
               {"posts", std::llround(f.posts)},
               {"lowest_m", f.signs.lowest_m},
               {"highest_m", f.signs.highest_m},
               {"bottom_level", f.levels.size() - 1},
               {"levels", std::move(levels)},
               {"tiles", std::llround(f.total(&LevelCost::tiles))},
               {"vertices", std::llround(f.total(&LevelCost::vertices))},
               {"threads", f.threads},
               {"seconds", f.seconds},
               {"seconds_one_thread", f.seconds_one},
               {"read_seconds", f.read_seconds},
               {"line_seconds", f.line_seconds},
               {"tile_seconds", f.tile_seconds},
               {"memory_bytes", f.memory_bytes},
               {"output_bytes", f.output_bytes},
               {"scratch_bytes", f.scratch_bytes},
               {"sample",
                {{"regions", f.n_regions},
                 {"of_regions", f.n_all_regions},
                 {"posts_looked_at", f.signs.posts},
                 {"whole_source_read", f.whole_source_read}}},
               {"problems", std::move(problems)}})
             .dump(2, ' ', false, json::error_handler_t::replace) +
         "\n";
}

}  // namespace tind
