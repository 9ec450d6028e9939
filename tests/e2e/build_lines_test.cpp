// SPDX-License-Identifier: GPL-3.0-or-later
// tind-build with drainage, break lines, lakes, and tolerances per level.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "tests/client_checks/test_raster.hpp"
#include "tests/e2e/build_program.hpp"

namespace tind::test {
namespace {

using testing::HasSubstr;

/// A raster with a valley that winds south along its middle, 200 x 200 posts 0.01 degrees apart. With 4/5 of such a
/// spacing the valley would not matter: build_fine() makes it.
class BuildLines : public BuildProgram {
 protected:
  void SetUp() override {
    RasterPlan plan;
    plan.height_m = [](int r, int c) {
      const double off = c - 100 - 25 * std::sin(r / 30.0);
      return static_cast<int>(3000 - 6 * r + 40 * std::abs(off) + 120 * std::sin(c / 9.0) * std::sin(r / 7.0));
    };
    write_raster(input, plan);
  }
  void build_fine(std::vector<std::string> more = {}) const {
    more.insert(more.end(), {"--tolerance", "20"});
    expect_build({input}, more);
  }
  /// One GeoJSON file: `features` in the order given.
  std::string geojson(const std::string& name, const std::vector<std::string>& geometries) const {
    std::string text = R"({"type": "FeatureCollection", "features": [)";
    for (std::size_t k = 0; k < geometries.size(); ++k) {
      text +=
          (k ? "," : "") + std::string(R"({"type": "Feature", "properties": {}, "geometry": )") + geometries[k] + "}";
    }
    write_file(folder.file(name), text + "]}");
    return folder.file(name);
  }

  const std::string input = folder.file("in.tif");
  const std::string lines_out = folder.file("lines.gpkg");
  const std::string west_east = R"({"type": "LineString", "coordinates": [[10.2, 45.01], [11.8, 45.02]]})";
  const std::string south_north = R"({"type": "LineString", "coordinates": [[11.3, 44.2], [11.31, 45.8]]})";
  const std::string lake = R"({"type": "Polygon", "coordinates": [[[10.4, 45.3], [10.6, 45.3], [10.6, 45.5],
      [10.4, 45.5], [10.4, 45.3]]]})";
};

TEST_F(BuildLines, DrainageIsThereUnlessItIsNotWanted) {
  build_fine();
  const Manifest with = manifest();
  EXPECT_GT(with.lines.streams, 0u);
  EXPECT_GT(with.lines.vertices, 20u);
  EXPECT_EQ(with.lines.given, 0u);
  EXPECT_TRUE(nlohmann::json::parse(with.options_json)["drainage"].get<bool>());
  expect_verified({input});

  build_fine({"--force", "--no-drainage"});
  const Manifest without = manifest();
  EXPECT_EQ(without.lines.streams, 0u);
  EXPECT_EQ(without.lines.shores, 0u);
  EXPECT_EQ(without.lines.given, 0u);
  EXPECT_EQ(without.lines.vertices, 0u);
  EXPECT_FALSE(nlohmann::json::parse(without.options_json)["drainage"].get<bool>());
  EXPECT_NE(without.content_hash, with.content_hash);
}

TEST_F(BuildLines, BreakLineFilesThatCannotBeUsed) {
  write_file(folder.file("text.geojson"), "these are no lines\n");
  const std::string lines = geojson("lines.geojson", {west_east});
  const auto refusal = [&](const std::string& spec, const std::string& word) {
    SCOPED_TRACE(spec);
    for (const char* option : {"--breaklines", "--lakes"}) {
      expect_refusal(build({input, "-o", output, "--drainage-out", lines_out, option, spec}), word);
    }
  };
  refusal(folder.file("nowhere.gpkg"), "nowhere.gpkg: no such file");
  refusal(folder.file("text.geojson"), "not a vector file");
  refusal(input, "in.tif: not a vector file");
  refusal(lines + ":rivers", "no layer 'rivers'; it has: lines");
  refusal(geojson("far.geojson", {R"({"type": "LineString", "coordinates": [[60, 10], [61, 10]]})"}), "outside");
}

