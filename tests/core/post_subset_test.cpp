// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/post_subset.hpp"

#include <random>
#include <set>
#include <utility>

#include <gtest/gtest.h>

namespace tind::test {
namespace {

using Posts = std::set<std::pair<std::int64_t, std::int64_t>>;

Posts found_in(const PostSubset& subset, const PostBlocks::Extent& part, double west, double east) {
  Posts found;
  subset.visit(
      part, [&](double, double) { return std::pair(west, east); },
      [&](const PostBlocks::Extent& e) {
        for (std::int64_t r = e.row; r < e.row + e.n_rows; ++r) {
          for (std::int64_t c = e.col; c < e.col + e.n_cols; ++c) found.emplace(r, c);
        }
      },
      [&](const PostSubset::Post& p) {
        EXPECT_EQ(p.height_m, static_cast<float>(p.row + p.col));
        found.emplace(p.row, p.col);
      });
  return found;
}

TEST(PostSubset, GivesWhatLiesInAPartAndNothingElse) {
  std::mt19937 random(11);
  const auto below = [&random](std::int64_t n) {
    return std::uniform_int_distribution<std::int64_t>(0, n - 1)(random);
  };
  constexpr double kFar = 1e6;
  PostSubset subset;
  for (int turn = 0; turn < 60; ++turn) {
    subset.clear();
    Posts all, singles;
    const std::int64_t n_rows = turn % 3 == 0 ? 1 : 200, n_cols = turn % 5 == 0 ? 3 : 300;
    for (int k = 0; k < turn * 3; ++k) {
      const auto row = static_cast<std::int32_t>(100 + below(n_rows)),
                 col = static_cast<std::int32_t>(50 + below(n_cols));
      subset.add_post({row, col, static_cast<float>(row + col)});
      all.emplace(row, col);
      singles.emplace(row, col);
    }
    for (int k = 0; k < turn % 4; ++k) {
      const PostBlocks::Extent box{below(300), below(300), 1 + below(9), 1 + below(9)};
      subset.add_box(box);
      for (std::int64_t r = box.row; r < box.row + box.n_rows; ++r) {
        for (std::int64_t c = box.col; c < box.col + box.n_cols; ++c) all.emplace(r, c);
      }
    }
    subset.arrange();
    for (int k = 0; k < 200; ++k) {
      const std::int64_t row = 90 + below(220), col = 40 + below(320);
      const PostSubset::Post* const post = subset.find(row, col);
      ASSERT_EQ(post != nullptr, singles.contains({row, col}));
      if (post != nullptr) {
        ASSERT_TRUE(post->row == row && post->col == col);
      }
    }
    for (const auto& [row, col] : singles) ASSERT_NE(subset.find(row, col), nullptr);
    for (int k = 0; k < 50; ++k) {
      const PostBlocks::Extent part{below(320) - 10, below(380) - 10, below(150) - 3, below(150) - 3};
      Posts expected;
      const auto is_in = [&](const auto& p) {
        return p.first >= part.row && p.first < part.row + part.n_rows && p.second >= part.col &&
               p.second < part.col + part.n_cols;
      };
      for (const auto& p : all) {
        if (is_in(p)) expected.insert(p);
      }
      ASSERT_EQ(found_in(subset, part, -kFar, kFar), expected) << turn;
      // Columns leave out some single ones, but none between them.
      const double west = static_cast<double>(part.col) + 20.5, east = west + 30;
      const Posts narrow = found_in(subset, part, west, east);
      for (const auto& p : expected) {
        if (static_cast<double>(p.second) >= west && static_cast<double>(p.second) <= east) {
          EXPECT_TRUE(narrow.contains(p)) << turn;
        }
      }
      for (const auto& p : narrow) EXPECT_TRUE(expected.contains(p)) << turn;
    }
  }
}

}  // namespace
}  // namespace tind::test
