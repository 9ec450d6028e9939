// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/response_cache.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <vector>

namespace tind {
namespace {

std::shared_ptr<const CachedResponse> value(std::size_t n) {
  return std::make_shared<const CachedResponse>("Content-Type: t\r\n", "ETag: \"e\"\r\n", "\"e\"",
                                                Coded{Bytes(n, 7), Coding::kGzip});
}
CacheKey key(std::uint64_t k) { return {1, k, 0}; }

TEST(ResponseCache, AnAnswerKeepsItsParts) {
  const auto made = value(3);
  EXPECT_EQ(made->fields(), "Content-Type: t\r\nETag: \"e\"\r\n");
  EXPECT_EQ(made->validator_fields(), "ETag: \"e\"\r\n");
  EXPECT_EQ(made->etag(), "\"e\"");
  EXPECT_EQ(made->coding(), Coding::kGzip);
  EXPECT_EQ(Bytes(made->body().begin(), made->body().end()), Bytes(3, 7));
}

TEST(ResponseCache, ForgetsTheLeastRecentlyUsedAndStaysInBounds) {
  constexpr std::size_t kCapacity = 160000;
  ResponseCache cache(kCapacity);
  std::size_t found = 0;
  for (std::uint64_t k = 0; k < 1000; ++k) {
    cache.put(key(k), value(1000));
    ASSERT_LE(cache.n_bytes(), kCapacity);
  }
  for (std::uint64_t k = 0; k < 1000; ++k) found += cache.find(key(k)) != nullptr;
  EXPECT_GT(found, 60u);
  EXPECT_LE(found, 160u);
  cache.put({9, 9, 9}, value(10));
  for (std::uint64_t k = 1000; k < 2000; ++k) {
    ASSERT_NE(cache.find({9, 9, 9}), nullptr) << "what is used stays";
    cache.put(key(k), value(1000));
  }
}

TEST(ResponseCache, RefusesWhatIsTooLargeAndNothingWithoutMemory) {
  ResponseCache cache(160000), none(0);
  cache.put(key(1), value(20000));
  EXPECT_EQ(cache.find(key(1)), nullptr);
  none.put(key(1), value(1));
  EXPECT_EQ(none.find(key(1)), nullptr);
}

TEST(ResponseCache, TellsKeysApart) {
  ResponseCache cache(std::size_t{1} << 20);
  const std::vector<CacheKey> keys = {{1, 2, 3}, {2, 1, 3}, {1, 3, 2}, {3, 2, 1}, {1, 2, 4}};
  for (std::size_t k = 0; k < keys.size(); ++k) cache.put(keys[k], value(k));
  for (std::size_t k = 0; k < keys.size(); ++k) {
    const auto found = cache.find(keys[k]);
    ASSERT_NE(found, nullptr);
    EXPECT_EQ(found->body().size(), k);
  }
}

TEST(ResponseCache, ThreadsThatMissTogetherMakeAValueOnce) {
  ResponseCache cache(std::size_t{1} << 20);
  std::atomic<int> n_made = 0;
  std::vector<std::thread> threads;
  for (int t = 0; t < 8; ++t) {
    threads.emplace_back([&] {
      const auto lock = cache.lock_making(key(1));
      if (cache.find(key(1))) return;
      ++n_made;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
      cache.put(key(1), value(1));
    });
  }
  for (auto& thread : threads) thread.join();
  EXPECT_EQ(n_made, 1);
}

TEST(ResponseCache, IsThreadSafe) {
  ResponseCache cache(100000);
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&cache, t] {
      for (int k = 0; k < 5000; ++k) {
        const CacheKey wanted = key(static_cast<std::uint64_t>((k * 7 + t) % 300));
        if (const auto found = cache.find(wanted)) {
          EXPECT_EQ(found->body().size(), 500u);
        } else {
          cache.put(wanted, value(500));
        }
      }
    });
  }
  for (auto& thread : threads) thread.join();
}

}  // namespace
}  // namespace tind
