// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <list>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_map>

#include "server/content_coding.hpp"

namespace tind {

/// What a finished answer is of.
struct CacheKey {
  std::uint64_t source = 0;          ///< The dataset's id, or a hash that stands for a document or file.
  std::uint64_t tile = 0;            ///< Level, x and y in one number; 0 for documents.
  std::uint32_t representation = 0;  ///< Format and coding.
  friend bool operator==(const CacheKey&, const CacheKey&) = default;
};

/// A finished answer: everything of it that does not depend on who asks.
struct CachedResponse {
  std::string etag;            ///< With its quotes.
  std::string validators;      ///< Header lines that a 304 has, too.
  std::string content_fields;  ///< Header lines of a 200 only.
  Coded body;
};

/// Finished answers, bounded in bytes; what was not used for long goes first. Sharded by key, so that threads seldom
/// meet. Thread safe; values live as long as somebody holds them.
class ResponseCache {
 public:
  explicit ResponseCache(std::size_t capacity_bytes) : shard_capacity_(capacity_bytes / kShards) {}

  /// nullptr when absent. Takes no memory.
  std::shared_ptr<const CachedResponse> find(const CacheKey& key);
  /// Keeps the value unless it alone is larger than a shard.
  void put(const CacheKey& key, std::shared_ptr<const CachedResponse> value);
  /// To be held while the value of `key` is made, and find() asked again under it: several threads that miss one key
  /// make its value once. Now and then threads with different keys wait for each other, too.
  std::unique_lock<std::mutex> lock_making(const CacheKey& key);

  std::size_t capacity_bytes() const { return shard_capacity_ * kShards; }
  /// Bytes in use, bookkeeping included.
  std::size_t n_bytes() const;

 private:
  static constexpr std::size_t kShards = 16;
  static constexpr std::size_t kMakers = 64;
  struct KeyHash {
    std::size_t operator()(const CacheKey& key) const;
  };
  struct Entry {
    CacheKey key;
    std::shared_ptr<const CachedResponse> value;
    std::uint64_t moved_at = 0;  // Shard::n_puts when it was put in front
  };
  struct Shard {
    mutable std::mutex mutex;
    std::list<Entry> entries;  // roughly the most recently used first
    std::unordered_map<CacheKey, std::list<Entry>::iterator, KeyHash> index;
    std::size_t bytes = 0;
    std::uint64_t n_puts = 0;
  };
  Shard& shard_of(const CacheKey& key) { return shards_[KeyHash{}(key) >> 8 & (kShards - 1)]; }

  std::size_t shard_capacity_;
  std::array<Shard, kShards> shards_;
  std::array<std::mutex, kMakers> makers_;
};

}  // namespace tind
