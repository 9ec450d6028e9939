// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "core/result.hpp"
#include "storage/manifest.hpp"
#include "storage/readers/resident_maps.hpp"
#include "storage/tile_store.hpp"

namespace tind {

/// A finished `.tind` file that a build, an update, a merge or a report reads. Its manifest lists no more tiles than
/// the file can hold. One thread. The file may be replaced meanwhile: what is open stays what it was.
struct EarlierPyramid {
  TileStore store;
  TileStore::Snapshot snapshot;
  Manifest manifest;
  ResidentMap map;  ///< Its pages count towards a ResidentLimit.
  /// Digests of the first values that the content hash covers; what check_content() found.
  std::vector<ContentHash::ValueDigest> digests{};

  /// `looked_at`: as TileStore::open. kNotFound, kIo, kCorrupt, kUnsupported; the message names the file.
  static Result<EarlierPyramid> open(const std::string& path, TreeExtent looked_at = TreeExtent::kWhole);
  /// Whether it has the piece with this very value.
  bool has(const PieceKey& key, ByteView value) const;
  /// Reads all pieces and compares their hash with the manifest's (format.md 9; none in files of the first builders).
  /// kCorrupt, kIo. Any thread, while nobody looks at digests.
  Result<void> check_content(const std::string& path);
  static constexpr std::size_t kMostDigests = std::size_t{1} << 16;
};

}  // namespace tind
