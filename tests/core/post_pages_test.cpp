// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/post_pages.hpp"

#include <atomic>
#include <cstring>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "core/height_field.hpp"
#include "tests/support/test_field.hpp"
#include "tests/support/test_tile.hpp"

namespace tind::test {
namespace {

/// The posts of a field that has them in arrays.
class ArrayPages final : public PostPages {
 public:
  ArrayPages(const HeightField& field, std::size_t n_held)
      : PostPages(field.n_rows, field.n_cols, n_held), field_(field) {}

  mutable std::atomic<int> n_read = 0;
  bool broken = false;

 private:
  bool read(std::int64_t i, std::int64_t j, PostPage& page) const override {
    ++n_read;
    for (std::int64_t r = i * kSide; r < std::min((i + 1) * kSide, field_.n_rows); ++r) {
      for (std::int64_t c = j * kSide; c < std::min((j + 1) * kSide, field_.n_cols); ++c) {
        page.heights_m[index(r, c)] = field_.heights_m[r * field_.n_cols + c];
        page.origins[index(r, c)] = field_.origins[r * field_.n_cols + c];
      }
    }
    return !broken;
  }

  const HeightField& field_;
};

class ArrayBlockPages final : public PostBlockPages {
 public:
  ArrayBlockPages(const PostBlocks& blocks, const HeightField& field, std::size_t n_held)
      : PostBlockPages(PostBlocks::n_pages(field.n_rows), PostBlocks::n_pages(field.n_cols), n_held), blocks_(blocks) {}

 private:
  bool read(std::int64_t i, std::int64_t j, PostBlockPage& page) const override {
    for (int level = 0; level < std::min(PostBlockPage::kLevels, blocks_.n_levels()); ++level) {
      for (std::int64_t r = 0; r < blocks_.n_block_rows(level); ++r) {
        for (std::int64_t c = 0; c < blocks_.n_block_cols(level); ++c) {
          if (PostBlockPage::page_of(level, r) != i || PostBlockPage::page_of(level, c) != j) continue;
          page.blocks[PostBlockPage::index(level, r, c)] = blocks_.block(level, r, c);
          page.sums[PostBlockPage::index(level, r, c)] = blocks_.sums(level, r, c);
        }
      }
    }
    return true;
  }

