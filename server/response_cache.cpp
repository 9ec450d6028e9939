// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/response_cache.hpp"

#include <utility>

namespace tind {
namespace {

constexpr std::size_t kEntryOverheadBytes = 200;  // list and hash nodes, the key twice

std::size_t cost(const std::string& key, const Coded& value) {
  return value.bytes.size() + key.size() + kEntryOverheadBytes;
}

}  // namespace

std::shared_ptr<const Coded> ResponseCache::find(const std::string& key) {
  Shard& shard = shard_of(key);
  const std::lock_guard lock(shard.mutex);
  const auto found = shard.index.find(key);
  if (found == shard.index.end()) return nullptr;
  shard.entries.splice(shard.entries.begin(), shard.entries, found->second);
  return found->second->value;
}

void ResponseCache::put(const std::string& key, std::shared_ptr<const Coded> value) {
  const std::size_t bytes = cost(key, *value);
  if (bytes > shard_capacity_) return;
  Shard& shard = shard_of(key);
  const std::lock_guard lock(shard.mutex);
  if (shard.index.contains(key)) return;  // another thread was faster, with the same bytes
  shard.entries.push_front({key, std::move(value)});
  shard.index.emplace(shard.entries.front().key, shard.entries.begin());
  shard.bytes += bytes;
  while (shard.bytes > shard_capacity_) {
    const Entry& last = shard.entries.back();
    shard.bytes -= cost(last.key, *last.value);
    shard.index.erase(last.key);
    shard.entries.pop_back();
  }
}

}  // namespace tind
