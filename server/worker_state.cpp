// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/worker_state.hpp"

namespace tind {

void WorkerState::begin_batch() {
  if (site_ && version_ == holder_.version()) return;
  version_ = holder_.version();  // read first: a swap in between is seen by the next batch
  site_ = holder_.current();
  std::erase_if(open_, [&](const auto& entry) {
    const ServedDataset* now = site_->find(entry.second.dataset->name);
    return !now || now->dataset != entry.second.dataset;
  });
}

Result<const TileStore::Snapshot*> WorkerState::snapshot(const std::shared_ptr<const Dataset>& dataset) {
  if (const auto found = open_.find(dataset.get()); found != open_.end()) return &found->second.snapshot;
  auto snapshot = dataset->store.snapshot();
  if (!snapshot) return tl::unexpected(snapshot.error());
  const auto placed = open_.emplace(dataset.get(), OpenDataset{dataset, std::move(*snapshot)});
  return &placed.first->second.snapshot;
}

}  // namespace tind
