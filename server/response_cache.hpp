// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <string_view>
#include <utility>
#include <vector>

#include "server/cache_segment.hpp"

namespace tind {

/// A finished answer that stays where it is as long as somebody has the owner; or none.
class CachedResponse {
 public:
  CachedResponse() = default;
  CachedResponse(const CacheBlock& block, std::shared_ptr<const void> owner)
      : block_(&block), owner_(std::move(owner)) {}

  explicit operator bool() const { return block_ != nullptr; }
  std::string_view fields() const { return {block_->text(), block_->n_fields}; }
  std::string_view validator_fields() const { return block_->parts().validator_fields; }
  std::string_view etag() const { return block_->parts().etag; }
  ByteView body() const { return block_->parts().body; }
  Coding coding() const { return block_->coding; }
  /// Hands over what holds the memory of all views.
  std::shared_ptr<const void> take_owner() { return std::move(owner_); }

 private:
  const CacheBlock* block_ = nullptr;
  std::shared_ptr<const void> owner_;
};

/// Finished answers, bounded in bytes. They lie in segments one behind the other. When there is no room, the oldest
/// segment goes, but for what was asked for since it came there, as far as half a segment holds it. The index is
/// sharded by key, so that threads seldom meet. Thread safe.
class ResponseCache {
 public:
  explicit ResponseCache(std::size_t capacity_bytes);

  /// None when absent. Takes no memory.
  CachedResponse find(const CacheKey& key);
  /// The answer in one piece: kept, unless it is larger than a sixteenth of the cache or the system has no memory.
  CachedResponse put(const CacheKey& key, const AnswerParts& parts);
  /// To be held while the value of `key` is made, and find() asked again under it: several threads that miss one key
  /// make its value once. Now and then threads with different keys wait for each other, too.
  std::unique_lock<std::mutex> lock_making(const CacheKey& key);

  std::size_t capacity_bytes() const { return capacity_bytes_; }
  /// Bytes in use, bookkeeping included.
  std::size_t n_bytes() const;
  struct Counts {
    std::uint64_t n_hits = 0, n_puts = 0;  ///< Answers found, and made.
  };
  Counts counts() const;

 private:
  static constexpr std::size_t kShards = 16;
  static constexpr std::size_t kMakers = 64;
  // Open addressing with linear probing: a look-up reads a line of the processor's cache here, and then the answer's.
  struct Shard {
    struct Slot {
      std::uint64_t hash = 0;
      CacheBlock* block = nullptr;  // nullptr: free
    };
    mutable std::mutex mutex;
    std::vector<Slot> slots;  // a power of two of them, or none; at most half of them taken
    std::size_t n_taken = 0;
    std::uint64_t n_hits = 0, n_puts = 0;

    Slot* find(std::uint64_t hash, const CacheKey& key);
    void insert(std::uint64_t hash, CacheBlock& block);
    void erase(Slot& slot);
    void place(std::uint64_t hash, CacheBlock& block);
  };
  using Segments = std::deque<std::shared_ptr<CacheSegment>>;

  Shard& shard_of(std::uint64_t hash) { return shards_[hash >> 60]; }
  CacheSegment* segment_with_room(std::size_t n_bytes);
  bool exceeds(std::size_t more_bytes) const { return segments_bytes_ + index_bytes_ + more_bytes > capacity_bytes_; }
  std::shared_ptr<CacheSegment> take_oldest();
  std::size_t forget(const CacheSegment& segment, CacheSegment* rescue_to, std::size_t room_bytes);

  const std::size_t capacity_bytes_, segment_bytes_;
  std::array<Shard, kShards> shards_;
  std::array<std::mutex, kMakers> makers_;
  mutable std::mutex segments_mutex_;  // of all below; taken before a shard's, never after
  Segments segments_;                  // oldest first; the last one is being filled
  std::size_t segments_bytes_ = 0, index_bytes_ = 0;
};

}  // namespace tind
