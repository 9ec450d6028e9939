// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/error_queue.hpp"

#include <random>
#include <set>

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
    float last = 1e30f;
    for (std::int32_t face = 0; face < 20'000; ++face) {
      queue.push(face, error(random));
      waiting.insert(face);
    }
    while (const auto entry = queue.pop()) {
      EXPECT_EQ(waiting.erase(entry->face), 1u);
      // A later one is worse by less than a class.
      EXPECT_LT(entry->error_m, last * (1 + 1 / 16.0f));
      last = entry->error_m;
    }
    EXPECT_TRUE(waiting.empty());
  }
}

TEST(ErrorQueue, AWorseFaceOvertakesAndOfOneClassTheLastGoesFirst) {
  ErrorQueue queue;
  queue.reset(1.0f);
  queue.push(1, 2.0f);
  queue.push(2, 2.01f);
  EXPECT_EQ(queue.pop()->face, 2);
  queue.push(3, 50.0f);
  queue.push(4, 1.0f);
  EXPECT_EQ(queue.pop()->face, 3);
  EXPECT_EQ(queue.pop()->face, 1);
  EXPECT_EQ(queue.pop()->face, 4);
  EXPECT_FALSE(queue.pop());
}

TEST(ErrorQueue, StartsAnewEmpty) {
  ErrorQueue queue;
  EXPECT_FALSE(queue.pop());
  queue.reset(0.5f);
  queue.push(1, 3.0f);
  queue.reset(10.0f);
  EXPECT_FALSE(queue.pop());
  queue.push(2, 10.0f);
  EXPECT_EQ(queue.pop()->face, 2);
}

}  // namespace
}  // namespace tind::test
