// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/worker_state.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <unordered_set>

#include "storage/value_hash.hpp"

namespace tind {
namespace {

// Of the values' hashes: bytes that only move from one piece to the next make another tile.
std::uint64_t hash_of(const std::array<ByteView, ResolvedTile::kValues>& values) {
  std::array<std::uint64_t, ResolvedTile::kValues> hashes;
  for (std::size_t k = 0; k < values.size(); ++k) hashes[k] = value_hash(values[k]);
  return value_hash({reinterpret_cast<const std::uint8_t*>(hashes.data()), sizeof hashes});
}

}  // namespace

void WorkerState::begin_batch() {
  if (site_ && version_ == holder_.version()) return;
  version_ = holder_.version();  // read first: a swap in between is seen by the next batch
  hand_over_counts();
  std::erase_if(named_, [&](const auto& entry) { return entry.second.slot->if_open() != entry.second.served; });
  const auto before = std::move(site_);  // holds the names of named_ until it is sorted out
  site_ = holder_.current();
  std::erase_if(named_, [&](const auto& entry) { return site_->find(entry.first) != entry.second.slot; });
  std::unordered_set<const Dataset*> wanted;
  for (const auto& [name, named] : named_) {
    for (const ServedDataset* served = named.served.get(); served; served = served->base.get()) {
      wanted.insert(served->dataset.get());
    }
  }
  std::erase_if(open_, [&](const auto& entry) { return !wanted.contains(entry.first); });
}

Result<const ServedDataset*> WorkerState::dataset(std::string_view name) {
  auto found = named_.find(name);
  if (found == named_.end()) {
    DatasetSlot* slot = site_->find(name);
    is_awaited_ = slot && slot->awaits_look();
    if (!slot || is_awaited_) return nullptr;
    auto served = slot->open();
    if (!served) return tl::unexpected(served.error());
    found = named_.emplace(slot->source().name, NamedDataset{slot, std::move(*served)}).first;
  }
  ++found->second.n_requests;
  found->second.slot->touch(now_s_);
  return found->second.served.get();
}

void WorkerState::hand_over_counts() {
  for (auto& [name, named] : named_) {
    if (named.n_requests > 0) named.slot->count_requests(named.n_requests);
    named.n_requests = 0;
  }
}

Result<const TileStore::Snapshot*> WorkerState::snapshot(const std::shared_ptr<const Dataset>& dataset) {
  if (const auto found = open_.find(dataset.get()); found != open_.end()) return &found->second.snapshot;
  auto snapshot = dataset->store.snapshot();
  if (!snapshot) return tl::unexpected(snapshot.error());
  const auto placed = open_.emplace(dataset.get(), OpenDataset{dataset, std::move(*snapshot)});
  return &placed.first->second.snapshot;
}

Result<const ResolvedTile*> WorkerState::resolve(const std::shared_ptr<const Dataset>& dataset, const TileKey& key) {
  const std::uint64_t packed_key = packed(key);
  const std::uint64_t product = (packed_key + dataset->id) * 0x9e3779b97f4a7c15u;
  const std::uint64_t mixed = product ^ (product >> 32);
  auto& chunk = table_[mixed % kChunks];
  if (!chunk) chunk = std::make_unique<std::array<TileSet, kSetsPerChunk>>();
  TileSet& set = (*chunk)[mixed / kChunks % kSetsPerChunk];
  for (const ResolvedTile& tile : set) {
    if (tile.packed_key == packed_key && tile.dataset_id == dataset->id) return &tile;
  }
  const auto opened = snapshot(dataset);
  if (!opened) return tl::unexpected(opened.error());
  std::array<ByteView, ResolvedTile::kValues> values;
  if (!(*opened)->find_tile(key, values)) return nullptr;
  ResolvedTile tile;
  tile.packed_key = packed_key;
  tile.dataset_id = dataset->id;
  tile.hash = hash_of(values);
  for (std::size_t k = 0; k < values.size(); ++k) {
    if (values[k].empty()) {
      return fail(ErrorKind::kCorrupt,
                  fmt::format("{} {}/{}/{}: a piece is missing", dataset->name, key.level, key.x, key.y));
    }
    tile.addresses[k] = values[k].data();
    tile.n_bytes[k] = static_cast<std::uint32_t>(values[k].size());  // LMDB's lengths have 32 bits
  }
  std::move_backward(set.begin(), set.end() - 1, set.end());
  set[0] = tile;
  return &set[0];
}

Coding WorkerState::coding_for(std::optional<std::string_view> accept_encoding) {
  if (!accept_encoding) return choose_coding(accept_encoding);
  if (coding_.text != *accept_encoding) coding_ = {std::string(*accept_encoding), choose_coding(accept_encoding)};
  return coding_.value;
}

bool WorkerState::normals_for(std::optional<std::string_view> accept) {
  if (!accept) return false;
  if (normals_.text != *accept) normals_ = {std::string(*accept), wants_normals(accept, std::nullopt)};
  return normals_.value;
}

}  // namespace tind
