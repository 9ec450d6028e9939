// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/earlier_tiles.hpp"

#include "core/piece_key.hpp"
#include "storage/inputs_blob.hpp"

namespace tind {

std::optional<StoredTile> EarlierTiles::find(const TileKey& key) const {
  const auto body = earlier_.find({PieceKind::kBody, key.level, key.x, key.y});
  const auto inputs = earlier_.find({PieceKind::kInputs, key.level, key.x, key.y});
  if (!body || !inputs) return std::nullopt;
  return StoredTile{*body, *inputs, {}};
}

std::optional<std::vector<TileKey>> EarlierTiles::changed_below(const TileKey& key, std::size_t most) const {
  std::vector<TileKey> changed;
  if (!descend(key, most, changed)) return std::nullopt;
  return changed;
}

bool EarlierTiles::descend(const TileKey& tile, std::size_t most, std::vector<TileKey>& changed) const {
  const auto record = earlier_.find({PieceKind::kInputs, tile.level, tile.x, tile.y});
  const auto made_of = record ? decode_inputs_head(*record) : fail(ErrorKind::kNotFound, "");
  if (made_of && made_of->posts == posts_.of(tile)) return true;
  if (!made_of || tile.level == bottom_level_) {
    changed.push_back(tile);
    return changed.size() <= most;
  }
  for (int c = 0; c < 4; ++c) {
    if (!descend(tile.child(c), most, changed)) return false;
  }
  return true;
}

}  // namespace tind
