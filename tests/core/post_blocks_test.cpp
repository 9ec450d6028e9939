// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/post_blocks.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <optional>
#include <thread>
#include <vector>

#include "tests/support/test_field.hpp"

namespace tind {
namespace {

/// Blocks with their memory.
struct Blocks {
  std::vector<std::byte> memory;
  PostBlocks blocks;

  explicit Blocks(const HeightField& field, int threads = 1)
      : memory(PostBlocks::n_bytes(field.n_rows, field.n_cols)), blocks(PostBlocks::build(field, memory, threads)) {}
};

test::TestField field_of(std::int64_t n_rows, std::int64_t n_cols, const test::HeightAt& height) {
  test::GridPlace place;
  place.n_rows = n_rows;
  place.n_cols = n_cols;
  return test::TestField(place, height);
}

/// Heights of very different sizes and slopes, mountains among them.
test::HeightAt wild_terrain(std::uint64_t seed) {
  const test::HeightAt mountains = test::rough_terrain(seed, 3000);
  return [=](std::int64_t r, std::int64_t c) {
    return mountains(r, c) + 0.7 * static_cast<double>(c) - 2.3 * static_cast<double>(r);
  };
}

PostPlane random_plane(std::uint64_t seed, double size_m) {
  const auto random = [&](std::int64_t k) { return (test::noise(seed, k, 7) - 0.5) * size_m; };
  return {random(1), random(2) / 10, random(3) / 10};
}

/// The first thing that the blocks say wrongly of the field; nullopt: all is true.
std::optional<std::string> first_lie(const HeightField& f, const PostBlocks& blocks) {
  for (int level = 0; level < blocks.n_levels(); ++level) {
    for (std::int64_t i = 0; i < blocks.n_block_rows(level); ++i) {
      for (std::int64_t j = 0; j < blocks.n_block_cols(level); ++j) {
        const std::string name = std::to_string(level) + "/" + std::to_string(i) + "/" + std::to_string(j);
        const PostBlocks::Extent e = blocks.extent(level, i, j);
        const PostBlock& b = blocks.block(level, i, j);
        const PostBlockSums& s = blocks.sums(level, i, j);
        const PostPlane own = b.plane();
        const PostPlane plane = random_plane(static_cast<std::uint64_t>(level * 977 + i * 31 + j), 500);
        float low = f.heights_m[e.row * f.n_cols + e.col], high = low;
        unsigned origins = 0;
        std::uint32_t n_source = 0;
        long double own2 = 0, other2 = 0;
        for (std::int64_t r = 0; r < e.n_rows; ++r) {
          for (std::int64_t c = 0; c < e.n_cols; ++c) {
            const std::int64_t at = (e.row + r) * f.n_cols + e.col + c;
            const double h = f.heights_m[at], col = static_cast<double>(c), row = static_cast<double>(r);
            const double one = h - own.at(col, row);
            const double two = (h - own.origin_m) - (own.per_row_m * row + own.per_col_m * col);
            if (std::min(one, two) < b.low_m || std::max(one, two) > b.high_m) return name + ": range of residuals";
            low = std::min(low, f.heights_m[at]);
            high = std::max(high, f.heights_m[at]);
            origins |= 1u << static_cast<int>(f.origins[at]);
            n_source += f.origins[at] == PostOrigin::kSource;
            const long double exact_own = static_cast<long double>(h) - own.origin_m -
                                          static_cast<long double>(own.per_col_m) * c -
                                          static_cast<long double>(own.per_row_m) * r;
            const long double exact_other = static_cast<long double>(h) - plane.origin_m -
                                            static_cast<long double>(plane.per_col_m) * c -
                                            static_cast<long double>(plane.per_row_m) * r;
            own2 += exact_own * exact_own;
            other2 += exact_other * exact_other;
          }
        }
        if (low != s.min_height_m || high != s.max_height_m) return name + ": least and largest height";
        if (origins != b.origins || n_source != s.n_source) return name + ": origins";
        const auto is_near = [](double closed, long double direct) {
          return std::abs(static_cast<long double>(closed) - direct) <= 1e-9L * direct + 1e-12L;
        };
        if (!is_near(blocks.squared_distance_m2(level, i, j, own), own2)) return name + ": squares about its plane";
        if (!is_near(blocks.squared_distance_m2(level, i, j, plane), other2)) return name + ": squares about a plane";
      }
    }
  }
  return std::nullopt;
}

TEST(PostBlocks, TellTheTruthOnGridsOfAllShapes) {
  for (const auto& [n_rows, n_cols] :
       {std::pair{1, 1}, {1, 50}, {50, 1}, {8, 8}, {7, 9}, {64, 64}, {65, 127}, {300, 211}}) {
    const test::TestField f = field_of(n_rows, n_cols, wild_terrain(static_cast<std::uint64_t>(n_rows)));
    const Blocks built(f.field);
    EXPECT_EQ(first_lie(f.field, built.blocks), std::nullopt) << n_rows << " x " << n_cols;
    const int top = built.blocks.n_levels() - 1;
    EXPECT_EQ(built.blocks.n_block_rows(top) * built.blocks.n_block_cols(top), 1);
  }
}

TEST(PostBlocks, TellTheTruthOfSmallHeightsFarFromZero) {
  const test::TestField f =
      field_of(70, 90, [](std::int64_t r, std::int64_t c) { return 8000 + 0.01 * test::noise(5, r, c); });
  EXPECT_EQ(first_lie(f.field, Blocks(f.field).blocks), std::nullopt);
}

TEST(PostBlocks, KnowTheOriginsOfTheirPosts) {
  test::TestField f = field_of(100, 100, wild_terrain(3));
  for (std::size_t k = 0; k < f.origins.size(); ++k) {
    const auto r = static_cast<std::int64_t>(k) / 100, c = static_cast<std::int64_t>(k) % 100;
    if (r >= 40 && c >= 48) f.origins[k] = static_cast<PostOrigin>(static_cast<int>(5 * test::noise(1, r, c)));
  }
  const Blocks built(f.field);
  EXPECT_EQ(first_lie(f.field, built.blocks), std::nullopt);
  EXPECT_TRUE(built.blocks.block(0, 0, 0).is_all(PostOrigin::kSource));
  EXPECT_FALSE(built.blocks.block(0, 0, 0).has(PostOrigin::kInterpolated));
  EXPECT_TRUE(built.blocks.block(0, 7, 7).has(PostOrigin::kInterpolated));
  EXPECT_FALSE(built.blocks.block(0, 7, 7).is_all(PostOrigin::kSource));
}

TEST(PostBlocks, APostThatChangesMakesThemLie) {
  test::TestField f = field_of(90, 75, wild_terrain(8));
  const Blocks built(f.field);
  ASSERT_EQ(first_lie(f.field, built.blocks), std::nullopt);
  for (const std::size_t at : {std::size_t{0}, std::size_t{3333}, f.heights_m.size() - 1}) {
    const float before = f.heights_m[at];
    f.heights_m[at] += 0.001f;
    EXPECT_NE(first_lie(f.field, built.blocks), std::nullopt) << at;
    f.heights_m[at] = before;
    f.origins[at] = PostOrigin::kFilled;
    EXPECT_NE(first_lie(f.field, built.blocks), std::nullopt) << at;
    f.origins[at] = PostOrigin::kSource;
  }
}

TEST(PostBlocks, OfAPlaneHaveNoResiduals) {
  const test::TestField f =
      field_of(80, 80, [](std::int64_t r, std::int64_t c) { return 100.0 + 0.5 * static_cast<double>(3 * c - r); });
  const Blocks built(f.field);
  for (int level = 0; level < built.blocks.n_levels(); ++level) {
    const PostBlock& b = built.blocks.block(level, 0, 0);
    EXPECT_EQ(b.origin_m, 100.0f);
    EXPECT_EQ(b.per_col_m, 1.5f);
    EXPECT_EQ(b.per_row_m, -0.5f);
    EXPECT_NEAR(b.low_m, 0, 1e-9);
    EXPECT_NEAR(b.high_m, 0, 1e-9);
  }
}

// A coarse block may bound its posts by its children's ranges, but not by anything wild.
TEST(PostBlocks, CoarseRangesAreTight) {
  const test::TestField f = field_of(512, 512, test::rough_terrain(4, 1000));
  const Blocks built(f.field);
  for (int level = 1; level < built.blocks.n_levels(); ++level) {
    double bound = 0, real = 0;
    for (std::int64_t i = 0; i < built.blocks.n_block_rows(level); ++i) {
      for (std::int64_t j = 0; j < built.blocks.n_block_cols(level); ++j) {
        const PostBlocks::Extent e = built.blocks.extent(level, i, j);
        const PostBlock& b = built.blocks.block(level, i, j);
        double low = 1e9, high = -1e9;
        for (std::int64_t r = 0; r < e.n_rows; ++r) {
          for (std::int64_t c = 0; c < e.n_cols; ++c) {
            const double d =
                f.field.height_at(e.row + r, e.col + c) - b.plane().at(static_cast<double>(c), static_cast<double>(r));
            low = std::min(low, d);
            high = std::max(high, d);
          }
        }
        bound += b.high_m - b.low_m;
        real += high - low;
      }
    }
    EXPECT_LT(bound, 2.5 * real) << level;
  }
}

TEST(PostBlocks, AreTheSameForAnyNumberOfThreads) {
  const test::TestField f = field_of(333, 257, wild_terrain(6));
  const Blocks one(f.field, 1), many(f.field, 7);
  EXPECT_EQ(0, std::memcmp(one.memory.data(), many.memory.data(), one.memory.size()));
}

TEST(PostBlocks, OnDemandAreTheSameWhoeverAsksForThem) {
  for (const auto& [n_rows, n_cols] : {std::pair{1, 1}, {9, 70}, {333, 257}, {130, 1100}}) {
    test::TestField f = field_of(n_rows, n_cols, wild_terrain(6));
    for (std::size_t k = 0; k < f.origins.size(); k += 1 + k % 731) f.origins[k] = PostOrigin::kFalloff;
    const Blocks eager(f.field);
    for (const int threads : {1, 5}) {
      std::vector<std::byte> memory(eager.memory.size());
      const PostBlocks blocks = PostBlocks::on_demand(f.field, memory, threads);
      ASSERT_EQ(blocks.n_levels(), eager.blocks.n_levels());
      // All threads ask for all blocks, each in an order of its own.
      std::atomic<int> n_wrong{0};
      std::vector<std::jthread> askers;
      for (int t = 0; t < threads; ++t) {
        askers.emplace_back([&, t] {
          for (int k = 0; k < blocks.n_levels(); ++k) {
            const int level = (k + t) % blocks.n_levels();
            const std::int64_t n = blocks.n_block_rows(level) * blocks.n_block_cols(level);
            for (std::int64_t b = 0; b < n; ++b) {
              const std::int64_t at = (b * (t % 2 == 0 ? 1 : n - 1) + t * 37) % n;
              const std::int64_t i = at / blocks.n_block_cols(level), j = at % blocks.n_block_cols(level);
              const bool same =
                  std::memcmp(&blocks.block(level, i, j), &eager.blocks.block(level, i, j), sizeof(PostBlock)) == 0 &&
                  std::memcmp(&blocks.sums(level, i, j), &eager.blocks.sums(level, i, j), sizeof(PostBlockSums)) == 0;
              n_wrong += same ? 0 : 1;
            }
          }
        });
      }
      askers.clear();
      EXPECT_EQ(n_wrong, 0);
      EXPECT_EQ(memory, eager.memory) << n_rows << " x " << n_cols;
    }
  }
}

TEST(PostBlocks, OnDemandTellOfWindowsWithoutBeingMade) {
  test::TestField f = field_of(150, 170, wild_terrain(2));
  for (std::size_t k = 5000; k < f.origins.size(); k += 1 + k % 317) f.origins[k] = PostOrigin::kFilled;
  const Blocks eager(f.field);
  std::vector<std::byte> memory(eager.memory.size());
  const PostBlocks blocks = PostBlocks::on_demand(f.field, memory, 2);
  for (const PostBlocks::Extent& w : {PostBlocks::Extent{0, 0, 150, 170},
                                      {13, 9, 70, 101},
                                      {-5, 160, 30, 40},
                                      {64, 64, 64, 64},
                                      {128, 128, 22, 42},
                                      {40, 40, 0, 9},
                                      {0, 3, 150, 90}}) {
    const auto all_of = [&](const PostBlocks& of) {
      PostSummary all{1e9f, -1e9f, 0, 0};
      of.visit(
          w,
          [&](int level, std::int64_t i, std::int64_t j, bool inside) {
            if (!inside) return false;
            const PostSummary s = of.summary(level, i, j);
            all = {std::min(all.min_height_m, s.min_height_m), std::max(all.max_height_m, s.max_height_m),
                   all.n_source + s.n_source, static_cast<std::uint8_t>(all.origins | s.origins)};
            return true;
          },
          [&](std::int64_t r, std::int64_t begin, std::int64_t end) {
            for (std::int64_t at = r * 170 + begin; at < r * 170 + end; ++at) {
              const PostOrigin origin = f.origins[static_cast<std::size_t>(at)];
              all.min_height_m = std::min(all.min_height_m, f.heights_m[static_cast<std::size_t>(at)]);
              all.max_height_m = std::max(all.max_height_m, f.heights_m[static_cast<std::size_t>(at)]);
              all.n_source += origin == PostOrigin::kSource;
              all.origins = static_cast<std::uint8_t>(all.origins | 1 << static_cast<int>(origin));
            }
          });
      return all;
    };
    const PostSummary a = all_of(blocks), b = all_of(eager.blocks);
    EXPECT_EQ(a.min_height_m, b.min_height_m);
    EXPECT_EQ(a.max_height_m, b.max_height_m);
    EXPECT_EQ(a.n_source, b.n_source);
    EXPECT_EQ(a.origins, b.origins);
  }
  EXPECT_EQ(memory, std::vector<std::byte>(memory.size())) << "no block was made";
  blocks.block(0, 10, 10);
  EXPECT_NE(memory, std::vector<std::byte>(memory.size()));
}

TEST(PostBlocks, TakeLittleMemory) { EXPECT_LE(PostBlocks::n_bytes(9603, 9603), 9603ull * 9603 * 12 / 10); }

TEST(PostBlocks, AWindowIsVisitedPostByPostOnce) {
  const test::TestField f = field_of(150, 170, wild_terrain(2));
  const Blocks built(f.field);
  for (const PostBlocks::Extent& w :
       {PostBlocks::Extent{0, 0, 150, 170}, {13, 9, 70, 101}, {-5, 160, 30, 40}, {8, 8, 8, 8}, {40, 40, 0, 9}}) {
    std::vector<int> seen(f.heights_m.size(), 0);
    int n_blocks = 0;
    built.blocks.visit(
        w,
        [&](int level, std::int64_t i, std::int64_t j, bool inside) {
          if (!inside) return false;
          ++n_blocks;
          const PostBlocks::Extent e = built.blocks.extent(level, i, j);
          for (std::int64_t r = e.row; r < e.row + e.n_rows; ++r) {
            for (std::int64_t c = e.col; c < e.col + e.n_cols; ++c) ++seen[static_cast<std::size_t>(r * 170 + c)];
          }
          return true;
        },
        [&](std::int64_t r, std::int64_t begin, std::int64_t end) {
          for (std::int64_t c = begin; c < end; ++c) ++seen[static_cast<std::size_t>(r * 170 + c)];
        });
    for (std::int64_t r = 0; r < 150; ++r) {
      for (std::int64_t c = 0; c < 170; ++c) {
        const bool in = r >= w.row && r < w.row + w.n_rows && c >= w.col && c < w.col + w.n_cols;
        ASSERT_EQ(seen[static_cast<std::size_t>(r * 170 + c)], in ? 1 : 0) << r << " " << c;
      }
    }
    EXPECT_EQ(n_blocks > 0, w.n_rows >= 8) << "whole blocks are not split";
  }
}

}  // namespace
}  // namespace tind