TEST_F(BuildLines, CrossingBreakLinesBuildAndAreToldOf) {
  const std::string lines = geojson("lines.geojson", {west_east, south_north});
  const std::string report = folder.file("report.json");
  auto finished = run_program("tind-build", {input, "-o", output, "--breaklines", lines, "--report", report});
  ASSERT_EQ(finished.status, 0) << finished.err;
  EXPECT_THAT(finished.err, HasSubstr("break lines: "));
  EXPECT_THAT(finished.err, HasSubstr("lines.geojson feature "));
  auto given = nlohmann::json::parse(read_file(report))["break_lines"];
  EXPECT_EQ(given["features"], 2);
  EXPECT_EQ(given["meetings"], 1) << "one crossing";
  EXPECT_EQ(given["shared"], 0);
  const Manifest m = manifest();
  EXPECT_GE(m.lines.given, 4u) << "four arms";
  for (const char* word : {"lines.geojson", "sha256"}) EXPECT_THAT(m.options_json, HasSubstr(word));
  expect_verified({input});

  // The same line twice and a ring that crosses itself.
  geojson("lines.geojson",
          {west_east, south_north, west_east,
           R"({"type": "Polygon", "coordinates": [[[10.2, 44.3], [10.8, 44.6], [10.8, 44.3], [10.2, 44.6],
              [10.2, 44.3]]]})"});
  finished = run_program("tind-build", {input, "-o", output, "--force", "--breaklines", lines, "--report", report});
  ASSERT_EQ(finished.status, 0) << finished.err;
  EXPECT_THAT(finished.err, HasSubstr("with itself"));
  given = nlohmann::json::parse(read_file(report))["break_lines"];
  EXPECT_EQ(given["features"], 4);
  EXPECT_GE(given["shared"], 1);
  EXPECT_GE(given["meetings"], 2);
  expect_verified({input});
}

TEST_F(BuildLines, EveryBreakLineOptionCountsAndTheirOrderDoesNot) {
  const std::string a = geojson("a.geojson", {west_east}), b = geojson("b.geojson", {south_north});
  const std::string shore = geojson("lake.geojson", {lake});
  expect_build({input}, {"--breaklines", a, "--lakes", shore, "--breaklines", b});
  EXPECT_GE(manifest().lines.given, 5u);
  expect_verified({input});
  const std::string hash = manifest().content_hash;
  expect_build({input}, {"--force", "--breaklines", b, "--breaklines", a, "--lakes", shore, "--threads", "1"});
  EXPECT_EQ(manifest().content_hash, hash);
  expect_build({input}, {"--force", "--breaklines", b, "--breaklines", a});
  EXPECT_NE(manifest().content_hash, hash);
}

TEST_F(BuildLines, LinesOfEveryLevelAreWrittenOut) {
  build_fine({"--drainage-out", lines_out, "--lakes", geojson("lake.geojson", {lake}), "--breaklines",
              geojson("lines.geojson", {west_east})});
  const std::string written = read_file(lines_out);
  EXPECT_THAT(written, testing::StartsWith("SQLite format 3"));
  const int bottom = manifest().bottom_level;
  for (const std::string& word : {"level_0" + std::to_string(bottom), "level_0" + std::to_string(bottom - 1),
                                  std::string("stream"), std::string("shore"), std::string("breakline")}) {
    EXPECT_TRUE(written.find(word) != std::string::npos) << word;
  }
  EXPECT_EQ(files(), (std::vector<std::string>{"in.tif", "lake.geojson", "lines.geojson", "lines.gpkg", "out.tind"}));
  // What was written can be given back, a layer at a time.
  const std::string layer = lines_out + ":level_0" + std::to_string(bottom);
  expect_build({input}, {"--force", "--no-drainage", "--breaklines", layer});
  EXPECT_GE(manifest().lines.given, 5u);
}

TEST_F(BuildLines, LinesOutIsRefusedBeforeAnyWork) {
  const std::string missing = folder.file("nowhere.tif");  // any work would find this first
  write_file(lines_out, "earlier lines");
  auto finished = build({missing, "-o", output, "--drainage-out", lines_out});
  EXPECT_EQ(finished.status, 1);
  EXPECT_EQ(count_lines(finished.err), 1u) << finished.err;
  EXPECT_THAT(finished.err, HasSubstr("lines.gpkg"));
  EXPECT_THAT(finished.err, HasSubstr("--force"));
  EXPECT_EQ(read_file(lines_out), "earlier lines");
  EXPECT_FALSE(std::filesystem::exists(output));

  std::filesystem::remove(lines_out);
  expect_refusal(build({missing, "-o", output, "--drainage-out", folder.file("lines.shp")}), "GeoPackage");
  expect_refusal(build({missing, "-o", output, "--drainage-out", folder.file("no/such/lines.gpkg")}), "folder");
  EXPECT_EQ(files(), std::vector<std::string>{"in.tif"});
}

