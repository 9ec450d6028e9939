// SPDX-License-Identifier: GPL-3.0-or-later
// A patched copy has the bytes that the writer gives, or there is none.
#include "storage/store_patch.hpp"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "tests/storage/damaged_store.hpp"

namespace tind::test {
namespace {

namespace fs = std::filesystem;
using Pieces = std::vector<std::pair<PieceKey, Bytes>>;

class StorePatchTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-store-patch-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
    std::vector<PieceKey> keys;
    for (std::uint32_t y = 0; y < TileKey::count_y(3); ++y) {
      for (std::uint32_t x = 0; x < TileKey::count_x(3); ++x) {
        for (const PieceKey& key : pieces_of({3, x, y})) keys.push_back(key);
      }
    }
    std::sort(keys.begin(), keys.end());
    keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
    // In a leaf, nearly or just too large for it, of many pages: some 8 MB.
    for (const PieceKey& key : keys) {
      const auto n = static_cast<std::size_t>(uniform(0, 2) == 0 ? uniform(3, 400) : uniform(1900, 2200));
      pieces_.emplace_back(key, filled(key.kind == PieceKind::kBody ? n * 60 : n));
    }
    manifest_ = filled(2500);
    write("earlier.tind", pieces_, manifest_);
  }
  void TearDown() override { fs::remove_all(folder_); }

  int uniform(int least, int most) { return std::uniform_int_distribution(least, most)(random_); }
  Bytes filled(std::size_t n) {
    Bytes value(n);
    for (auto& byte : value) byte = static_cast<std::uint8_t>(random_() | 1);
    return value;
  }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  void write(const std::string& name, const Pieces& pieces, const Bytes& manifest) const {
    fs::remove(path(name));
    auto writer = TileStoreWriter::create(path(name));
    ASSERT_TRUE(writer);
    for (const auto& [key, value] : pieces) ASSERT_TRUE(writer->append(key, value));
    ASSERT_TRUE(writer->finish(manifest));
  }
  std::string bytes_of(const std::string& name) const {
    std::ifstream in(path(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  bool patch(const std::string& earlier, const StorePatch::Values& values, const Bytes& manifest) const {
    const auto store = TileStore::open(path(earlier));
    EXPECT_TRUE(store);
    return StorePatch(*store, path("patched.tind")).finish(values, manifest);
  }
  void expect_nothing_left() const {
    EXPECT_FALSE(fs::exists(path("patched.tind")));
    EXPECT_FALSE(fs::exists(StorePatch::copy_path(path("patched.tind"))));
  }

  fs::path folder_;
  std::mt19937 random_{7};
  Pieces pieces_;
  Bytes manifest_;
};

TEST_F(StorePatchTest, HasTheWritersBytesOrIsNone) {
  const std::string before = bytes_of("earlier.tind");
  int n_made = 0, n_refused = 0;
  for (int k = 0; k < 60; ++k) {
    Pieces now = pieces_;
    StorePatch::Values values;
    for (int n = uniform(1, 5); n > 0; --n) {
      auto& [key, value] = now[static_cast<std::size_t>(uniform(0, static_cast<int>(now.size()) - 1))];
      const int by = uniform(0, 3) == 0 ? uniform(-40, 40) : 0;
      value = filled(static_cast<std::size_t>(std::max(1, static_cast<int>(value.size()) + by)));
      values[key] = value;
    }
    const Bytes manifest = filled(static_cast<std::size_t>(2500 + uniform(-300, 300)));
    if (patch("earlier.tind", values, manifest)) {
      ++n_made;
      write("written.tind", now, manifest);
      ASSERT_TRUE(bytes_of("patched.tind") == bytes_of("written.tind")) << k;
      fs::remove(path("patched.tind"));
    } else {
      ++n_refused;
    }
    expect_nothing_left();
  }
  EXPECT_GT(n_made, 20);
  EXPECT_GT(n_refused, 5);
  EXPECT_TRUE(bytes_of("earlier.tind") == before);
}

TEST_F(StorePatchTest, IsNoneWhereATransactionWouldEndElsewhere) {
  // All of two pages, before and after: only how many of them make a transaction is another number.
  CommitPlaces places;
  std::size_t n_first = 0;
  for (auto& [key, value] : pieces_) {
    value = filled(5000);
    n_first += places.n_commits() == 0 ? 1 : 0;
    places.add(value.size());
  }
  ASSERT_GT(places.n_commits(), 1u);
  write("alike.tind", pieces_, manifest_);
  Bytes shorter(pieces_[0].second.begin(), pieces_[0].second.begin() + 4100);
  EXPECT_TRUE(patch("alike.tind", {{pieces_[n_first].first, shorter}}, manifest_));
  fs::remove(path("patched.tind"));
  StorePatch::Values values;
  for (std::size_t k = 0; k < 6; ++k) values[pieces_[k].first] = shorter;
  EXPECT_FALSE(patch("alike.tind", values, manifest_));
  expect_nothing_left();
}

TEST_F(StorePatchTest, IsNoneOfAFileThatWasLaidOutOtherwise) {
  DamagedStore(path("earlier.tind")).write(path("other.tind"));  // in one transaction
  Bytes value = pieces_[3].second;
  value[0] ^= 0x55;
  EXPECT_FALSE(patch("other.tind", {{pieces_[3].first, value}}, manifest_));
  expect_nothing_left();
}

TEST_F(StorePatchTest, IsNoneWithAPieceThatTheFileLacks) {
  const Bytes value(20, 1);
  EXPECT_FALSE(patch("earlier.tind", {{PieceKey{PieceKind::kBody, 5, 1, 1}, value}}, manifest_));
  expect_nothing_left();
}

TEST_F(StorePatchTest, IsNoneInAFolderThatIsGone) {
  const auto store = TileStore::open(path("earlier.tind"));
  ASSERT_TRUE(store);
  EXPECT_FALSE(StorePatch(*store, path("none/patched.tind")).finish({}, manifest_));
}

}  // namespace
}  // namespace tind::test
