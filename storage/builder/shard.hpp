// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <vector>

#include "core/tile_key.hpp"
#include "storage/builder/plan.hpp"

namespace tind {

/// The tiles of one of several parts of a pyramid that are built apart and merged: a range of the tiles of a cut level
/// in Morton order with all that is below, and every tile above the cut. Ranges have about the same number of bottom
/// tiles.
class ShardTiles {
 public:
  /// 0 <= index < count. The cut level is the coarsest with at least four tiles a shard.
  ShardTiles(const TilePlan& plan, int index, int count);

  int cut_level() const { return cut_level_; }
  bool has(const TileKey& key) const;
  /// `tiles`, those of one level, less what other shards have.
  std::vector<TileKey> filter(const std::vector<TileKey>& tiles) const;

 private:
  int cut_level_ = 0;
  std::uint64_t first_ = 0, end_ = 0;  // Morton codes at the cut level
};

}  // namespace tind
