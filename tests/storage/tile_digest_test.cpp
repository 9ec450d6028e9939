// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/tile_digest.hpp"

#include <gtest/gtest.h>

#include <vector>

#include "tests/support/memory_watch.hpp"
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

// 200 x 300 points of a height of their own, ascending by (y, x), all over tile (21, 31) and beyond.
std::vector<LatticePoint> pinned_points() {
  std::vector<LatticePoint> points;
  for (std::int64_t r = 0; r < 200; ++r) {
    for (std::int64_t c = 0; c < 300; ++c) {
      points.push_back({20 * 65536 + 700 * c, 30 * 65536 + 700 * r, static_cast<std::int32_t>(r + c)});
    }
  }
  return points;
}

TEST(FrameDigest, SeesThePinnedPointsOfTheTileAndNoOthers) {
  TestField f = field_of();
  std::vector<LatticePoint> points = pinned_points();
  TileTask task;
  task.key = {kFinest, 21, 31};
  const auto digest = [&] {
    f.field.pinned = PinnedPoints(points);
    return frame_digest(f.field, task, {}, 0);
  };
  const auto before = digest();
  std::size_t n_inside = 0;
  for (std::size_t k = 0; k < points.size(); k += 7) {
    LatticePoint& p = points[k];
    const bool inside = p.x >= 21 * 65536 && p.x <= 22 * 65536 && p.y >= 31 * 65536 && p.y <= 32 * 65536;
    ++p.z;
    EXPECT_EQ(digest() != before, inside) << p.x << ' ' << p.y;
    --p.z;
    n_inside += inside ? 1 : 0;
  }
  EXPECT_GT(n_inside, 1000u);
  EXPECT_EQ(digest(), before);
  points.pop_back();
  EXPECT_EQ(digest(), before);
  std::erase_if(points, [](const LatticePoint& p) { return p.x == 21 * 65536 + 264 && p.y == 31 * 65536 + 264; });
  EXPECT_EQ(points.size(), 59'998u);
  EXPECT_NE(digest(), before);
}

TEST(FrameDigest, CopiesNoMoreThanARowOfPinnedPoints) {
  TestField f = field_of();
  const std::vector<LatticePoint> points = pinned_points();
  f.field.pinned = PinnedPoints(points);
  TileTask task;
  task.key = {0, 0, 0};
  reset_most_held_bytes();
  const std::size_t held_before = held_bytes();
  frame_digest(f.field, task, {}, 0);
  EXPECT_LT(most_held_bytes() - held_before, 64u << 10);  // all of them are 1.4 MB
}

}  // namespace
}  // namespace tind::test