  const PostBlocks& blocks_;
};

TestField uneven_field(std::int64_t n_rows, std::int64_t n_cols) {
  GridPlace place;
  place.n_rows = n_rows;
  place.n_cols = n_cols;
  TestField f(place, rough_terrain(5, 700));
  for (std::size_t i = 0; i < f.origins.size(); i += 1 + i % 13) f.origins[i] = PostOrigin::kFilled;
  return f;
}

TEST(PostPages, SayWhatTheArraysSay) {
  const TestField f = uneven_field(3 * PostPages::kSide + 7, 2 * PostPages::kSide + 1);
  for (const std::size_t n_held : {1u, 2u, 5u, 4096u}) {
    const ArrayPages pages(f.field, n_held);
    HeightField paged = f.field;
    paged.heights_m = nullptr;
    paged.origins = nullptr;
    paged.pages = &pages;
    for (std::int64_t r = 0; r < f.field.n_rows; ++r) {
      for (std::int64_t c = 0; c < f.field.n_cols; ++c) {
        ASSERT_EQ(paged.height_at(r, c), f.field.height_at(r, c)) << r << " " << c << " holding " << n_held;
        ASSERT_EQ(paged.origin_at(r, c), f.field.origin_at(r, c)) << r << " " << c << " holding " << n_held;
      }
    }
    const std::int64_t row = 50, col = 3, n_rows = PostPages::kSide + 30, n_cols = 2 * PostPages::kSide - 5;
    std::vector<float> heights(static_cast<std::size_t>(n_rows * n_cols));
    std::vector<PostOrigin> origins(heights.size());
    pages.copy(row, col, n_rows, n_cols, heights.data(), origins.data());
    for (std::int64_t r = 0; r < n_rows; ++r) {
      for (std::int64_t c = 0; c < n_cols; ++c) {
        const auto at = static_cast<std::size_t>(r * n_cols + c);
        ASSERT_EQ(static_cast<double>(heights[at]), f.field.height_at(row + r, col + c)) << r << " " << c;
        ASSERT_EQ(origins[at], f.field.origin_at(row + r, col + c)) << r << " " << c;
      }
    }
    EXPECT_FALSE(pages.failed());
  }
}

TEST(PostPages, AreReadOnceWhileTheyAreHeldAndNeverMistaken) {
  const TestField f = uneven_field(2 * PostPages::kSide, 2 * PostPages::kSide);
  TestField other = uneven_field(2 * PostPages::kSide, 2 * PostPages::kSide);
  for (float& h : other.heights_m) h += 1;
  const ArrayPages pages(f.field, 4), others(other.field, 4);
  for (int round = 0; round < 3; ++round) {
    for (std::int64_t i = 0; i < 2; ++i) {
      for (std::int64_t j = 0; j < 2; ++j) pages.page(i, j);
    }
  }
  EXPECT_EQ(pages.n_read, 4);
  // Another grid's pages push them out, for they share the thread's places.
  EXPECT_EQ(others.height_m(0, 0), pages.height_m(0, 0) + 1);
  EXPECT_EQ(others.height_m(70, 70), pages.height_m(70, 70) + 1);
  std::jthread([&] {
    EXPECT_EQ(pages.height_m(1, 1), f.heights_m[static_cast<std::size_t>(f.field.n_cols + 1)]);
  }).join();
}

TEST(PostPages, APageThatCannotBeReadIsZerosAndIsTold) {
  const TestField f = uneven_field(PostPages::kSide, PostPages::kSide);
  ArrayPages pages(f.field, 4);
  pages.broken = true;
  EXPECT_FALSE(pages.failed());
  EXPECT_EQ(pages.height_m(3, 5), 0);
  EXPECT_TRUE(pages.failed());
}

TEST(PostPages, BlocksInPagesAreTheSameBlocks) {
  for (const auto& [n_rows, n_cols] : {std::pair{5, 3}, {70, 64}, {200, 333}, {1100, 130}}) {
    const TestField f = uneven_field(n_rows, n_cols);
    std::vector<std::byte> memory(PostBlocks::n_bytes(n_rows, n_cols));
    const PostBlocks blocks = PostBlocks::build(f.field, memory, 2);
    const ArrayBlockPages pages(blocks, f.field, 3);
    std::vector<std::byte> coarse(blocks.n_coarse_bytes());
    const PostBlocks paged = blocks.in_pages(pages, coarse);
    ASSERT_EQ(paged.n_levels(), blocks.n_levels());
    for (int level = 0; level < blocks.n_levels(); ++level) {
      for (std::int64_t i = 0; i < blocks.n_block_rows(level); ++i) {
        for (std::int64_t j = 0; j < blocks.n_block_cols(level); ++j) {
          const auto same = [](const auto& a, const auto& b) { return std::memcmp(&a, &b, sizeof a) == 0; };
          ASSERT_TRUE(same(paged.block(level, i, j), blocks.block(level, i, j))) << level << "/" << i << "/" << j;
          ASSERT_TRUE(same(paged.sums(level, i, j), blocks.sums(level, i, j))) << level << "/" << i << "/" << j;
        }
      }
    }
  }
}

// Tiles whose posts are copied, and tiles that look at pages because there are too many posts.
TEST(PostPages, TilesAreTheSame) {
  constexpr TileKey kTile{5, 20, 13};
  constexpr int kLatticeLevel = 7, kFiner = 2;
  for (const double spacing : {2600.7, 170.3}) {
    TestField f(place_over(kTile.level, kTile.x, kTile.y, kLatticeLevel, spacing, 3), rough_terrain(8, 900));
    for (std::size_t i = 0; i < f.origins.size(); i += 1 + i % 9997) f.origins[i] = PostOrigin::kFilled;
    std::vector<std::byte> memory(PostBlocks::n_bytes(f.field.n_rows, f.field.n_cols));
    const PostBlocks blocks = PostBlocks::build(f.field, memory, 1);
    f.field.blocks = &blocks;
    const RefinementSpec spec = spec_from(kTile.level, 150, kFiner, f.field.lattice);
    const TestTile plain = build_tile(f.field, spec, kTile);

    const ArrayPages pages(f.field, 64);
    const ArrayBlockPages block_pages(blocks, f.field, 64);
    std::vector<std::byte> coarse(blocks.n_coarse_bytes());
    const PostBlocks paged_blocks = blocks.in_pages(block_pages, coarse);
    HeightField paged = f.field;
    paged.heights_m = nullptr;
    paged.origins = nullptr;
    paged.pages = &pages;
    paged.blocks = &paged_blocks;
    const TestTile tile = build_tile(paged, spec, kTile);
    EXPECT_EQ(tile.lines, plain.lines) << spacing;
    EXPECT_EQ(tile.surface.interior, plain.surface.interior) << spacing;
    EXPECT_EQ(tile.surface.triangles, plain.surface.triangles) << spacing;
    EXPECT_EQ(tile.surface.stats.n_posts, plain.surface.stats.n_posts) << spacing;
    EXPECT_EQ(tile.surface.stats.max_error_m, plain.surface.stats.max_error_m) << spacing;
    EXPECT_EQ(tile.surface.stats.rmse_m, plain.surface.stats.rmse_m) << spacing;
    EXPECT_GT(tile.surface.interior.size(), 10u) << spacing;
    EXPECT_GT(pages.n_read, 0) << spacing;
  }
}

}  // namespace
}  // namespace tind::test
