// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "storage/builder/tile_digest.hpp"
#include "storage/builder/tile_maker.hpp"
#include "storage/tile_store.hpp"

namespace tind {

/// The tiles of an earlier pyramid beside today's posts. Reads what it is given, which must outlive it. One thread.
class EarlierTiles {
 public:
  EarlierTiles(const TileStore::Snapshot& earlier, const PostDigests& posts, int bottom_level)
      : earlier_(earlier), posts_(posts), bottom_level_(bottom_level) {}

  /// Body and inputs record, `changed` left empty; nullopt: not both are there.
  std::optional<StoredTile> find(const TileKey& key) const;
  /// The finest descendants of a tile, or it itself, that have between them all of its posts that changed, as the
  /// inputs records tell; a part without records counts as changed. nullopt: more than `most`.
  std::optional<std::vector<TileKey>> changed_below(const TileKey& key, std::size_t most) const;

 private:
  bool descend(const TileKey& tile, std::size_t most, std::vector<TileKey>& changed) const;

  const TileStore::Snapshot& earlier_;
  const PostDigests& posts_;
  const int bottom_level_;
};

}  // namespace tind
