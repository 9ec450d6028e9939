// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/response_cache.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <thread>
#include <vector>

namespace tind {
namespace {

const Bytes kBytes(70000, 7);

AnswerParts answer(std::size_t n) {
  return {"Content-Type: t\r\n", "ETag: \"e\"\r\n", "\"e\"", Coding::kGzip, ByteView(kBytes).first(n)};
}
CacheKey key(std::uint64_t k) { return {1, k, 0}; }

// Puts answers 0..n-1 of so many bytes into a cache that never goes beyond its capacity.
void fill(ResponseCache& cache, std::size_t capacity, std::uint64_t n, std::size_t n_body) {
  for (std::uint64_t k = 0; k < n; ++k) {
    cache.put(key(k), answer(n_body));
    ASSERT_LE(cache.n_bytes(), capacity);
  }
}

// How many of answers 0..n-1 are there.
std::size_t n_found(ResponseCache& cache, std::uint64_t n) {
  std::size_t found = 0;
  for (std::uint64_t k = 0; k < n; ++k) found += cache.find(key(k)) ? 1 : 0;
  return found;
}

TEST(ResponseCache, AnAnswerKeepsItsParts) {
  for (const std::size_t capacity : {std::size_t{0}, std::size_t{1} << 20}) {
    ResponseCache cache(capacity);
    const auto made = cache.put(key(1), answer(3));
    EXPECT_EQ(made.fields(), "Content-Type: t\r\nETag: \"e\"\r\n");
    EXPECT_EQ(made.validator_fields(), "ETag: \"e\"\r\n");
    EXPECT_EQ(made.etag(), "\"e\"");
    EXPECT_EQ(made.coding(), Coding::kGzip);
    EXPECT_EQ(Bytes(made.body().begin(), made.body().end()), Bytes(3, 7));
  }
}

TEST(ResponseCache, KeepsWhatIsUsedAndStaysInBounds) {
  constexpr std::size_t kCapacity = 160000;
  ResponseCache cache(kCapacity);
  fill(cache, kCapacity, 1000, 1000);
  EXPECT_TRUE(cache.find(key(999)));
  EXPECT_FALSE(cache.find(key(0)));
  const std::size_t found = n_found(cache, 1000);
  EXPECT_GT(found, 60u);
  EXPECT_LE(found, 160u);
  cache.put({9, 9, 9}, answer(10));
  for (std::uint64_t k = 1000; k < 3000; ++k) {
    ASSERT_TRUE(cache.find({9, 9, 9})) << "what is used stays";
    cache.put(key(k), answer(1000));
    ASSERT_LE(cache.n_bytes(), kCapacity);
  }
}

TEST(ResponseCache, WhatIsUsedOnceStaysNotForEver) {
  ResponseCache cache(160000);
  cache.put({9, 9, 9}, answer(10));
  ASSERT_TRUE(cache.find({9, 9, 9}));
  for (std::uint64_t k = 0; k < 1000; ++k) cache.put(key(k), answer(1000));
  EXPECT_FALSE(cache.find({9, 9, 9}));
}

TEST(ResponseCache, ManySmallAnswersCountWithTheirIndex) {
  constexpr std::size_t kCapacity = 200000;
  ResponseCache cache(kCapacity);
  fill(cache, kCapacity, 5000, 0);
  EXPECT_GT(n_found(cache, 5000), 500u);
}

TEST(ResponseCache, AnAnswerOutlivesItsPlaceAndTheCache) {
  CachedResponse held;
  {
    ResponseCache cache(160000);
    held = cache.put({9, 9, 9}, answer(1234));
    for (std::uint64_t k = 0; k < 1000; ++k) cache.put(key(k), answer(1000));
  }
  const CachedResponse copy = held;
  held = {};
  EXPECT_EQ(Bytes(copy.body().begin(), copy.body().end()), Bytes(1234, 7));
}

TEST(ResponseCache, KeepsOfTwoTheFirst) {
  ResponseCache cache(std::size_t{1} << 20);
  cache.put(key(1), answer(10));
  EXPECT_EQ(cache.put(key(1), answer(20)).body().size(), 10u);
  EXPECT_EQ(cache.find(key(1)).body().size(), 10u);
}

TEST(ResponseCache, RefusesWhatIsTooLargeAndEverythingWithoutMemory) {
  ResponseCache cache(160000), none(0);
  EXPECT_EQ(cache.put(key(1), answer(20000)).body().size(), 20000u);
  EXPECT_FALSE(cache.find(key(1)));
  none.put(key(1), answer(1));
  EXPECT_FALSE(none.find(key(1)));
  EXPECT_EQ(none.n_bytes(), 0u);
}

TEST(ResponseCache, KeepsAnswersLargerThanASegment) {
  ResponseCache cache(std::size_t{70} << 20);
  const Bytes large(std::size_t{4} << 20, 5);
  AnswerParts parts = answer(0);
  parts.body = large;
  for (std::uint64_t k = 0; k < 20; ++k) cache.put(key(k), parts);
  EXPECT_TRUE(std::equal(large.begin(), large.end(), cache.find(key(19)).body().begin()));
  EXPECT_LE(cache.n_bytes(), cache.capacity_bytes());
}

TEST(ResponseCache, TellsKeysApart) {
  ResponseCache cache(std::size_t{1} << 20);
  const std::vector<CacheKey> keys = {{1, 2, 3}, {2, 1, 3}, {1, 3, 2}, {3, 2, 1}, {1, 2, 4}};
  for (std::size_t k = 0; k < keys.size(); ++k) cache.put(keys[k], answer(k));
  for (std::size_t k = 0; k < keys.size(); ++k) {
    const auto found = cache.find(keys[k]);
    ASSERT_TRUE(found);
    EXPECT_EQ(found.body().size(), k);
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
      cache.put(key(1), answer(1));
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
          EXPECT_EQ(found.body().size(), 500u);
          EXPECT_EQ(found.body().back(), 7u);
        } else {
          cache.put(wanted, answer(500));
        }
      }
    });
  }
  for (auto& thread : threads) thread.join();
}

}  // namespace
}  // namespace tind
