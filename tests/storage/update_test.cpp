// SPDX-License-Identifier: GPL-3.0-or-later
// An update's bytes are those of a whole rebuild, whatever has changed: random changes, one after the other.
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <optional>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "storage/builder/build.hpp"
#include "storage/builder/earlier_pyramid.hpp"
#include "storage/builder/merge.hpp"
#include "storage/inputs_blob.hpp"
#include "tests/storage/damaged_store.hpp"
#include "tests/storage/test_raster.hpp"
#include "tests/support/test_field.hpp"

namespace tind::test {
namespace {

namespace fs = std::filesystem;

constexpr int kRows = 260, kCols = 300;
constexpr float kVoid = -9999;
// Posts along a bottom tile: level 13.
constexpr double kSpacing = 0.0008, kTilePosts = 180.0 / 8192 / kSpacing;

class UpdateTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-update-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
    const HeightAt rough = rough_terrain(3, 1500);
    posts_.reserve(std::size_t{kRows} * kCols);
    for (int r = 0; r < kRows; ++r) {
      // A plain in the west, where triangles are large.
      for (int c = 0; c < kCols; ++c) posts_.push_back(static_cast<float>(rough(r, c) * (c < 100 ? 0.02 : 1)));
    }
  }
  void TearDown() override { fs::remove_all(folder_); }

  float& post(int r, int c) { return posts_[static_cast<std::size_t>(r * kCols + c)]; }
  int row() { return std::uniform_int_distribution(0, kRows - 1)(random_); }
  int col() { return std::uniform_int_distribution(0, kCols - 1)(random_); }
  float metres(double least, double most) {
    const double m = std::exp(std::uniform_real_distribution(std::log(least), std::log(most))(random_));
    return static_cast<float>(random_() % 2 ? m : -m);
  }
  void raise(int r, int c, int n_rows, int n_cols, float by) {
    for (int i = std::max(r, 0); i < std::min(r + n_rows, kRows); ++i) {
      for (int j = std::max(c, 0); j < std::min(c + n_cols, kCols); ++j) post(i, j) += by;
    }
  }
  // The highest post around.
  std::pair<int, int> peak() {
    const int r0 = row() / 2, c0 = col() / 2;
    std::pair<int, int> best{r0, c0};
    for (int r = r0; r < r0 + 40; ++r) {
      for (int c = c0; c < c0 + 40; ++c) {
        if (post(r, c) > post(best.first, best.second)) best = {r, c};
      }
    }
    return best;
  }

  // A post that a border line of bottom tiles passes at most a post away from, if possible where two of them cross, on
  // the plain: the line changes, and no mesh above the bottom does.
  std::string change_at_line() {
    const auto beside = [&](double first_deg, int n_posts) {
      const double side_deg = kTilePosts * kSpacing, lines = static_cast<double>(n_posts) / kTilePosts - 1;
      const double k = std::floor(std::uniform_real_distribution(0.0, lines)(random_));
      const double at_deg = (std::ceil(first_deg / side_deg) + k) * side_deg;
      return static_cast<int>(std::lround((at_deg - first_deg) / kSpacing)) + static_cast<int>(random_() % 3) - 1;
    };
    const float by = metres(13, 22);
    const int kind = static_cast<int>(random_() % 3);
    const int r = kind == 0 ? row() : beside(north_ - kRows * kSpacing, kRows);
    const int c = kind == 1 ? col() / 3 : beside(west_, 95);
    raise(r, c, 1, 1, by);
    return fmt::format("row {}, column {} by {} m", r, c, by);
  }

