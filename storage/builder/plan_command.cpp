// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/plan_command.hpp"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <exception>

#include "storage/builder/build_arguments.hpp"
#include "storage/builder/forecast.hpp"
#include "storage/builder/forecast_report.hpp"
#include "storage/builder/interrupt.hpp"

namespace tind {
namespace {

int complain(const std::string& what, int status) {
  fmt::print(stderr, "tind-build plan: {}\n", what);
  return status;
}

}  // namespace

int plan_main(int argc, char** argv) {
  CLI::App app{
      "Says what a build would make and take, and what is odd about the data: tind-build plan INPUT... [-o NAME.tind]\n"
      "Takes the options of tind-build; builds a few regions to try and writes nothing."};
  app.name("tind-build plan");
  app.footer(
      "Examples:\n"
      "  tind-build plan dem.tif\n"
      "  tind-build plan N36W118.hgt N36W119.hgt -o sierra.tind --tolerance 10 --threads 4\n"
      "  tind-build plan dem.tif --json > plan.json\n"
      "Exit status: 0 the build can start, 1 it would fail, 2 wrong usage. The manual is tind-build-plan(1).");
  BuildArguments arguments;
  bool json = false;
  arguments.add_to(app, false);
  app.add_flag("--json", json, "Print the plan as JSON");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : kExitUsage;
  }
  auto options = arguments.finish();
  if (!options) return complain(options.error().message, kExitUsage);
  options->cancel = cancel_on_signals();
  try {
    const auto forecast = make_forecast(*options);
    if (!forecast) return complain(forecast.error().message, kExitFailed);
    fmt::print("{}", json ? forecast_json(*forecast) : forecast_text(*forecast));
    const bool hopeless = std::any_of(forecast->problems.begin(), forecast->problems.end(),
                                      [](const PlanProblem& p) { return p.weight == PlanProblem::Weight::kError; });
    return hopeless ? kExitFailed : 0;
  } catch (const std::exception& e) {
    return complain(fmt::format("{} (out of memory? fewer --threads take less)", e.what()), kExitFailed);
  }
}

}  // namespace tind
