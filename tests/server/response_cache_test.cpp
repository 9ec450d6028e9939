// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/response_cache.hpp"

#include <gtest/gtest.h>

#include <thread>

namespace tind {
namespace {

std::shared_ptr<const Coded> value(std::size_t n) {
  return std::make_shared<const Coded>(Coded{Bytes(n, 7), Coding::kIdentity});
}

TEST(ResponseCache, ForgetsTheLeastRecentlyUsedAndStaysInBounds) {
  ResponseCache cache(8 * 10000);
  std::size_t found = 0;
  for (int k = 0; k < 1000; ++k) cache.put(std::to_string(k), value(1000));
  for (int k = 0; k < 1000; ++k) found += cache.find(std::to_string(k)) != nullptr;
  EXPECT_GT(found, 30u);
  EXPECT_LE(found, 80u);
  cache.put("kept", value(10));
  for (int k = 1000; k < 2000; ++k) {
    ASSERT_NE(cache.find("kept"), nullptr);
    cache.put(std::to_string(k), value(1000));
  }
}

TEST(ResponseCache, RefusesWhatIsTooLargeAndNothingWithoutMemory) {
  ResponseCache cache(80000), none(0);
  cache.put("large", value(20000));
  EXPECT_EQ(cache.find("large"), nullptr);
  none.put("a", value(1));
  EXPECT_EQ(none.find("a"), nullptr);
}

TEST(ResponseCache, IsThreadSafe) {
  ResponseCache cache(100000);
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&cache, t] {
      for (int k = 0; k < 5000; ++k) {
        const std::string key = std::to_string((k * 7 + t) % 300);
        if (const auto found = cache.find(key)) {
          EXPECT_EQ(found->bytes.size(), 500u);
        } else {
          cache.put(key, value(500));
        }
      }
    });
  }
  for (auto& thread : threads) thread.join();
}

}  // namespace
}  // namespace tind
