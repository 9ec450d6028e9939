// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/response_cache.hpp"

#include <algorithm>
#include <cassert>
#include <utility>

namespace tind {
namespace {

constexpr std::size_t kEntryOverheadBytes = 256;  // hash node and bucket, the value's own object and block

std::size_t cost(const CachedResponse& value) { return value.n_bytes() + kEntryOverheadBytes; }

}  // namespace

CachedResponse::CachedResponse(std::string_view content_fields, std::string_view validator_fields,
                               std::string_view etag, const Coded& body)
    : n_content_(static_cast<std::uint32_t>(content_fields.size())),
      n_fields_(static_cast<std::uint32_t>(content_fields.size() + validator_fields.size())),
      etag_at_(n_content_ + static_cast<std::uint32_t>(std::min(validator_fields.find(etag), validator_fields.size()))),
      n_etag_(static_cast<std::uint32_t>(etag.size())),
      coding_(body.coding) {
  assert(validator_fields.find(etag) != validator_fields.npos);
  bytes_.reserve(n_fields_ + body.bytes.size());
  bytes_.insert(bytes_.end(), content_fields.begin(), content_fields.end());
  bytes_.insert(bytes_.end(), validator_fields.begin(), validator_fields.end());
  bytes_.insert(bytes_.end(), body.bytes.begin(), body.bytes.end());
}

std::size_t ResponseCache::KeyHash::operator()(const CacheKey& key) const {
  // Multiplies by odd constants and folds the well mixed upper bits down.
  std::uint64_t h = (key.source ^ (std::uint64_t{key.representation} << 56)) * 0x9e3779b97f4a7c15u;
  h = (h ^ (h >> 32) ^ key.tile) * 0xd6e8feb86659fd93u;
  return static_cast<std::size_t>(h ^ (h >> 32));
}

void ResponseCache::Shard::unlink(Entry& entry) {
  entry.before->after = entry.after;
  entry.after->before = entry.before;
}

void ResponseCache::Shard::put_first(Entry& entry) {
  entry.moved_at = n_puts;
  entry.before = &order;
  entry.after = order.after;
  order.after->before = &entry;
  order.after = &entry;
}

std::shared_ptr<const CachedResponse> ResponseCache::find(const CacheKey& key) {
  Shard& shard = shard_of(key);
  const std::lock_guard lock(shard.mutex);
  const auto found = shard.index.find(key);
  if (found == shard.index.end()) return nullptr;
  ++shard.n_hits;
  // Moving an entry touches its neighbours, so it is done only after many others came in before it.
  Entry& entry = found->second;
  if (shard.n_puts - entry.moved_at > shard.index.size() / 8) {
    shard.unlink(entry);
    shard.put_first(entry);
  }
  return entry.value;
}

void ResponseCache::put(const CacheKey& key, std::shared_ptr<const CachedResponse> value) {
  const std::size_t bytes = cost(*value);
  if (bytes > shard_capacity_) return;
  Shard& shard = shard_of(key);
  const std::lock_guard lock(shard.mutex);
  const auto [place, is_new] = shard.index.try_emplace(key);
  if (!is_new) return;  // another thread was faster, with the same bytes
  Entry& entry = place->second;
  entry.value = std::move(value);
  entry.key = key;
  ++shard.n_puts;
  shard.put_first(entry);
  shard.bytes += bytes;
  while (shard.bytes > shard_capacity_) {
    Entry& last = *shard.order.before;
    shard.bytes -= cost(*last.value);
    shard.unlink(last);
    shard.index.erase(CacheKey(last.key));
  }
}

std::unique_lock<std::mutex> ResponseCache::lock_making(const CacheKey& key) {
  return std::unique_lock(makers_[KeyHash{}(key) >> 16 & (kMakers - 1)]);
}

ResponseCache::Counts ResponseCache::counts() const {
  Counts counts;
  for (const Shard& shard : shards_) {
    const std::lock_guard lock(shard.mutex);
    counts.n_hits += shard.n_hits;
    counts.n_puts += shard.n_puts;
  }
  return counts;
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
