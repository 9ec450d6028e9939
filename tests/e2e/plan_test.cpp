// SPDX-License-Identifier: GPL-3.0-or-later
// tind-build plan as a user meets it: what it foretells beside what a build then does, and what it says of odd data.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>

#include "tests/client_checks/test_raster.hpp"
#include "tests/e2e/build_program.hpp"

namespace tind::test {
namespace {

using nlohmann::json;
using testing::Contains;
using testing::HasSubstr;
using testing::Not;

class PlanProgram : public BuildProgram {
 protected:
  static Finished plan(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "plan");
    return run_program("tind-build", arguments);
  }
  static json plan_json(std::vector<std::string> arguments, int status = 0) {
    arguments.emplace_back("--json");
    const Finished finished = plan(arguments);
    EXPECT_EQ(finished.status, status) << finished.err;
    json j = json::parse(finished.out, nullptr, false);
    EXPECT_TRUE(j.is_object()) << finished.out << finished.err;
    return j;
  }
  static std::set<std::string> kinds(const json& j) {
    std::set<std::string> found;
    for (const json& problem : j.at("problems")) {
      found.insert(problem.at("kind"));
      if (problem.at("weight") != "note") {
        EXPECT_NE(problem.at("advice"), "") << problem;
      }
    }
    return found;
  }
  static std::string weight_of(const json& j, const std::string& kind) {
    for (const json& problem : j.at("problems")) {
      if (problem.at("kind") == kind) return problem.at("weight");
    }
    return "none";
  }
  std::string raster(const std::string& name, const RasterPlan& plan = {}) {
    write_raster(folder.file(name), plan);
    return folder.file(name);
  }
  /// Hills with detail at every scale, so that levels differ as those of terrain do.
  static RasterPlan hills(int n) {
    RasterPlan plan;
    plan.n = n;
    plan.height_m = [](int r, int c) {
      double height = 1500;
      for (int octave = 0; octave < 8; ++octave) {
        const double f = 0.004 * (1 << octave), a = 700.0 / (1 << octave);
        height += a * std::sin(f * (r + 31 * octave)) * std::cos(f * 1.3 * (c - 17 * octave));
      }
      return static_cast<int>(height);
    };
    return plan;
  }
  /// The plan's figures lie within these factors of what a build with the same arguments makes.
  void expect_like_build(const std::vector<std::string>& arguments, double vertices, double bytes) {
    const json planned = plan_json(arguments);
    auto build_arguments = arguments;
    build_arguments.insert(build_arguments.end(), {"-o", output, "--json", "--force"});
    const Finished built = build(build_arguments);
    ASSERT_EQ(built.status, 0) << built.err;
    const json real = json::parse(built.out);
    double real_vertices = 0;
    ASSERT_EQ(planned["levels"].size(), real["levels"].size());
    for (std::size_t l = 0; l < real["levels"].size(); ++l) {
      EXPECT_EQ(planned["levels"][l]["tolerance_m"], real["levels"][l]["tolerance_m"]);
      EXPECT_NEAR(planned["levels"][l]["tiles"].get<double>(), real["levels"][l]["tiles"].get<double>(),
                  0.1 * real["levels"][l]["tiles"].get<double>() + 2)
          << "level " << l;
      real_vertices += real["levels"][l]["vertices"].get<double>();
    }
    const double planned_vertices = planned["vertices"], planned_bytes = planned["output_bytes"];
    EXPECT_LT(std::max(planned_vertices / real_vertices, real_vertices / planned_vertices), vertices)
        << planned_vertices << " against " << real_vertices;
    // A small file is mostly its pages.
    const double real_bytes = real["file_bytes"];
    EXPECT_LT(std::max(planned_bytes / real_bytes, real_bytes / planned_bytes), bytes)
        << planned_bytes << " against " << real_bytes;
  }
};

TEST_F(PlanProgram, SaysWhatABuildThenMakes) {
  expect_like_build({raster("in.tif", hills(700)), "--tolerance", "40"}, 1.25, 1.5);
}

TEST_F(PlanProgram, SaysWhatABuildMakesOfARasterThatIsReadInWindows) {
  const std::string input = raster("in.tif", hills(2200));
  const json j = plan_json({input, "--no-drainage"});
  EXPECT_EQ(j["sample"]["whole_source_read"], false) << "too small to be sampled";
  EXPECT_LT(j["sample"]["regions"], j["sample"]["of_regions"]);
  expect_like_build({input, "--no-drainage"}, 1.3, 2);
}

TEST_F(PlanProgram, WritesNothing) {
  const std::string input = raster("in.tif");
  EXPECT_EQ(plan({input, "-o", output}).status, 0);
  EXPECT_THAT(files(), testing::ElementsAre("in.tif"));
}

TEST_F(PlanProgram, TextHasLevelsTimeMemoryAndDisk) {
  const Finished finished = plan({raster("in.tif"), "--threads", "2"});
  EXPECT_EQ(finished.status, 0) << finished.err;
  for (const char* words : {"in.tif: 200 x 200 posts", "level", "E_L m", "time    about", "with 1 thread", "with 2",
                            "memory  about", "disk    about", "regions built to try"}) {
    EXPECT_THAT(finished.out, HasSubstr(words));
  }
  EXPECT_EQ(finished.err, "");
}

TEST_F(PlanProgram, LevelsFollowTheOptions) {
  const std::string input = raster("in.tif");
  const json all = plan_json({input}), cut = plan_json({input, "--max-level", "4"}),
             fine = plan_json({input, "--tolerance", "50"});
  ASSERT_EQ(cut["levels"].size(), 5u);
  EXPECT_EQ(cut["levels"][4]["tolerance_m"], all["levels"][4]["tolerance_m"]);
  EXPECT_LT(cut["vertices"], all["vertices"]);
  EXPECT_EQ(fine["levels"].back()["tolerance_m"], 50);
  EXPECT_GT(fine["vertices"], all["vertices"]);
}

TEST_F(PlanProgram, RefusesWhatABuildRefuses) {
  EXPECT_EQ(plan({}).status, 2);
  EXPECT_EQ(plan({raster("in.tif"), "--mode", "odd"}).status, 2);
  EXPECT_EQ(plan({raster("in.tif"), "--memory", "some"}).status, 2);
  EXPECT_EQ(plan({raster("in.tif"), "--shard", "4/4"}).status, 2);
  EXPECT_EQ(plan({"--help"}).status, 0);
  const Finished missing = plan({folder.file("nowhere.tif")});
  EXPECT_EQ(missing.status, 1);
  EXPECT_EQ(missing.out, "");
  EXPECT_THAT(missing.err, testing::StartsWith("tind-build plan: "));
  EXPECT_THAT(missing.err, HasSubstr("nowhere.tif: no such file"));
  write_file(folder.file("points.xyz"), "10 45 3\n10.1 45 3\n10 45.1 3\n");
  const Finished mixed = plan({raster("in.tif"), folder.file("points.xyz")});
  EXPECT_EQ(mixed.status, 1);
  EXPECT_THAT(mixed.err, HasSubstr("holds points"));
}

TEST_F(PlanProgram, SaysWhatStandsInTheWayOfTheOutput) {
  const std::string input = raster("in.tif");
  write_file(output, "earlier");
  EXPECT_EQ(weight_of(plan_json({input, "-o", output}, 1), "output_exists"), "error");
  EXPECT_EQ(weight_of(plan_json({input, "-o", output, "--force"}), "output_exists"), "none");
  EXPECT_EQ(read_file(output), "earlier");
  EXPECT_EQ(weight_of(plan_json({input, "-o", folder.file("no/such/a.tind")}, 1), "output"), "error");
}

TEST_F(PlanProgram, TellsVoidsAndTheirShare) {
  RasterPlan plan = hills(100);
  plan.nodata = -32768;
  plan.height_m = [](int r, int c) { return c < 25 ? -32768 : 500 + r; };
  const json j = plan_json({raster("in.tif", plan)});
  EXPECT_EQ(weight_of(j, "voids"), "warning");
  EXPECT_THAT(j["problems"].dump(), HasSubstr("25.0 % of the posts are voids (2500 of 10000)"));
  EXPECT_EQ(weight_of(plan_json({raster("full.tif", hills(100))}), "voids"), "none");
}

TEST_F(PlanProgram, SuspectsFeetAndUndeclaredVoids) {
  RasterPlan plan;
  plan.n = 100;
  plan.height_m = [](int r, int c) { return 5000 + 60 * r + c; };
  const std::string feet = raster("feet.tif", plan);
  EXPECT_EQ(weight_of(plan_json({feet}), "odd_vertical_unit"), "warning");
  EXPECT_EQ(weight_of(plan_json({feet, "--metres-per-unit", "0.3048"}), "odd_vertical_unit"), "none");
  plan.height_m = [](int r, int c) { return r == 7 && c < 9 ? 32767 : 300 + c; };
  const std::string marked = raster("marked.tif", plan);
  EXPECT_THAT(kinds(plan_json({marked})), Contains("implausible_heights"));
  EXPECT_THAT(kinds(plan_json({marked, "--nodata", "32767"})), Not(Contains("implausible_heights")));
}

TEST_F(PlanProgram, TellsInputsThatDisagree) {
  RasterPlan plan = hills(100);
  const std::string first = raster("a.tif", plan);
  plan.west_deg += 0.5;  // fifty posts further east the terrain is another
  const json j = plan_json({first, raster("b.tif", plan)});
  EXPECT_EQ(weight_of(j, "overlaps_disagree"), "warning");
  EXPECT_EQ(weight_of(plan_json({first}), "overlaps_disagree"), "none");
}

TEST_F(PlanProgram, TellsStretchedPostsAndAMissingCrs) {
  write_file(folder.file("grid.asc"),
             "ncols 4\nnrows 4\nxllcorner 10\nyllcorner 80\ncellsize 0.01\n"
             "1 2 3 4\n2 3 4 5\n3 4 5 6\n4 5 6 7\n");
  const auto found = kinds(plan_json({folder.file("grid.asc")}));
  EXPECT_THAT(found, Contains("missing_crs"));
  EXPECT_THAT(found, Contains("anisotropic_posts"));
  EXPECT_THAT(found, Contains("unknown_vertical_datum"));
}

TEST_F(PlanProgram, ManualAndHelpListTheSameOptions) {
  const auto options_in = [](const std::string& text) {
    std::set<std::string> names;
    const std::regex option(R"(--[a-z][a-z-]+)");
    for (auto it = std::sregex_iterator(text.begin(), text.end(), option); it != std::sregex_iterator(); ++it) {
      names.insert(it->str());
    }
    return names;
  };
  const auto build_help = options_in(run_program("tind-build", {"--help"}).out);
  const auto manual = options_in(read_file(TIND_DOCS_DIR "/man/tind-build.1.md"));
  for (const std::string& option : build_help) EXPECT_THAT(manual, Contains(option)) << "in tind-build.1.md";
  const auto plan_help = options_in(plan({"--help"}).out);
  for (const std::string& option : plan_help) EXPECT_THAT(build_help, Contains(option)) << "in tind-build --help";
  const auto plan_manual = options_in(read_file(TIND_DOCS_DIR "/man/tind-build-plan.1.md"));
  ASSERT_FALSE(plan_manual.empty());
  for (const std::string& option : plan_manual) EXPECT_THAT(plan_help, Contains(option)) << "in plan --help";
}

/// Real data beside the checkout, each odd in its own way; absent on most machines.
class PlanRealData : public PlanProgram {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(TIND_SHARED_DATA)) GTEST_SKIP() << TIND_SHARED_DATA << " is not on this machine";
  }
  static std::string shared(const std::string& name) { return std::string(TIND_SHARED_DATA) + "/" + name; }
};

