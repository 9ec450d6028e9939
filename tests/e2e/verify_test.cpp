// SPDX-License-Identifier: GPL-3.0-or-later
// The three programs together: build, serve, verify.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/e2e/program.hpp"
#include "tests/client_checks/test_raster.hpp"

namespace tind::test {
namespace {

using testing::HasSubstr;

/// One small pyramid and one of another raster, served.
class VerifyProgram : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder = new ScratchFolder;
    RasterPlan plan;
    write_raster(folder->file("dem.tif"), plan);
    plan.height_m = [](int r, int c) { return 1200 - r * 3 + (c % 17) * 20; };
    write_raster(folder->file("other.tif"), plan);
    for (const char* name : {"dem", "other"}) {
      const auto built =
          run_program("tind-build", {folder->file(name + std::string(".tif")), "-o",
                                     folder->file(name + std::string(".tind")), "--finest", "200", "-q"});
      ASSERT_EQ(built.status, 0) << built.err;
    }
    daemon = new Daemon({folder->file("dem.tind"), folder->file("other.tind")});
    ASSERT_NE(daemon->url(), "");
  }
  static void TearDownTestSuite() {
    EXPECT_EQ(daemon->stop(), 0) << "SIGTERM drains and ends well";
    delete daemon;
    delete folder;
  }
  static ScratchFolder* folder;
  static Daemon* daemon;
};

ScratchFolder* VerifyProgram::folder = nullptr;
Daemon* VerifyProgram::daemon = nullptr;

TEST_F(VerifyProgram, EverythingHoldsAndTheJsonSaysSo) {
  const auto finished = run_program("tind-verify", {daemon->url() + "/dem", "--source", folder->file("dem.tif"),
                                                    "--cuts", "40", "--json", folder->file("found.json"), "--quiet"});
  EXPECT_EQ(finished.status, 0) << finished.out << finished.err;
  EXPECT_THAT(finished.out, HasSubstr("checks held"));
  EXPECT_EQ(finished.err, "");
  const auto found = nlohmann::json::parse(read_file(folder->file("found.json")));
  EXPECT_TRUE(found["ok"].get<bool>());
  EXPECT_EQ(found["cuts"]["cuts"], 40);
  EXPECT_GT(found["cuts"]["joints"], 0);
  for (const auto& check : found["checks"]) {
    EXPECT_TRUE(check["held"].get<bool>()) << check;
    // What is about other kinds of sources.
    if (check["id"] == "warped-spacing" || check["id"] == "kept-points") continue;
    EXPECT_EQ(check["skipped"], "") << check;
  }
  for (const auto& level : found["levels"]) EXPECT_EQ(level["posts"], 40'000) << level;
}

TEST_F(VerifyProgram, FinalSlashIsFine) {
  EXPECT_EQ(run_program("tind-verify", {daemon->url() + "/dem/", "--cuts", "2", "--quiet"}).status, 0);
}

TEST_F(VerifyProgram, AnotherSourceIsStatus1) {
  const auto finished = run_program(
      "tind-verify", {daemon->url() + "/dem", "--source", folder->file("other.tif"), "--cuts", "2", "--quiet"});
  EXPECT_EQ(finished.status, 1);
  EXPECT_THAT(finished.out, HasSubstr("FAIL source-error"));
}

TEST_F(VerifyProgram, NoDatasetNameNeedsExactlyOneDataset) {
  const auto finished = run_program("tind-verify", {daemon->url(), "--quiet"});
  EXPECT_EQ(finished.status, 1);
  EXPECT_THAT(finished.err, HasSubstr("dem"));
  EXPECT_THAT(finished.err, HasSubstr("other"));
  const Daemon alone({folder->file("dem.tind")});
  EXPECT_EQ(run_program("tind-verify", {alone.url(), "--cuts", "2", "--quiet"}).status, 0);
}

TEST_F(VerifyProgram, ClearLinesForWhatCannotBeAsked) {
  const auto refused = run_program("tind-verify", {"http://127.0.0.1:1/dem", "--quiet"});
  EXPECT_EQ(refused.status, 1);
  EXPECT_EQ(count_lines(refused.err), 1u) << refused.err;
  EXPECT_THAT(refused.err, HasSubstr("connect"));
  const auto unknown = run_program("tind-verify", {daemon->url() + "/nothing", "--quiet"});
  EXPECT_EQ(unknown.status, 1);
  EXPECT_THAT(unknown.err, HasSubstr("404"));
}

TEST_F(VerifyProgram, WrongUsageIsStatus2) {
  EXPECT_EQ(run_program("tind-verify", {}).status, 2);
  EXPECT_EQ(run_program("tind-verify", {"dem"}).status, 2);
  EXPECT_EQ(run_program("tind-verify", {daemon->url() + "/dem", "--sample", "0"}).status, 2);
  EXPECT_EQ(
      run_program("tind-verify", {daemon->url() + "/dem", "--source", folder->file("nowhere.tif"), "--quiet"}).status,
      2);
  EXPECT_EQ(run_program("tind-verify", {"--help"}).status, 0);
}

TEST(Demo, BundledDemHoldsOverAllLevels) {
  const ScratchFolder folder;
  const std::string dem = std::string(TIND_TEST_DATA) + "/sangre_de_cristo.tif";
  ASSERT_EQ(run_program("tind-build", {dem, "-o", folder.file("demo.tind"), "-q"}).status, 0);
  Daemon daemon({folder.file("demo.tind")});
  const auto finished =
      run_program("tind-verify", {daemon.url() + "/demo", "--source", dem, "--cuts", "200", "--quiet"});
  EXPECT_EQ(finished.status, 0) << finished.out << finished.err;
}

/// Real data beside the checkout; absent on most machines.
void expect_to_hold(const std::vector<std::string>& names, const std::string& cuts) {
  std::vector<std::string> sources;
  for (const auto& name : names) sources.push_back(std::string(TIND_SHARED_DATA) + "/raster/" + name);
  if (!std::filesystem::exists(sources[0]))
    GTEST_SKIP() << sources[0] << " is not on this machine: real data were not tried";
  const ScratchFolder folder;
  auto arguments = sources;
  arguments.insert(arguments.end(), {"-o", folder.file("real.tind"), "-q"});
  const auto built = run_program("tind-build", arguments);
  ASSERT_EQ(built.status, 0) << built.err;
  Daemon daemon({folder.file("real.tind")});
  arguments = {daemon.url() + "/real", "--cuts", cuts, "--quiet", "--source"};
  arguments.insert(arguments.end(), sources.begin(), sources.end());
  const auto finished = run_program("tind-verify", arguments);
  EXPECT_EQ(finished.status, 0) << finished.out << finished.err;
}

TEST(RealData, FourHgtTilesThatShareRowsHold) {
  expect_to_hold(
      {"sierra-2x2/N36W118.hgt", "sierra-2x2/N36W119.hgt", "sierra-2x2/N37W118.hgt", "sierra-2x2/N37W119.hgt"}, "200");
}

TEST(RealData, CoastWithVoidsInAZipHolds) { expect_to_hold({"coast-voids/N43E007.hgt.zip"}, "200"); }

}  // namespace
}  // namespace tind::test
