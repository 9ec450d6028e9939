// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/drainage/compare.hpp"

#include <numbers>

#include <gtest/gtest.h>

namespace tind {
namespace {

/// A stream of 10 cells along row `row` of a 20 x 20 grid.
std::vector<StreamPost> along_row(std::int64_t row) {
  std::vector<StreamPost> posts;
  for (std::int64_t c = 5; c < 15; ++c) posts.push_back({row, c, 1});
  return posts;
}

StreamMatch compare(const std::vector<StreamPost>& extracted, const std::vector<StreamPost>& reference,
                    std::span<const std::uint8_t> excluded = {}) {
  return compare_streams(20, 20, extracted, reference, 2, excluded);
}

TEST(DrainageCompare, TheSameNetworkMatchesWholly) {
  const StreamMatch m = compare(along_row(4), along_row(4));
  EXPECT_EQ(m.completeness(), 1);
  EXPECT_EQ(m.correctness(), 1);
  EXPECT_EQ(m.quality(), 1);
  EXPECT_EQ(m.mean_distance, 0);
  EXPECT_EQ(m.reference_length, 10);
}

TEST(DrainageCompare, TheBufferIsTwoCells) {
  EXPECT_EQ(compare(along_row(6), along_row(4)).quality(), 1);
  EXPECT_EQ(compare(along_row(6), along_row(4)).mean_distance, 2);
  EXPECT_EQ(compare(along_row(7), along_row(4)).quality(), 0);
  // Two up and one beside is further than two.
  EXPECT_EQ(compare({{6, 4, 1}}, {{4, 5, 1}}).correctness(), 0);
  EXPECT_EQ(compare({{5, 4, 1}}, {{4, 5, 1}}).correctness(), 1);
}

TEST(DrainageCompare, CountsWhatIsMissingAndWhatIsTooMuch) {
  std::vector<StreamPost> both = along_row(4), other = along_row(16);
  both.insert(both.end(), other.begin(), other.end());
  const StreamMatch more = compare(both, along_row(4));
  EXPECT_EQ(more.completeness(), 1);
  EXPECT_EQ(more.correctness(), 0.5);
  EXPECT_EQ(more.quality(), 0.5);
  const StreamMatch less = compare(along_row(4), both);
  EXPECT_EQ(less.completeness(), 0.5);
  EXPECT_EQ(less.correctness(), 1);
  EXPECT_EQ(less.quality(), 0.5);
}

TEST(DrainageCompare, NothingAgainstNothingIsRight) {
  EXPECT_EQ(compare({}, {}).quality(), 1);
  EXPECT_EQ(compare({}, along_row(4)).completeness(), 0);
  EXPECT_EQ(compare(along_row(4), {}).correctness(), 0);
  EXPECT_EQ(compare(along_row(4), {}).completeness(), 1);
}

TEST(DrainageCompare, ExcludedPostsAreNotScoredButMatch) {
  std::vector<std::uint8_t> excluded(400, 0);
  for (std::size_t c = 0; c < 20; ++c) excluded[4 * 20 + c] = 1;
  const StreamMatch m = compare(along_row(6), along_row(4), excluded);
  EXPECT_EQ(m.reference_length, 0);
  EXPECT_EQ(m.extracted_length, 10);
  EXPECT_EQ(m.correctness(), 1);
}

TEST(DrainageCompare, StreamPostsHaveTheLengthOfTheirStep) {
  // East, then north-east, then out of the mask.
  const std::vector<std::uint8_t> mask = {1, 1, 0, 0, 0, 1}, directions = {0, 1, 0, 0, 0, 2};
  const auto posts = stream_posts(2, 3, mask.data(), directions.data());
  ASSERT_EQ(posts.size(), 3u);
  EXPECT_EQ(posts[0].length, 1);
  EXPECT_EQ(posts[1].length, std::numbers::sqrt2);
  EXPECT_EQ(posts[2].length, 0) << "leaves the grid";
}

}  // namespace
}  // namespace tind
