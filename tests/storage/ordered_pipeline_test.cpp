// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/ordered_pipeline.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <stdexcept>
#include <thread>

namespace tind {
namespace {

int identity(std::size_t i) { return static_cast<int>(i); }

TEST(OrderedPipeline, HandsResultsOverInOrderWhateverTheirDuration) {
  std::vector<int> seen;
  const bool finished = run_ordered<int, int>(
      200, 4, identity,
      [](int&& i) {
        std::this_thread::sleep_for(std::chrono::microseconds((i * 7919) % 500));
        return i * i;
      },
      [&](std::size_t i, int&& square) {
        EXPECT_EQ(square, static_cast<int>(i * i));
        seen.push_back(square);
        return true;
      });
  EXPECT_TRUE(finished);
  EXPECT_EQ(seen.size(), 200u);
}

TEST(OrderedPipeline, StopsEarlyAndKeepsFewJobsInFlight) {
  std::atomic<int> started = 0;
  const bool finished = run_ordered<int, int>(
      100000, 2, identity,
      [&](int&& i) {
        ++started;
        return i;
      },
      [](std::size_t i, int&&) { return i < 10; });
  EXPECT_FALSE(finished);
  EXPECT_LT(started, 100);
}

TEST(OrderedPipeline, BringsAWorkersExceptionToTheCaller) {
  const auto run = [](std::size_t bad) {
    run_ordered<int, int>(
        50, 3, identity,
        [bad](int&& i) {
          if (static_cast<std::size_t>(i) == bad) throw std::runtime_error("from a worker");
          return i;
        },
        [](std::size_t, int&&) { return true; });
  };
  EXPECT_THROW(run(0), std::runtime_error);
  EXPECT_THROW(run(49), std::runtime_error);
}

TEST(OrderedPipeline, EndsWhenTheCallersPartThrows) {
  const auto run = [] {
    run_ordered<int, int>(
        50, 3, identity, [](int&& i) { return i; },
        [](std::size_t i, int&&) -> bool {
          if (i == 5) throw std::runtime_error("from consume");
          return true;
        });
  };
  EXPECT_THROW(run(), std::runtime_error);
}

}  // namespace
}  // namespace tind
