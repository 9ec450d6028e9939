// SPDX-License-Identifier: GPL-3.0-or-later
// tind-build as a user meets it: exit status, one clear line, earlier outputs untouched.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <unistd.h>

#include <csignal>

#include "tests/client_checks/test_raster.hpp"
#include "tests/e2e/build_program.hpp"

namespace tind::test {
namespace {

using testing::HasSubstr;

/// Of plain rasters and of outputs.
class BuildBasics : public BuildProgram {
 protected:
  std::string raster(const RasterPlan& plan = {}) {
    const std::string path = folder.file("in.tif");
    write_raster(path, plan);
    return path;
  }
};

TEST_F(BuildBasics, BuildsAndSaysSo) {
  const auto finished = run_program("tind-build", {raster(), "-o", output});
  EXPECT_EQ(finished.status, 0) << finished.err;
  EXPECT_TRUE(std::filesystem::exists(output));
  EXPECT_THAT(finished.out, HasSubstr("level"));
}

TEST_F(BuildBasics, WrongUsageIsStatus2) {
  EXPECT_EQ(run_program("tind-build", {}).status, 2);
  EXPECT_EQ(run_program("tind-build", {raster()}).status, 2) << "no output named";
  EXPECT_EQ(run_program("tind-build", {raster(), "-o", output, "--mode", "odd"}).status, 2);
  EXPECT_EQ(run_program("tind-build", {raster(), "-o", output, "--no-such-option"}).status, 2);
  EXPECT_EQ(run_program("tind-build", {"--help"}).status, 0);
}

TEST_F(BuildBasics, MissingInput) { expect_refusal(build({folder.file("nowhere.tif"), "-o", output}), "nowhere.tif"); }

TEST_F(BuildBasics, InputThatIsNoRaster) {
  write_file(folder.file("text.tif"), "this is no raster\n");
  expect_refusal(build({folder.file("text.tif"), "-o", output}), "text.tif");
}

TEST_F(BuildBasics, TruncatedInput) {
  const std::string path = raster();
  std::filesystem::resize_file(path, std::filesystem::file_size(path) / 2);
  expect_refusal(build({path, "-o", output}), "in.tif");
}

TEST_F(BuildBasics, EmptyInput) {
  write_file(folder.file("empty.tif"), "");
  expect_refusal(build({folder.file("empty.tif"), "-o", output}), "empty.tif");
}

TEST_F(BuildBasics, RotatedRasterIsWarpedAndHolds) {
  RasterPlan plan;
  plan.rotation = 0.002;
  const std::string input = raster(plan);
  expect_build({input}, {"--finest", "200"});
  EXPECT_EQ(manifest().source_kind, "warped");
  expect_verified({input});
}

TEST_F(BuildBasics, InputOfVoidsOnly) {
  RasterPlan plan;
  plan.nodata = -7;
  plan.height_m = [](int, int) { return -7; };
  expect_refusal(build({raster(plan), "-o", output}), "void");
}

TEST_F(BuildBasics, FolderThatDoesNotExist) {
  const auto finished = build({raster(), "-o", folder.file("no/such/folder/out.tind")});
  EXPECT_EQ(finished.status, 1);
  EXPECT_EQ(count_lines(finished.err), 1u) << finished.err;
}

TEST_F(BuildBasics, FolderThatCannotBeWritten) {
  const std::string closed = folder.file("closed");
  std::filesystem::create_directory(closed);
  std::filesystem::permissions(closed, std::filesystem::perms::owner_read | std::filesystem::perms::owner_exec);
  const std::string input = raster();
  // Root may write everywhere, so the program becomes nobody first.
  const bool is_root = geteuid() == 0;
  if (is_root)
    std::filesystem::permissions(folder.path(), std::filesystem::perms::others_all, std::filesystem::perm_options::add);
  constexpr unsigned kNobody = 65534;
  const auto finished = build({input, "-o", closed + "/out.tind"}, [&] {
    if (is_root && setuid(kNobody) != 0) _exit(126);
  });
  if (finished.status == 126 || finished.status == 127) GTEST_SKIP() << "cannot run the program as another user here";
  EXPECT_EQ(finished.status, 1);
  EXPECT_EQ(count_lines(finished.err), 1u) << finished.err;
  EXPECT_THAT(finished.err, HasSubstr("closed"));
}

TEST_F(BuildBasics, OutputThatExistsIsUntouchedWithoutForce) {
  write_file(output, "earlier work");
  const auto finished = build({raster(), "-o", output});
  EXPECT_EQ(finished.status, 1);
  EXPECT_EQ(count_lines(finished.err), 1u) << finished.err;
  EXPECT_THAT(finished.err, HasSubstr("--force"));
  EXPECT_EQ(read_file(output), "earlier work");
  EXPECT_EQ(build({raster(), "-o", output, "--force"}).status, 0);
  EXPECT_NE(read_file(output), "earlier work");
}

TEST_F(BuildBasics, FailureWithForceKeepsTheEarlierOutput) {
  write_file(output, "earlier work");
  const std::string path = raster();
  std::filesystem::resize_file(path, std::filesystem::file_size(path) / 2);
  EXPECT_EQ(build({path, "-o", output, "--force"}).status, 1);
  EXPECT_EQ(read_file(output), "earlier work");
}

TEST_F(BuildBasics, FileSizeLimitIsAFailureThatKeepsTheEarlierOutput) {
  write_file(output, "earlier work");
  const auto finished = build({raster(), "-o", output, "--force"}, [] {
    const rlimit limit{20'000, 20'000};
    setrlimit(RLIMIT_FSIZE, &limit);
  });
  EXPECT_EQ(finished.status, 1) << finished.err;
  EXPECT_EQ(count_lines(finished.err), 1u) << finished.err;
  EXPECT_EQ(read_file(output), "earlier work");
}

TEST_F(BuildBasics, FullDiskIsAFailure) {
  const std::string disk = folder.file("disk");
  std::filesystem::create_directory(disk);
  if (mount("tind-e2e", disk.c_str(), "tmpfs", 0, "size=192k") != 0) {
    GTEST_SKIP() << "cannot mount a small tmpfs here (needs root): the full disk was not tried";
  }
  const std::string input = raster();
  const auto finished = build({input, "-o", disk + "/out.tind"});
  const bool left_behind = !std::filesystem::is_empty(disk);
  EXPECT_EQ(umount(disk.c_str()), 0);
  EXPECT_EQ(finished.status, 1);
  EXPECT_EQ(count_lines(finished.err), 1u) << finished.err;
  EXPECT_THAT(finished.err, testing::AnyOf(HasSubstr("space"), HasSubstr("full")));
  EXPECT_FALSE(left_behind);
}

TEST_F(BuildBasics, ThreadsDoNotChangeTheBytes) {
  const std::string input = raster();
  ASSERT_EQ(build({input, "-o", folder.file("one.tind"), "--threads", "1", "--finest", "100"}).status, 0);
  ASSERT_EQ(build({input, "-o", folder.file("two.tind"), "--threads", "2", "--finest", "100"}).status, 0);
  const std::string one = read_file(folder.file("one.tind"));
  EXPECT_GT(one.size(), 10'000u);
  EXPECT_TRUE(one == read_file(folder.file("two.tind")));
}

}  // namespace
}  // namespace tind::test
