// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/file_scan.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "test_site.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;

TEST(FileScan, FindsFilesAndFoldersByNameOnly) {
  const test::TemporaryDirectory directory;
  const std::string root = directory.path;
  fs::create_directories(root + "/f/sub.tind");
  for (const char* name : {"b.tind", "f/a.tind", "f/b.tind", "f/c.tind.partial", "f/health.tind", "f/notes.txt"}) {
    std::ofstream(root + "/" + name) << "not even opened";
  }
  fs::create_symlink(root + "/nowhere.tind", root + "/f/dangling.tind");
  DatasetSpec folder(root + "/f");
  folder.base = "b";
  DatasetSpec named(root + "/b.tind");
  named.name = "other";
  const FileScan scan = scan_files({{root + "/b.tind"}, named, folder, {root + "/none.tind"}});
  ASSERT_EQ(scan.sources.size(), 3u);
  EXPECT_EQ(scan.sources[0].name, "a");
  EXPECT_EQ(scan.sources[0].base, "b");
  EXPECT_TRUE(scan.sources[0].from_folder);
  EXPECT_EQ(scan.sources[1].name, "b");
  EXPECT_EQ(scan.sources[1].path, root + "/b.tind") << "the first given wins";
  EXPECT_EQ(scan.sources[2].name, "other");
  ASSERT_EQ(scan.problems.size(), 3u);
  EXPECT_THAT(scan.problems[0].message, testing::HasSubstr("twice"));
  EXPECT_THAT(scan.problems[1].message, testing::HasSubstr("'health'"));
  EXPECT_THAT(scan.problems[2].message, testing::HasSubstr("none.tind: no such file"));
  folder.name = "x";
  EXPECT_THAT(scan_files({folder}).problems.at(0).message, testing::HasSubstr("a folder cannot have a name"));
}

TEST(FileScan, WatchesEveryDirectoryOnTheWay) {
  const test::TemporaryDirectory directory;
  const std::string root = fs::canonical(directory.path).string();
  fs::create_directories(root + "/releases/v1");
  fs::create_directories(root + "/etc");
  std::ofstream(root + "/releases/v1/a.tind") << "x";
  fs::create_directory_symlink("releases/v1", root + "/current");
  fs::create_symlink("../current/a.tind", root + "/etc/a.tind");
  EXPECT_THAT(watched_directories({{root + "/etc/a.tind"}}),
              testing::UnorderedElementsAre(root + "/etc", root, root + "/releases/v1"));
  fs::create_symlink("loop.tind", root + "/loop.tind");
  EXPECT_THAT(watched_directories({{root + "/loop.tind"}}), testing::ElementsAre(root)) << "and it ends";
}

}  // namespace
}  // namespace tind
