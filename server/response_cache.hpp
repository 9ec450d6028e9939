// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string_view>
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

/// A finished answer: everything of it that does not depend on who asks, in one piece of memory.
class CachedResponse {
 public:
  /// `content_fields`: header lines of a 200 only; `validator_fields`: those that a 304 has, too, with `etag` in them.
  CachedResponse(std::string_view content_fields, std::string_view validator_fields, std::string_view etag,
                 const Coded& body);

  std::string_view fields() const { return text(0, n_fields_); }
  std::string_view validator_fields() const { return text(n_content_, n_fields_ - n_content_); }
  std::string_view etag() const { return text(etag_at_, n_etag_); }
  ByteView body() const { return ByteView(bytes_).subspan(n_fields_); }
  Coding coding() const { return coding_; }
  std::size_t n_bytes() const { return bytes_.size(); }

 private:
  std::string_view text(std::size_t at, std::size_t n) const {
    return {reinterpret_cast<const char*>(bytes_.data()) + at, n};
  }

  std::uint32_t n_content_, n_fields_, etag_at_, n_etag_;
  Coding coding_;
  Bytes bytes_;  // content fields, validator fields, body
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
  struct Counts {
    std::uint64_t n_hits = 0, n_puts = 0;  ///< Values found, and values made and kept.
  };
  Counts counts() const;

 private:
  static constexpr std::size_t kShards = 16;
  static constexpr std::size_t kMakers = 64;
  struct KeyHash {
    std::size_t operator()(const CacheKey& key) const;
  };
  struct Entry {
    std::shared_ptr<const CachedResponse> value;
    std::uint64_t moved_at = 0;  // Shard::n_puts when it was put in front
    CacheKey key;
    Entry* before = nullptr;  // neighbours in the order of use
    Entry* after = nullptr;
  };
  struct Shard {
    mutable std::mutex mutex;
    std::unordered_map<CacheKey, Entry, KeyHash> index;
    Entry order;  // between its last and its first: roughly the most recently used first
    std::size_t bytes = 0;
    std::uint64_t n_puts = 0, n_hits = 0;
    Shard() { order.before = order.after = &order; }
    void unlink(Entry& entry);
    void put_first(Entry& entry);
  };
  Shard& shard_of(const CacheKey& key) { return shards_[KeyHash{}(key) >> 8 & (kShards - 1)]; }

  std::size_t shard_capacity_;
  std::array<Shard, kShards> shards_;
  std::array<std::mutex, kMakers> makers_;
};

}  // namespace tind
