// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/response_cache.hpp"

#include <algorithm>
#include <new>

namespace tind {
namespace {

constexpr std::size_t kFewestSegments = 16;  // of a full cache: what goes at once is small against it
constexpr std::size_t kFewestSlots = 16;

std::uint64_t hash_of(const CacheKey& key) {
  // Multiplies by odd constants and folds the well mixed upper bits down.
  std::uint64_t h = (key.source ^ (std::uint64_t{key.representation} << 56)) * 0x9e3779b97f4a7c15u;
  h = (h ^ (h >> 32) ^ key.tile) * 0xd6e8feb86659fd93u;
  return h ^ (h >> 32);
}

std::size_t whole_pages(std::size_t n_bytes) {
  return (n_bytes + CacheSegment::kPageBytes - 1) / CacheSegment::kPageBytes * CacheSegment::kPageBytes;
}

// Precondition: the cache has the block's segment and cannot let go of it now.
CachedResponse kept(const CacheBlock& block) { return {block, block.segment->shared_from_this()}; }

}  // namespace

ResponseCache::Shard::Slot* ResponseCache::Shard::find(std::uint64_t hash, const CacheKey& key) {
  if (slots.empty()) return nullptr;
  const std::size_t mask = slots.size() - 1;
  for (std::size_t at = hash & mask; slots[at].block; at = (at + 1) & mask) {
    if (slots[at].hash == hash && slots[at].block->key == key) return &slots[at];
  }
  return nullptr;
}

void ResponseCache::Shard::place(std::uint64_t hash, CacheBlock& block) {
  const std::size_t mask = slots.size() - 1;
  std::size_t at = hash & mask;
  while (slots[at].block) at = (at + 1) & mask;
  slots[at] = {hash, &block};
}

// Precondition: nothing of that key is there.
void ResponseCache::Shard::insert(std::uint64_t hash, CacheBlock& block) {
  if ((n_taken + 1) * 2 > slots.size()) {
    const std::vector<Slot> before = std::exchange(slots, std::vector<Slot>(std::max(slots.size() * 2, kFewestSlots)));
    for (const Slot& slot : before) {
      if (slot.block) place(slot.hash, *slot.block);
    }
  }
  place(hash, block);
  ++n_taken;
}

// Those behind it move up where they may, so that a search meets no gap before what it looks for.
void ResponseCache::Shard::erase(Slot& slot) {
  const std::size_t mask = slots.size() - 1;
  auto gap = static_cast<std::size_t>(&slot - slots.data());
  for (std::size_t at = (gap + 1) & mask; slots[at].block; at = (at + 1) & mask) {
    const std::size_t home = slots[at].hash & mask;
    if (((at - home) & mask) < ((at - gap) & mask)) continue;  // its home is behind the gap
    slots[gap] = slots[at];
    gap = at;
  }
  slots[gap] = {};
  --n_taken;
}

ResponseCache::ResponseCache(std::size_t capacity_bytes)
    : capacity_bytes_(capacity_bytes),
      segment_bytes_(std::min(capacity_bytes / kFewestSegments / CacheSegment::kPageBytes * CacheSegment::kPageBytes,
                              CacheSegment::kHugePageBytes)) {}

CachedResponse ResponseCache::find(const CacheKey& key) {
  const std::uint64_t hash = hash_of(key);
  Shard& shard = shard_of(hash);
  const std::lock_guard lock(shard.mutex);
  const auto* const slot = shard.find(hash, key);
  if (!slot) return {};
  ++shard.n_hits;
  const CacheBlock& block = *slot->block;
  if (!block.used.load(std::memory_order_relaxed)) block.used.store(true, std::memory_order_relaxed);
  return kept(block);
}

CachedResponse ResponseCache::put(const CacheKey& key, const AnswerParts& parts) {
  const std::uint64_t hash = hash_of(key);
  Shard& shard = shard_of(hash);
  const std::lock_guard segments_lock(segments_mutex_);
  {
    const std::lock_guard lock(shard.mutex);
    ++shard.n_puts;
    if (const auto* const slot = shard.find(hash, key)) return kept(*slot->block);  // another thread's, the same bytes
  }
  CacheSegment* const segment = segment_with_room(CacheBlock::bytes_for(parts));
  if (!segment) {
    const std::shared_ptr<void> memory(::operator new(CacheBlock::bytes_for(parts)),
                                       [](void* p) { ::operator delete(p); });
    return {CacheBlock::make(memory.get(), key, parts, nullptr), memory};
  }
  CacheBlock& block = segment->add(key, parts);
  CachedResponse response = kept(block);
  {
    const std::lock_guard lock(shard.mutex);
    index_bytes_ -= shard.slots.size() * sizeof(Shard::Slot);
    shard.insert(hash, block);
    index_bytes_ += shard.slots.size() * sizeof(Shard::Slot);
  }
  while (exceeds(0) && segments_.size() > 1) forget(*take_oldest(), nullptr, 0);  // the index grew
  return response;
}

// The segment being filled, or a new one in the place of the oldest. nullptr: too large to be kept, or no memory.
CacheSegment* ResponseCache::segment_with_room(std::size_t n_bytes) {
  if (!segments_.empty() && segments_.back()->n_free() >= n_bytes) return segments_.back().get();
  const std::size_t wanted = std::max(segment_bytes_, whole_pages(n_bytes));
  if (wanted > capacity_bytes_ / kFewestSegments) return nullptr;
  Segments forgotten;
  while (!segments_.empty() && exceeds(wanted)) forgotten.push_back(take_oldest());
  const auto segment = CacheSegment::make(wanted);
  std::size_t room = segment ? std::min(wanted / 2, wanted - n_bytes) : 0;
  for (const auto& old : forgotten) room = forget(*old, segment.get(), room);
  if (!segment) return nullptr;
  segments_.push_back(segment);
  segments_bytes_ += wanted;
  return segment.get();
}

std::shared_ptr<CacheSegment> ResponseCache::take_oldest() {
  std::shared_ptr<CacheSegment> oldest = std::move(segments_.front());
  segments_.pop_front();
  segments_bytes_ -= oldest->n_bytes();
  return oldest;
}

// Takes the segment's answers out of the index, or moves those used as far as there is room. What room is left.
std::size_t ResponseCache::forget(const CacheSegment& segment, CacheSegment* rescue_to, std::size_t room_bytes) {
  segment.for_each_block([&](const CacheBlock& block) {
    const std::uint64_t hash = hash_of(block.key);
    Shard& shard = shard_of(hash);
    const std::lock_guard lock(shard.mutex);
    auto* const slot = shard.find(hash, block.key);
    if (!slot || slot->block != &block) return;
    if (block.used.load(std::memory_order_relaxed) && block.n_bytes() <= room_bytes) {
      slot->block = &rescue_to->add(block.key, block.parts());
      room_bytes -= block.n_bytes();
    } else {
      shard.erase(*slot);
    }
  });
  return room_bytes;
}

std::unique_lock<std::mutex> ResponseCache::lock_making(const CacheKey& key) {
  return std::unique_lock(makers_[hash_of(key) >> 16 & (kMakers - 1)]);
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
  const std::lock_guard lock(segments_mutex_);
  return segments_bytes_ + index_bytes_;
}

}  // namespace tind
