// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <memory>
#include <unordered_map>

#include "core/result.hpp"
#include "server/site.hpp"

namespace tind {

/// What one thread keeps from one request to the next: the site that it serves, and a read transaction for each dataset
/// asked for. Files are never written in place, so a transaction is begun once and views into the map stay valid as
/// long as the dataset is held: until the next begin_batch(). Belongs to one thread.
class WorkerState {
 public:
  /// `holder` must outlive the state.
  explicit WorkerState(const SiteHolder& holder) : holder_(holder) { begin_batch(); }

  /// Takes over a site that was swapped in meanwhile, and lets go of datasets that it has no more. To be called when no
  /// view into a dataset is in use: before a batch of requests, and now and then by an idle thread. One look at an
  /// atomic integer when nothing changed.
  void begin_batch();
  const Site& site() const { return *site_; }
  /// The thread's transaction on a dataset of site(). The pointer is good until the next begin_batch().
  Result<const TileStore::Snapshot*> snapshot(const std::shared_ptr<const Dataset>& dataset);

 private:
  struct OpenDataset {
    std::shared_ptr<const Dataset> dataset;
    TileStore::Snapshot snapshot;  // ends before the store that it reads
  };

  const SiteHolder& holder_;
  std::uint64_t version_ = 0;
  std::shared_ptr<const Site> site_;
  std::unordered_map<const Dataset*, OpenDataset> open_;
};

}  // namespace tind