TEST_F(PlanRealData, VoidsOfTheCoast) {
  const json j = plan_json({shared("raster/coast-voids/N48W125.hgt.zip"), "--no-drainage"});
  EXPECT_EQ(weight_of(j, "voids"), "warning");
}

TEST_F(PlanRealData, VoidsOfTheMountain) {
  const json j = plan_json({shared("raster/mountain-voids/mt_rainier_90m.tif"), "--no-drainage"});
  EXPECT_THAT(j["problems"].dump(), HasSubstr("(9033 of 1442401)"));
  EXPECT_EQ(weight_of(j, "voids"), "note");
}

TEST_F(PlanRealData, StrayZerosOnTheRim) {
  const json j = plan_json({shared("raster/southfork-10m/elder_creek_10m.tif"), "--no-drainage"});
  EXPECT_EQ(weight_of(j, "zeros_beside_voids"), "warning");
  EXPECT_EQ(weight_of(j, "voids"), "warning");
  EXPECT_THAT(kinds(plan_json({shared("raster/southfork-10m/elder_creek_10m.tif"), "--no-drainage", "--nodata", "0"})),
              Not(Contains("zeros_beside_voids")));
}

TEST_F(PlanRealData, SharedRowsThatDifferByAMetre) {
  std::vector<std::string> arguments = {"--no-drainage"};
  for (const char* name : {"N36W118", "N36W119", "N37W118", "N37W119"})
    arguments.push_back(shared(std::string("raster/sierra-2x2/") + name + ".hgt"));
  EXPECT_EQ(weight_of(plan_json(arguments), "overlaps_disagree"), "note");
}

