// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/file_hashes.hpp"

#include <chrono>
#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>

#include "storage/readers/gdal_raster.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;

class FileHashesTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-file-hashes-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ / name, std::ios::binary) << text;
    return (folder_ / name).string();
  }

  fs::path folder_;
};

// FIPS 180-4's examples.
constexpr char kOfNothing[] = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";
constexpr char kOfAbc[] = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
constexpr char kOfAMillionA[] = "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0";

TEST_F(FileHashesTest, AreThoseOfTheFilesWhateverTheThreads) {
  const std::string abc = write("abc", "abc"), nothing = write("nothing", ""),
                    long_one = write("long", std::string(1000000, 'a'));
  for (const int threads : {1, 2, 16}) {
    FileHashes hashes(threads);
    for (int k = 0; k < 20; ++k) {
      ASSERT_EQ(hashes.add(abc), static_cast<std::size_t>(4 * k));
      hashes.add(nothing);
      hashes.add((folder_ / "missing").string());
      hashes.add(long_one);
      if (k == 10) EXPECT_EQ(hashes.wait_for(1).value(), kOfNothing);  // and more of them afterwards
    }
    for (std::size_t k = 80; k-- > 0;) {
      const auto hash = hashes.wait_for(k);
      if (k % 4 == 2) {
        ASSERT_FALSE(hash);
        EXPECT_EQ(hash.error().kind, ErrorKind::kIo);
        EXPECT_NE(hash.error().message.find("missing"), std::string::npos);
      } else {
        EXPECT_EQ(hash.value(), k % 4 == 0 ? kOfAbc : k % 4 == 1 ? kOfNothing : kOfAMillionA) << k;
      }
    }
    EXPECT_EQ(hashes.wait_for(0).value(), kOfAbc) << "asked again";
  }
}

TEST_F(FileHashesTest, AreGivenUpWithoutWaiting) {
  const std::string sparse = write("sparse", "");
  fs::resize_file(sparse, std::uintmax_t{1} << 36);  // minutes of hashing
  const auto start = std::chrono::steady_clock::now();
  {
    FileHashes hashes(2);
    for (int k = 0; k < 5; ++k) hashes.add(sparse);
  }
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(10));
}

TEST_F(FileHashesTest, EverySourceOfAMosaicHasItsOwn) {
  const auto grid = [&](const std::string& name, int west) {
    return write(name, "ncols 2\nnrows 2\nxllcenter " + std::to_string(west) +
                           "\nyllcenter 45\ncellsize 1\nNODATA_value -9999\n1 2\n3 4\n");
  };
  std::vector<std::string> paths;
  for (int k = 0; k < 9; ++k) paths.push_back(grid("a" + std::to_string(k) + ".asc", 2 * k));
  const auto mosaic = RasterMosaic::open({paths.rbegin(), paths.rend()}, {});
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  ASSERT_EQ(mosaic->sources.size(), 9u);
  FileHashes hashes(1);
  for (std::size_t k = 0; k < 9; ++k) {
    EXPECT_EQ(mosaic->sources[k].path, paths[k]);
    EXPECT_EQ(mosaic->sources[k].sha256, hashes.wait_for(hashes.add(paths[k])).value());
  }
  RasterOptions options;
  options.hash_files = false;
  EXPECT_EQ(RasterMosaic::open(paths, options)->sources[3].sha256, paths[3]);
}

}  // namespace
}  // namespace tind