TEST_F(BuildLines, ForceReplacesEarlierLinesAndAFailureKeepsThem) {
  write_file(lines_out, "earlier lines");
  write_file(output, "earlier work");
  const std::string broken = folder.file("broken.tif");
  write_file(broken, read_file(input).substr(0, 30'000));
  EXPECT_EQ(build({broken, "-o", output, "--force", "--drainage-out", lines_out}).status, 1);
  const auto too_large = build({input, "-o", output, "--force", "--drainage-out", lines_out}, [] {
    const rlimit limit{20'000, 20'000};
    setrlimit(RLIMIT_FSIZE, &limit);
  });
  EXPECT_EQ(too_large.status, 1);
  EXPECT_EQ(count_lines(too_large.err), 1u) << too_large.err;
  EXPECT_EQ(read_file(lines_out), "earlier lines");
  EXPECT_EQ(read_file(output), "earlier work");
  EXPECT_EQ(files(), (std::vector<std::string>{"broken.tif", "in.tif", "lines.gpkg", "out.tind"}));

  EXPECT_EQ(build({input, "-o", output, "--force", "--drainage-out", lines_out}).status, 0);
  EXPECT_THAT(read_file(lines_out), testing::StartsWith("SQLite format 3"));
  EXPECT_NE(read_file(output), "earlier work");
}

TEST_F(BuildLines, FailureLeavesNoLinesBehind) {
  const std::string broken = folder.file("broken.tif");
  write_file(broken, read_file(input).substr(0, 30'000));
  expect_refusal(build({broken, "-o", output, "--drainage-out", lines_out}), "broken.tif");
  expect_refusal(build({input, "-o", output, "--drainage-out", lines_out, "--breaklines", folder.file("nowhere.shp")}),
                 "nowhere.shp");
}

TEST_F(BuildLines, LinesThatCannotBeWrittenFailTheBuild) {
  const std::string closed = folder.file("closed");
  std::filesystem::create_directory(closed);
  std::filesystem::permissions(closed, std::filesystem::perms::owner_read | std::filesystem::perms::owner_exec |
                                           std::filesystem::perms::others_read | std::filesystem::perms::others_exec);
  const bool is_root = geteuid() == 0;
  if (is_root) std::filesystem::permissions(folder.path(), std::filesystem::perms::all);
  constexpr unsigned kNobody = 65534;
  const auto finished = build({input, "-o", output, "--drainage-out", closed + "/lines.gpkg"}, [&] {
    if (is_root && setuid(kNobody) != 0) _exit(126);
  });
  if (finished.status == 126 || finished.status == 127) GTEST_SKIP() << "cannot run the program as another user here";
  expect_refusal(finished, "closed/lines.gpkg");
  EXPECT_TRUE(std::filesystem::is_empty(closed));
}

TEST_F(BuildLines, PyramidAndLinesNeedAFileEach) {
  const std::string one = folder.file("one.gpkg");
  const auto finished = build({input, "-o", one, "--drainage-out", one});
  EXPECT_EQ(finished.status, 1);
  EXPECT_THAT(finished.err, testing::HasSubstr("a file each"));
  EXPECT_FALSE(std::filesystem::exists(one));
}

TEST_F(BuildLines, ToleranceIsATableFromTheBottomUp) {
  expect_build({input}, {"--tolerance", "8,16,40"});
  const Manifest m = manifest();
  double expected = 8;
  for (std::size_t up = 0; up < m.levels.size(); ++up) {
    if (up == 1) expected = 16;
    if (up == 2) expected = 40;
    if (up > 2) expected *= 2;
    const LevelInfo& level = m.levels[m.levels.size() - 1 - up];
    EXPECT_EQ(level.tolerance_m, expected) << up << " levels above the bottom";
    EXPECT_LE(level.max_error_m, expected);
  }
  expect_verified({input});
  std::filesystem::remove(output);
  expect_refusal(build({input, "-o", output, "--tolerance", "8,4"}), "--tolerance");
  expect_refusal(build({input, "-o", output, "--tolerance", "8,8"}), "--tolerance");
  expect_refusal(build({input, "-o", output, "--tolerance", "0"}), "--tolerance");
  EXPECT_EQ(build({input, "-o", output, "--tolerance", "much"}).status, 2);
}

TEST_F(BuildLines, WrongUsageOfDrainageIsStatus2) {
  const std::vector<std::vector<std::string>> wrong = {
      {"--drainage-cells", "0"}, {"--drainage-cells", "few"}, {"--drainage-growth", "0.5"},
      {"--lake-area", "-1"},     {"--sea-level", "low"},      {"--resampling", "nearest"},
  };
  for (const auto& options : wrong) {
    std::vector<std::string> arguments = {input, "-o", output};
    arguments.insert(arguments.end(), options.begin(), options.end());
    EXPECT_EQ(build(arguments).status, 2) << options[0];
  }
  EXPECT_EQ(files(), std::vector<std::string>{"in.tif"});
}

}  // namespace
}  // namespace tind::test
