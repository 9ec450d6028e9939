// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <map>
#include <optional>
#include <string>

#include "core/piece_key.hpp"
#include "core/result.hpp"
#include "storage/builder/earlier_pyramid.hpp"
#include "storage/content_hash.hpp"
#include "storage/store_patch.hpp"
#include "storage/tile_store.hpp"

namespace tind {

/// The pieces of an earlier pyramid with new values for some, on their way into a file. One thread.
class PatchedPieces {
 public:
  /// Begins to copy the earlier file beside `path`, where the new one will be. `earlier` must outlive it.
  PatchedPieces(const EarlierPyramid& earlier, const std::string& path);

  /// A new value of a piece that the earlier pyramid has.
  void replace(const PieceKey& key, Bytes value) { values_[key] = std::move(value); }
  /// The new value; nullopt: it has none.
  std::optional<ByteView> find(const PieceKey& key) const;
  /// Calls visit(key, value) -> Result<void> for all pieces in storage order, until one fails.
  template <class Visit>
  Result<void> for_all(Visit visit) const;

  /// Stores all pieces and the manifest at the writer's path and syncs: as a copy that is changed in places, or, where
  /// that cannot be, by the writer; the bytes are the same. True: it is such a copy. `cancel` may be null. kIo,
  /// kCorrupt, kInterrupted.
  Result<bool> store(ByteView manifest_value, TileStoreWriter& writer, const std::atomic<bool>* cancel);

 private:
  const EarlierPyramid& earlier_;
  std::map<PieceKey, Bytes> values_;
  std::optional<StorePatch> copy_;
};

template <class Visit>
Result<void> PatchedPieces::for_all(Visit visit) const {
  TileStore::Cursor cursor(earlier_.snapshot);
  for (;;) {
    const auto piece = cursor.next();
    if (!piece) return tl::unexpected(piece.error());
    if (!*piece) return {};
    if (auto done = visit((*piece)->key, find((*piece)->key).value_or((*piece)->value)); !done) return done;
  }
}

}  // namespace tind
