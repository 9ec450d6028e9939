// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/result.hpp"
#include "core/virtual_node.hpp"
#include "storage/manifest.hpp"
#include "storage/tile_store.hpp"

namespace tind {

/// The nine stored values of a tile, copied, in the order of pieces_of().
using TileValues = std::array<Bytes, 9>;

/// A `.tind` file opened for measuring: its manifest and its tiles. One thread; decode_tile() may run on any.
class PyramidFile {
 public:
  /// kNotFound, kIo, or kCorrupt when it is no `.tind` file; the message names the file.
  static Result<PyramidFile> open(const std::string& path);

  const std::string& path() const { return path_; }
  const Manifest& manifest() const { return manifest_; }

  /// The tiles that make up the surface of `level`, in Morton order of their place: the stored tiles of that level and,
  /// where there is none, the deepest stored one above. Only tiles (and descendants of tiles) that `wanted` says yes
  /// to.
  std::vector<TileKey> surface_tiles(int level, const std::function<bool(const TileKey&)>& wanted) const;
  /// The stored tiles of exactly `level`.
  std::vector<TileKey> stored_tiles(int level) const;
  /// kCorrupt when a piece is missing.
  Result<TileValues> read_tile(const TileKey& key) const;
  /// The stored value of one piece, copied; kCorrupt when it is missing.
  Result<Bytes> read_piece(const PieceKey& key) const;

 private:
  PyramidFile(std::string path, TileStore store, TileStore::Snapshot snapshot, Manifest manifest);

  std::string path_;
  TileStore store_;
  TileStore::Snapshot snapshot_;
  Manifest manifest_;
};

/// Decodes and assembles a tile. Pure, thread safe, safe for untrusted values.
Result<VirtualNode> decode_tile(const Lattice& lattice, const TileKey& key, const TileValues& values);

}  // namespace tind
