// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/tile_digest.hpp"

#include <gtest/gtest.h>

#include <vector>

#include "tests/support/test_field.hpp"

namespace tind::test {
namespace {

constexpr int kFinest = 6;
constexpr std::int64_t kRows = 90, kCols = 130;

// Posts over several tiles of the finest level, which has 65536 lattice steps a side.
GridPlace place(std::int64_t cols_before = 0, std::int64_t rows_before = 0) {
  GridPlace p;
  p.lattice_level = kFinest;
  p.dx = p.dy = 2000;
  p.x0 = 20 * 65536.0 + 17 - static_cast<double>(cols_before) * p.dx;
  p.y0 = 30 * 65536.0 + 500 - static_cast<double>(rows_before) * p.dy;
  p.n_rows = kRows + rows_before;
  p.n_cols = kCols + cols_before;
  return p;
}

TestField field_of(std::int64_t cols_before = 0, std::int64_t rows_before = 0) {
  return TestField(place(cols_before, rows_before), [=](std::int64_t r, std::int64_t c) {
    return 1000 * noise(5, r - rows_before + 500, c - cols_before + 500);
  });
}

PostDigests digests_of(const TestField& f, int threads = 1) { return PostDigests(f.field, kFinest, threads, nullptr); }

// Tiles of a level whose digests differ.
std::vector<TileKey> differing(const PostDigests& a, const PostDigests& b, std::uint8_t level) {
  std::vector<TileKey> keys;
  for (std::uint32_t y = 0; y < TileKey::count_y(level); ++y) {
    for (std::uint32_t x = 0; x < TileKey::count_x(level); ++x) {
      if (a.of({level, x, y}) != b.of({level, x, y})) keys.push_back({level, x, y});
    }
  }
  return keys;
}

TEST(PostDigests, DoNotDependOnThreads) {
  const TestField f = field_of();
  const PostDigests one = digests_of(f), three = digests_of(f, 3);
  for (std::uint8_t level = 0; level <= kFinest; ++level) EXPECT_TRUE(differing(one, three, level).empty());
}

TEST(PostDigests, APostChangesThoseOfTheTilesAroundItAndTheirAncestors) {
  TestField f = field_of();
  const PostDigests before = digests_of(f);
  // In the middle of tile (21, 31): the posts of one more all around do not reach another tile.
  const auto col = static_cast<std::int64_t>((21.5 * 65536 - f.field.x0) / f.field.dx);
  const auto row = static_cast<std::int64_t>((31.5 * 65536 - f.field.y0) / f.field.dy);
  f.heights_m[static_cast<std::size_t>(row * kCols + col)] += 0.25f;
  const PostDigests after = digests_of(f);
  TileKey key{kFinest, 21, 31};
  for (;; key = key.parent()) {
    EXPECT_EQ(differing(before, after, key.level), std::vector<TileKey>{key}) << int{key.level};
    if (key.level == 0) break;
  }
  // An origin counts, too.
  f.heights_m[static_cast<std::size_t>(row * kCols + col)] -= 0.25f;
  EXPECT_TRUE(differing(before, digests_of(f), kFinest).empty());
  f.origins[static_cast<std::size_t>(row * kCols + col)] = PostOrigin::kFilled;
  EXPECT_EQ(differing(before, digests_of(f), kFinest), (std::vector<TileKey>{{kFinest, 21, 31}}));
}

TEST(PostDigests, APostBesideATileCounts) {
  TestField f = field_of();
  const PostDigests before = digests_of(f);
  // The first post east of the line between tiles 20 and 21.
  const auto col = static_cast<std::int64_t>((21 * 65536 - f.field.x0) / f.field.dx) + 1;
  const auto row = static_cast<std::int64_t>((31.5 * 65536 - f.field.y0) / f.field.dy);
  f.heights_m[static_cast<std::size_t>(row * kCols + col)] += 1;
  EXPECT_EQ(differing(before, digests_of(f), kFinest), (std::vector<TileKey>{{kFinest, 20, 31}, {kFinest, 21, 31}}));
}

TEST(PostDigests, AGridThatGrowsElsewhereLeavesTheOthers) {
  const PostDigests before = digests_of(field_of());
  // 40 columns more in the west are more than a tile, and change the tiles at the old west side and beyond alone.
  const PostDigests after = digests_of(field_of(40, 0));
  const auto keys = differing(before, after, kFinest);
  EXPECT_FALSE(keys.empty());
  for (const TileKey& key : keys) EXPECT_LE(key.x, 20u);
}

TEST(PostDigests, AreZeroWhereNoPostIsNear) {
  const PostDigests digests = digests_of(field_of());
  EXPECT_EQ(digests.of({kFinest, 90, 10}), TileInputs::Digest{});
  EXPECT_EQ(digests.of({0, 1, 0}), TileInputs::Digest{});
  EXPECT_NE(digests.of({0, 0, 0}), TileInputs::Digest{});
}

TEST(PostDigests, SeeAGridAcrossLongitude180FromBothSides) {
  GridPlace p = place();
  const double width = 2 * 64 * 65536.0;
  p.x0 = width - 60 * p.dx;  // 60 columns before the line, 70 behind it
  TestField f(p, [](std::int64_t r, std::int64_t c) { return 10 * noise(7, r, c); });
  const PostDigests before = digests_of(f);
  f.heights_m[static_cast<std::size_t>(40 * kCols + 60 + 16)] += 1;  // half a tile east of the line
  const auto keys = differing(before, digests_of(f), kFinest);
  ASSERT_EQ(keys.size(), 1u);
  EXPECT_EQ(keys[0].x, 0u);
}

}  // namespace
}  // namespace tind::test
