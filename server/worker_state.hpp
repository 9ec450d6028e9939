// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <unordered_map>

#include "core/result.hpp"
#include "server/negotiation.hpp"
#include "server/site.hpp"

namespace tind {

/// A tile's stored values, found in the memory map. Two lines of the processor's cache.
struct alignas(64) ResolvedTile {
  static constexpr std::size_t kValues = 9;

  std::uint64_t packed_key = 0;  ///< The tile's, packed().
  std::uint32_t dataset_id = 0;  ///< 0: of none.
  std::array<std::uint32_t, kValues> n_bytes{};
  std::uint64_t hash = 0;                              ///< Of the values.
  std::array<const std::uint8_t*, kValues> addresses;  ///< In the order of pieces_of().

  ByteView value(std::size_t k) const { return {addresses[k], n_bytes[k]}; }
};
static_assert(sizeof(ResolvedTile) == 128);

/// What one thread keeps from one request to the next: the site that it serves, a read transaction for each dataset
/// asked for, the tiles found lately, and scratch memory. Files are never written in place, so a transaction is begun
/// once and views into the map stay valid as long as the dataset is held: until the next begin_batch(). Belongs to one
/// thread.
class WorkerState {
 public:
  /// `holder` must outlive the state.
  explicit WorkerState(const SiteHolder& holder) : holder_(holder) { begin_batch(); }

  /// Takes over a site that was swapped in meanwhile, and lets go of datasets that it has no more. To be called when no
  /// view into a dataset is in use: before a batch of requests, and now and then by an idle thread. One look at an
  /// atomic integer when nothing changed.
  void begin_batch();
  /// Tells the time in seconds of any clock that goes forward, now and then: what was asked for longest ago is closed
  /// first.
  void set_time(std::int64_t now_s) { now_s_ = now_s; }
  const Site& site() const { return *site_; }
  /// Hands the requests counted by dataset() over to the slots; now and then.
  void hand_over_counts();
  std::size_t n_open_transactions() const { return open_.size(); }
  /// The dataset of that name, opened when it is not yet; nullptr: the site has none, or is_awaited(). Fails as its
  /// file does. The pointer is good until the next begin_batch().
  Result<const ServedDataset*> dataset(std::string_view name);
  /// Whether the last dataset() was nullptr because somebody looks at the file's pages first: to be asked for again in
  /// a batch of a later version.
  bool is_awaited() const { return is_awaited_; }
  /// SiteHolder::version() of the batch.
  std::uint64_t version() const { return version_; }
  std::uint64_t newest_version() const { return holder_.version(); }
  /// The thread's transaction on a dataset that dataset() gave, or on a base of it. Good until the next begin_batch().
  Result<const TileStore::Snapshot*> snapshot(const std::shared_ptr<const Dataset>& dataset);
  /// A tile of such a dataset. nullptr: not stored. kCorrupt: a piece is missing. The pointer is good until the
  /// next call, the views in it until the next begin_batch().
  Result<const ResolvedTile*> resolve(const std::shared_ptr<const Dataset>& dataset, const TileKey& key);

  /// choose_coding and wants_normals of a field's text; clients say the same thing again and again.
  Coding coding_for(std::optional<std::string_view> accept_encoding);
  bool normals_for(std::optional<std::string_view> accept);

  std::string target_scratch;  ///< For parse_target.

 private:
  // Places for tiles, in sets of a few that one address may go to, the latest first; made when first wanted.
  static constexpr std::size_t kSetSize = 4, kSetsPerChunk = 128, kChunks = 64;  // 32,768 tiles, 4 MB
  using TileSet = std::array<ResolvedTile, kSetSize>;

  struct OpenDataset {
    std::shared_ptr<const Dataset> dataset;
    TileStore::Snapshot snapshot;  // ends before the store that it reads
  };
  struct NamedDataset {
    DatasetSlot* slot;
    std::shared_ptr<const ServedDataset> served;
    std::uint64_t n_requests = 0;  // not handed over yet
  };
  template <class T>
  struct Remembered {
    std::string text;
    T value{};
  };

  const SiteHolder& holder_;
  std::uint64_t version_ = 0;
  std::shared_ptr<const Site> site_;
  std::int64_t now_s_ = 0;
  bool is_awaited_ = false;
  std::unordered_map<std::string_view, NamedDataset> named_;  // names are the slots'
  std::unordered_map<const Dataset*, OpenDataset> open_;
  std::array<std::unique_ptr<std::array<TileSet, kSetsPerChunk>>, kChunks> table_;  // by hash of dataset and key
  Remembered<Coding> coding_;
  Remembered<bool> normals_;
};

}  // namespace tind