TEST_F(PlanRealData, WholeEarth) {
  const json j = plan_json({shared("raster/global/etopo5_int16.tif"), "--no-drainage"});
  EXPECT_EQ(j["levels"][0]["tiles"], 2);
  EXPECT_EQ(j["sample"]["whole_source_read"], false);
  EXPECT_EQ(weight_of(j, "voids"), "none");
}

TEST_F(PlanRealData, FeetOfTrinidad) {
  const std::string feet = "/usr/share/ncarg/data/cdf/trinidad.nc";
  if (!std::filesystem::exists(feet)) GTEST_SKIP() << feet << " is not on this machine";
  EXPECT_EQ(weight_of(plan_json({feet, "--no-drainage"}), "odd_vertical_unit"), "warning");
  EXPECT_EQ(weight_of(plan_json({feet, "--no-drainage", "--metres-per-unit", "0.3048"}), "odd_vertical_unit"), "none");
}

TEST_F(PlanRealData, LidarInFeet) {
  const json j = plan_json({shared("lidar/autzen_trim.las"), "--no-drainage"});
  EXPECT_EQ(j["source_kind"], "points");
  EXPECT_LT(j["highest_m"], 300) << "feet taken as metres";
  EXPECT_GT(j["vertices"], 0);
}

}  // namespace
}  // namespace tind::test