  // Says what it did.
  std::string change() {
    const float slight = metres(0.001, 3), some = metres(1, 60), large = metres(200, 20'000);
    switch (random_() % 14) {
      case 0:
        return post(row(), col()) += slight, "a post, slightly";
      case 1:
        return post(row(), col()) += some, "a post";
      case 2:
        return raise(row(), col(), 3, 3, some), "a patch";
      case 3:
        return raise(row(), col(), 1, 60, slight), "a row";
      case 4:
        return post(row(), col()) += large, "a spike";
      case 5: {
        const auto [r, c] = peak();
        return post(r, c) += slight, "a peak, which is a vertex";
      }
      case 6: {
        // Where tiles of many levels meet.
        const double at = std::floor(static_cast<double>(col()) / kTilePosts / 4) * 4 * kTilePosts;
        return raise(row(), static_cast<int>(at) - 1, 2, 3, some), "beside a line";
      }
      case 7:
        return raise(random_() % 2 ? 0 : kRows - 1, col(), 1, 3, some), "at the rim";
      case 8: {
        const auto low = std::ldexp(1.0f, -9);
        return post(row(), col()) += low, "less than a height unit";
      }
      case 9:
        for (int k = 0; k < 4; ++k) raise(row(), col(), 3, 3, slight);
        return "four patches";
      case 10:
        for (int k = 0; k < 6; ++k) post(row(), col()) = kVoid;
        return "voids";
      case 11:
        return raise(row(), col(), 40, 40, some), "a large patch";
      case 12:
        std::swap(posts_, earlier_posts_);
        return "back to what was";
      default:
        return raise(row(), col(), 2, 2, metres(0.01, 0.5)), "a little patch";
    }
  }

  void write() const {
    std::vector<float> values;
    for (int r = kRows - 1; r >= 0; --r) {
      values.insert(values.end(), posts_.begin() + r * kCols, posts_.begin() + r * kCols + n_cols_);
    }
    std::ofstream((folder_ / "posts.tif").string(), std::ios::binary)
        << geotiff_bytes(n_cols_, kRows, west_, north_, kSpacing, 4326, true, values);
  }
  std::string bytes_of(const std::string& name) const {
    std::ifstream in((folder_ / name).string(), std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }

  BuildReport build(const std::string& output, const std::string& earlier, double tolerance_m, bool drainage,
                    int threads, std::uint64_t memory_bytes = BuildOptions().memory_bytes) const {
    BuildOptions o;
    o.memory_bytes = memory_bytes;
    o.source.inputs = {(folder_ / "posts.tif").string()};
    o.source.raster.nodata = kVoid;
    o.output = (folder_ / output).string();
    o.force = true;
    o.threads = threads;
    o.falloff_posts = 12;
    o.levels.finest_m = tolerance_m;
    o.lines.drainage = drainage;
    o.shard = shard_;
    if (!earlier.empty()) o.earlier = (folder_ / earlier).string();
    Progress silent(nullptr);
    auto report = build_pyramid(o, silent);
    EXPECT_TRUE(report) << (report ? "" : report.error().message);
    return report ? std::move(*report) : BuildReport{};
  }

  // Which records of the updated file are not those of the rebuild.
  std::string differences() const {
    DamagedStore after((folder_ / "after.tind").string()), whole((folder_ / "whole.tind").string());
    std::string text = fmt::format("; {} records, {} wanted", after.records().size(), whole.records().size());
    for (const auto& [key, value] : whole.records()) {
      const auto at = after.records().find(key);
      const bool is_same =
          at != after.records().end() && std::equal(at->second.begin(), at->second.end(), value.begin(), value.end());
      const auto piece = parse_piece_key(key);
      if (is_same || !piece) continue;
      text += fmt::format("; kind {} {}/{}/{}", static_cast<int>(piece->kind), piece->level, piece->i, piece->j);
    }
    return text;
  }

  // Changes and updates so many times, each from the file before.
  void run(int n, double tolerance_m, bool drainage, const std::function<std::string()>& change) {
    write();
    build("before.tind", "", tolerance_m, drainage, 2);
    earlier_posts_ = posts_;
    for (int k = 0; k < n; ++k) {
      const std::vector<float> now = posts_;
      const std::string what = change();
      earlier_posts_ = now;
      write();
      build("whole.tind", "", tolerance_m, drainage, 2);
      // Little memory: posts in a scratch file, and then in pages.
      const std::uint64_t memory_bytes = k % 4 == 3 ? std::uint64_t{1} << 20 : BuildOptions().memory_bytes;
      const BuildReport report = build("after.tind", "before.tind", tolerance_m, drainage, 1 + k % 3, memory_bytes);
      ASSERT_TRUE(bytes_of("after.tind") == bytes_of("whole.tind")) << k << ": " << what << differences();
      fs::rename(folder_ / "after.tind", folder_ / "before.tind");
      const std::size_t n_levels = report.breakdown.size();
      for (std::size_t level = 0; level + 2 < n_levels; ++level) {
        n_repeated_ += report.breakdown[level].repeated;
        n_whole_ += report.breakdown[level].built - report.breakdown[level].repeated;
      }
      const LevelBreakdown& bottom = report.breakdown.back();
      if (bottom.copied == 0) continue;
      ++n_patched_;
      n_copies_ += report.is_copy;
      const auto n_built = [](const LevelBreakdown& level) { return level.built - level.repeated; };
      n_moved_ += std::any_of(report.breakdown.begin(), report.breakdown.end() - 2,
                              [&](const LevelBreakdown& level) { return n_built(level) > 0; });
    }
  }

  double west_ = 10.0003, north_ = 45.3001;
  int n_cols_ = kCols;  // that are written, from the west
  fs::path folder_;
  std::mt19937 random_{20261122};
  std::vector<float> posts_, earlier_posts_;  // row 0 is the southernmost
  std::optional<BuildOptions::Shard> shard_;
  std::uint64_t n_repeated_ = 0, n_whole_ = 0;  // tiles of levels with cells
  int n_patched_ = 0;                           // updates that copied what nothing reached
  int n_copies_ = 0;                            // of those, files that are a copy changed in places
  int n_moved_ = 0;                             // of those, updates in which a mesh above the bottom became another one
};

TEST_F(UpdateTest, HasTheBytesOfARebuildAfterAnyChange) {
  const char* more = std::getenv("TIND_UPDATES");
  run(more != nullptr ? std::atoi(more) : 48, 12, false, [this] { return change(); });
  if (more != nullptr) return;
  // Both ways were gone.
  EXPECT_GT(n_repeated_, 100u);
  EXPECT_GT(n_whole_, 100u);
  EXPECT_GT(n_patched_, 20);
  EXPECT_GT(n_moved_, 10);
  EXPECT_GT(n_copies_, 3);
  EXPECT_LT(n_copies_, n_patched_);
  RecordProperty("repeated", fmt::format("{}", n_repeated_));
  RecordProperty("whole", fmt::format("{}", n_whole_));
  RecordProperty("patched", fmt::format("{}, {} moved, {} copies", n_patched_, n_moved_, n_copies_));
}

TEST_F(UpdateTest, SeesWhatChangesAtBorderLines) {
  const char* more = std::getenv("TIND_UPDATES");
  run(more != nullptr ? std::atoi(more) : 24, 12, false, [this] { return change_at_line(); });
  EXPECT_GE(n_patched_, more != nullptr ? 1 : 21);
}

TEST_F(UpdateTest, SeesWhatChangesAcrossLongitude180) {
  west_ = 180 - 40.3 * kSpacing;
  run(12, 12, false, [this] { return change_at_line(); });
  run(12, 12, false, [this] { return change(); });
  EXPECT_GT(n_patched_, 15);
}

TEST_F(UpdateTest, SeesWhatChangesAtAPole) {
  north_ = 90;
  run(8, 12, false, [this] { return change_at_line(); });
  run(12, 12, false, [this] { return change(); });
  EXPECT_GT(n_patched_, 10);
}

TEST_F(UpdateTest, HasTheBytesOfARebuildOfAGridThatGrew) {
  for (const int n_cols : {250, 290, 300, 270}) {
    n_cols_ = n_cols;
    write();
    const BuildReport whole = build("whole.tind", "", 12, false, 2);
    if (n_cols != 250) {
      const BuildReport report = build("after.tind", "before.tind", 12, false, 2);
      ASSERT_TRUE(bytes_of("after.tind") == bytes_of("whole.tind")) << n_cols << differences();
      // Far from where it grew all is as it was.
      EXPECT_LT(report.breakdown.back().built, whole.breakdown.back().built);
    }
    fs::rename(folder_ / "whole.tind", folder_ / "before.tind");
  }
}

TEST_F(UpdateTest, TakesNothingFromADamagedInputsRecord) {
  write();
  build("sound.tind", "", 12, false, 2);
  raise(130, 200, 2, 2, 0.4f);
  write();
  build("whole.tind", "", 12, false, 2);
  const auto count = [](const BuildReport& report) {
    std::uint64_t n_built = 0, n_repeated = 0;
    for (const LevelBreakdown& level : report.breakdown) {
      n_built += level.built;
      n_repeated += level.repeated;
    }
    return std::pair(n_built, n_repeated);
  };
  const auto [n_sound, n_repeated] = count(build("after.tind", "sound.tind", 12, false, 2));
  EXPECT_TRUE(bytes_of("after.tind") == bytes_of("whole.tind"));
  EXPECT_GT(n_repeated, 5u);
  for (const int way : {0, 1, 2}) {
    DamagedStore store((folder_ / "sound.tind").string());
    std::size_t n_records = 0;
    for (auto& [key, value] : store.records()) {
      if (!decode_inputs(value)) continue;
      // Somewhere in a digest, a count or a cell; a byte less; nothing at all.
      if (way == 0) value[value.size() * (n_records % 10) / 10] ^= 0x40;
      if (way == 1) value.pop_back();
      if (way == 2) value.clear();
      ++n_records;
    }
    store.write((folder_ / "before.tind").string());
    const auto [n_built, n_again] = count(build("after.tind", "before.tind", 12, false, 2));
    EXPECT_TRUE(bytes_of("after.tind") == bytes_of("whole.tind")) << way;
    EXPECT_EQ(n_built, n_records) << way;
    EXPECT_EQ(n_again, 0u) << way;
    EXPECT_GT(n_built, n_sound) << way;
  }
}

// Before 0.6.0 content hashes were FNV-1a.
TEST_F(UpdateTest, ChecksEarlierFilesOfOlderBuilders) {
  write();
  build("sound.tind", "", 12, false, 2);
  DamagedStore store((folder_ / "sound.tind").string());
  store.renew_hash(ContentHash::Kind::kFnv1a);
  const std::string older = (folder_ / "older.tind").string();
  const auto check = [&] {
    store.write(older);
    return EarlierPyramid::open(older).value().check_content(older);
  };
  EXPECT_TRUE(check());
  build("after.tind", "older.tind", 12, false, 2);
  EXPECT_TRUE(bytes_of("after.tind") == bytes_of("sound.tind"));
  const PieceKey root{PieceKind::kCorner, 0, 1, 1};
  store.change_corner(root, [](Corner& corner) { ++corner.z; });
  const auto damaged = check();
  ASSERT_FALSE(damaged);
  EXPECT_EQ(damaged.error().kind, ErrorKind::kCorrupt);
}

TEST_F(UpdateTest, JoinsShardsOfOlderBuildersToTheirBytes) {
  write();
  MergeOptions merge;
  merge.output = (folder_ / "joined.tind").string();
  for (int k = 0; k < 2; ++k) {
    shard_ = {k, 2};
    const std::string name = fmt::format("shard{}.tind", k);
    build(name, "", 12, false, 2);
    merge.inputs.push_back((folder_ / name).string());
    DamagedStore store(merge.inputs.back());
    store.renew_hash(ContentHash::Kind::kFnv1a);
    store.write(merge.inputs.back());
  }
  Progress silent(nullptr);
  const auto joined = merge_pyramids(merge, silent);
  ASSERT_TRUE(joined) << joined.error().message;
  shard_.reset();
  build("whole.tind", "", 12, false, 2);
  DamagedStore whole((folder_ / "whole.tind").string());
  whole.renew_hash(ContentHash::Kind::kFnv1a);
  EXPECT_EQ(joined->manifest.content_hash, whole.manifest()["content_hash"]);
  EXPECT_TRUE(EarlierPyramid::open(merge.output).value().check_content(merge.output));
}

TEST_F(UpdateTest, HasTheBytesOfARebuildWithDrainageToo) {
  run(10, 25, true, [this] { return change(); });
  EXPECT_GT(n_repeated_ + n_whole_, 20u);
}

}  // namespace
}  // namespace tind::test
