// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <vector>

#include "core/piece_key.hpp"
#include "core/virtual_node.hpp"
#include "storage/manifest.hpp"
#include "storage/tile_store.hpp"

namespace tind {

/// The tiles whose bodies are in a file, eight bytes each.
class StoredTiles {
 public:
  explicit StoredTiles(std::size_t n_levels) : codes_(n_levels) {}

  /// In storage order. Precondition: the tile's level is below `n_levels`.
  void add(const TileKey& tile) { codes_[tile.level].push_back(morton_code(tile.x, tile.y)); }
  bool has(const TileKey& tile) const {
    if (tile.level >= codes_.size()) return false;
    const auto& codes = codes_[tile.level];
    return std::binary_search(codes.begin(), codes.end(), morton_code(tile.x, tile.y));
  }
  /// True iff a tile that the piece belongs to is stored. Precondition: canonical.
  bool has_any_of(const PieceKey& piece) const;
  std::size_t n_levels() const { return codes_.size(); }
  std::size_t n_tiles(std::size_t level) const { return codes_[level].size(); }
  /// The k-th tile of a level in storage order.
  TileKey tile(std::size_t level, std::size_t k) const {
    const std::uint64_t code = codes_[level][k];
    return {static_cast<std::uint8_t>(level), morton_decode_even(code), morton_decode_even(code >> 1)};
  }

 private:
  std::vector<std::vector<std::uint64_t>> codes_;  // by level, ascending
};

/// What the checks of one thread read from. `tiles` and `manifest` are shared and constant.
struct PieceSource {
  const TileStore::Snapshot& snapshot;
  const StoredTiles& tiles;
  const Manifest& manifest;
  bool has_inputs = false;  ///< Some tile has an inputs record, so all must.

  const Lattice& lattice() const { return manifest.lattice; }
  bool is_shard() const { return manifest.shard_count > 1; }
  bool has(const PieceKey& key) const { return snapshot.find(key.canonical()).has_value(); }
  /// nullopt: missing, or does not decode.
  std::optional<Corner> corner(const PieceKey& key) const;
  std::optional<EdgeChain> edge(const PieceKey& key) const;
};

}  // namespace tind
