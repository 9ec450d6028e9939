// SPDX-License-Identifier: GPL-3.0-or-later
// tind-verify: shows over HTTP that a pyramid is seamless and keeps its promise. See docs/verify.md.
#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/client/http_source.hpp"
#include "tests/client/verify.hpp"

namespace {

constexpr int kHeld = 0, kFailed = 1, kUsage = 2;

struct Arguments {
  std::string url;
  std::vector<std::string> sources;
  tind::client::SourceOptions source_options;
  tind::client::VerifyOptions verify;
  std::string json_path;
  std::string classes;
  std::string resampling;
  bool quiet = false;
};

void describe_options(CLI::App& app, Arguments& a) {
  app.add_option("URL", a.url, "The dataset: http://HOST:PORT/NAME (NAME may be left out when there is only one)")
      ->required();
  app.add_option(
      "--source", a.sources,
      "Raster(s) or points (.las, .xyz, .csv) that the pyramid was built from: check |TIN - h| <= E_L at every "
      "post");
  app.add_option("--cuts", a.verify.cuts, "Quadtree cuts of the globe to join and check")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  app.add_option("--seed", a.verify.seed, "Seed of the cuts and of the sample")->capture_default_str();
  app.add_option("--sample", a.verify.sample, "Look at this share of the tiles only, in (0, 1]")
      ->check(CLI::Range(1e-9, 1.0))
      ->capture_default_str();
  app.add_option("--threads", a.verify.threads, "Threads to work with")
      ->check(CLI::Range(1, 256))
      ->capture_default_str();
  app.add_option("--nodata", a.source_options.nodata,
                 "Value that marks a void in the sources (default: as the file says)");
  app.add_option("--metres-per-unit", a.source_options.metres_per_unit,
                 "Vertical unit of the sources (default: as the file says)");
  app.add_option("--source-crs", a.source_options.source_crs,
                 "Coordinate system of the sources, e.g. EPSG:32611 (default: as the file says)");
  app.add_option("--class", a.classes, "Classes of points to keep, N[,N...] or all (.las only; default: 2, ground)");
  app.add_option("--resampling", a.resampling, "How projected rasters become posts (default: as the manifest says)")
      ->check(CLI::IsMember({"bilinear", "cubic"}));
  auto* datum = app.add_option("--vertical-datum", a.source_options.vertical_datum,
                               "System of the sources' heights, e.g. EPSG:5773: they become ellipsoidal");
  app.add_option("--geoid", a.source_options.geoid, "Grid of geoid heights to add to the sources' (.gtx, .tif)")
      ->excludes(datum);
  app.add_option("--json", a.json_path, "Write everything that was found to this file");
  app.add_flag("--quiet", a.quiet, "No progress lines");
}

int fail(int code, const std::string& message) {
  fmt::print(stderr, "tind-verify: {}\n", message);
  return code;
}

/// "2,9" or "all" (nullopt) or nothing (left as it is); false: none of these.
bool parse_classes(const std::string& text, std::optional<std::vector<int>>& classes) {
  if (text.empty()) return true;
  if (text == "all") {
    classes.reset();
    return true;
  }
  classes.emplace();
  std::size_t at = 0;
  while (at <= text.size()) {
    const std::size_t end = std::min(text.find(',', at), text.size());
    int number = 0;
    const auto [stop, error] = std::from_chars(text.data() + at, text.data() + end, number);
    if (error != std::errc() || stop != text.data() + end || number < 0 || number > 255) return false;
    classes->push_back(number);
    at = end + 1;
  }
  return true;
}

int run(Arguments a) {
  using namespace tind::client;
  const auto url = parse_dataset_url(a.url);
  if (!url) return fail(kUsage, url.error());
  if (!parse_classes(a.classes, a.source_options.classes)) {
    return fail(kUsage, "--class " + a.classes + ": give numbers from 0 to 255 with commas between them, or all");
  }
  if (!a.quiet) {
    const bool terminal = isatty(STDERR_FILENO) != 0;
    a.verify.progress = [terminal](const std::string& what) {
      fmt::print(stderr, "{}tind-verify: {}{}", terminal ? "\r\x1b[K" : "", what, terminal ? "" : "\n");
      std::fflush(stderr);
    };
  }
  HttpSource source(url->base);
  a.verify.dataset = url->name;
  if (a.verify.dataset.empty()) {
    const auto name = find_only_dataset(source);
    if (!name) return fail(kFailed, name.error());
    a.verify.dataset = *name;
  }
  std::optional<SourcePosts> posts;
  if (!a.sources.empty()) {
    const auto manifest = fetch_manifest(source, a.verify.dataset);
    if (!manifest) return fail(kFailed, manifest.error());
    GridClaim claim = claim_of(*manifest);
    if (!a.resampling.empty()) claim.cubic = a.resampling == "cubic";
    auto read = read_source_posts(a.sources, a.source_options, claim);
    if (!read) return fail(kUsage, read.error());
    posts = std::move(*read);
  }
  const auto report = verify(source, posts ? &*posts : nullptr, a.verify);
  if (!a.quiet && isatty(STDERR_FILENO) != 0) fmt::print(stderr, "\r\x1b[K");
  if (!report) return fail(kFailed, report.error());
  (*report)->url = url->base + "/" + a.verify.dataset;
  fmt::print("{}", (*report)->text());
  if (!a.json_path.empty()) {
    std::ofstream out(a.json_path);
    out << (*report)->json().dump(2) << '\n';
    out.close();
    if (!out) return fail(kFailed, a.json_path + ": cannot be written");
  }
  return (*report)->all_held() ? kHeld : kFailed;
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  CLI::App app(
      "tind-verify: proves over HTTP that a tind pyramid is seamless and within its tolerances.\n"
      "Exit status: 0 all checks held, 1 a check failed or the server could not be asked, 2 wrong usage.");
  describe_options(app, arguments);
  try {
    app.parse(argc, argv);
    return run(std::move(arguments));
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kHeld : kUsage;
  } catch (const std::exception& error) {
    return fail(kFailed, error.what());
  }
}
