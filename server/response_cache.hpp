// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstddef>
#include <list>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <unordered_map>

#include "server/content_coding.hpp"

namespace tind {

/// Finished answers, least recently used first out, bounded in bytes. Sharded by key, so that threads seldom meet.
/// Thread safe; values live as long as somebody holds them.
class ResponseCache {
 public:
  explicit ResponseCache(std::size_t capacity_bytes) : shard_capacity_(capacity_bytes / kShards) {}

  /// nullptr when absent.
  std::shared_ptr<const Coded> find(const std::string& key);
  /// Keeps the value unless it alone is larger than a shard.
  void put(const std::string& key, std::shared_ptr<const Coded> value);

 private:
  static constexpr std::size_t kShards = 8;
  struct Entry {
    std::string key;
    std::shared_ptr<const Coded> value;
  };
  struct Shard {
    std::mutex mutex;
    std::list<Entry> entries;                                                // most recently used first
    std::unordered_map<std::string_view, std::list<Entry>::iterator> index;  // keys live in the entries
    std::size_t bytes = 0;
  };
  Shard& shard_of(const std::string& key) { return shards_[std::hash<std::string>{}(key) % kShards]; }

  std::size_t shard_capacity_;
  std::array<Shard, kShards> shards_;
};

}  // namespace tind
