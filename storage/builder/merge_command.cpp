// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/merge_command.hpp"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>

#include "storage/builder/build_arguments.hpp"
#include "storage/builder/interrupt.hpp"
#include "storage/builder/merge.hpp"

namespace tind {

int merge_main(int argc, char** argv) {
  CLI::App app{"Joins the shards of one build into its pyramid: tind-build merge A.tind B.tind... -o NAME.tind"};
  app.footer(
      "Examples:\n"
      "  tind-build dem.tif -o part0.tind --shard 0/2\n"
      "  tind-build dem.tif -o part1.tind --shard 1/2\n"
      "  tind-build merge part0.tind part1.tind -o dem.tind\n"
      "The result has the same bytes as one build without --shard.\n"
      "Exit status: 0 merged, 1 failed (an earlier output is untouched), 2 wrong usage.");
  MergeOptions options;
  bool quiet = false;
  app.add_option("SHARD", options.inputs, "All shards of the build, in any order")->required()->type_name("FILE");
  app.add_option("-o,--output", options.output, "The pyramid to write")->required()->type_name("NAME.tind");
  app.add_flag("--force", options.force, "Replace an output that exists, drop an interrupted merge");
  app.add_flag("-q,--quiet", quiet, "No progress and no summary");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& e) {
    return app.exit(e) == 0 ? 0 : kExitUsage;
  }
  options.cancel = cancel_on_signals();
  Progress progress(quiet ? nullptr : stderr);
  const auto report = merge_pyramids(options, progress);
  progress.finish();
  if (!report) {
    fmt::print(stderr, "tind-build merge: {}\n", report.error().message);
    return kExitFailed;
  }
  if (!quiet) {
    std::uint64_t n_tiles = 0;
    for (const LevelInfo& level : report->manifest.levels) n_tiles += level.n_tiles;
    fmt::print("{} tiles of {} shards, {:.1f} MB in {:.1f} s\n", n_tiles, options.inputs.size(),
               static_cast<double>(report->file_bytes) / 1e6, report->seconds);
  }
  return 0;
}

}  // namespace tind
