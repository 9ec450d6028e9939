// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/error_queue.hpp"

#include <random>
#include <set>
#include <vector>

#include <gtest/gtest.h>

namespace tind::test {
namespace {

TEST(ErrorQueue, GivesAllEntriesWorstClassFirst) {
  ErrorQueue queue;
  std::mt19937 random(7);
  std::lognormal_distribution<float> error(0, 4);
  for (int turn = 0; turn < 3; ++turn) {
    queue.reset(1e-30f);
    std::set<std::int32_t> waiting;
    std::vector<float> errors;
    float last = 1e30f;
    for (std::int32_t face = 0; face < 20'000; ++face) {
      errors.push_back(error(random));
      queue.push(face, errors.back(), static_cast<std::uint32_t>(face) + 7);
      waiting.insert(face);
    }
    while (const auto entry = queue.pop()) {
      EXPECT_EQ(waiting.erase(entry->face), 1u);
      // A later one is worse by less than a class.
      const float error_m = errors[static_cast<std::size_t>(entry->face)];
      EXPECT_LT(error_m, last * (1 + 1 / 16.0f));
      EXPECT_EQ(entry->stamp, static_cast<std::uint32_t>(entry->face) + 7);
      last = error_m;
    }
    EXPECT_TRUE(waiting.empty());
  }
}

TEST(ErrorQueue, AWorseFaceOvertakesAndOfOneClassTheLastGoesFirst) {
  ErrorQueue queue;
  queue.reset(1.0f);
  queue.push(1, 2.0f, 0);
  queue.push(2, 2.01f, 0);
  EXPECT_EQ(queue.pop()->face, 2);
  queue.push(3, 50.0f, 0);
  queue.push(4, 1.0f, 0);
  EXPECT_EQ(queue.pop()->face, 3);
  EXPECT_EQ(queue.pop()->face, 1);
  EXPECT_EQ(queue.pop()->face, 4);
  EXPECT_FALSE(queue.pop());
}

TEST(ErrorQueue, StartsAnewEmpty) {
  ErrorQueue queue;
  EXPECT_FALSE(queue.pop());
  queue.reset(0.5f);
  queue.push(1, 3.0f, 0);
  queue.reset(10.0f);
  EXPECT_FALSE(queue.pop());
  queue.push(2, 10.0f, 0);
  EXPECT_EQ(queue.pop()->face, 2);
}

}  // namespace
}  // namespace tind::test
