// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/response_cache.hpp"

#include <utility>

namespace tind {
namespace {

constexpr std::size_t kEntryOverheadBytes = 320;  // list and hash nodes, the value's own objects and their heap blocks

std::size_t cost(const CachedResponse& value) {
  return value.body.bytes.size() + value.etag.size() + value.validators.size() + value.content_fields.size() +
         kEntryOverheadBytes;
}

}  // namespace

std::size_t ResponseCache::KeyHash::operator()(const CacheKey& key) const {
  // Multiplies by odd constants and folds the well mixed upper bits down.
  std::uint64_t h = (key.source ^ (std::uint64_t{key.representation} << 56)) * 0x9e3779b97f4a7c15u;
  h = (h ^ (h >> 32) ^ key.tile) * 0xd6e8feb86659fd93u;
  return static_cast<std::size_t>(h ^ (h >> 32));
}

std::shared_ptr<const CachedResponse> ResponseCache::find(const CacheKey& key) {
  Shard& shard = shard_of(key);
  const std::lock_guard lock(shard.mutex);
  const auto found = shard.index.find(key);
  if (found == shard.index.end()) return nullptr;
  // Moving an entry touches its neighbours, so it is done only after many others came in before it.
  const auto entry = found->second;
  if (shard.n_puts - entry->moved_at > shard.index.size() / 8) {
    entry->moved_at = shard.n_puts;
    shard.entries.splice(shard.entries.begin(), shard.entries, entry);
  }
  return entry->value;
}

void ResponseCache::put(const CacheKey& key, std::shared_ptr<const CachedResponse> value) {
  const std::size_t bytes = cost(*value);
  if (bytes > shard_capacity_) return;
  Shard& shard = shard_of(key);
  const std::lock_guard lock(shard.mutex);
  if (shard.index.contains(key)) return;  // another thread was faster, with the same bytes
  shard.entries.push_front({key, std::move(value), ++shard.n_puts});
  shard.index.emplace(key, shard.entries.begin());
  shard.bytes += bytes;
  while (shard.bytes > shard_capacity_) {
    const Entry& last = shard.entries.back();
    shard.bytes -= cost(*last.value);
    shard.index.erase(last.key);
    shard.entries.pop_back();
  }
}

std::unique_lock<std::mutex> ResponseCache::lock_making(const CacheKey& key) {
  return std::unique_lock(makers_[KeyHash{}(key) >> 16 & (kMakers - 1)]);
}

std::size_t ResponseCache::n_bytes() const {
  std::size_t bytes = 0;
  for (const Shard& shard : shards_) {
    const std::lock_guard lock(shard.mutex);
    bytes += shard.bytes;
  }
  return bytes;
}

}  // namespace tind
