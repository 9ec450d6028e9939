// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.hpp"
#include "core/virtual_node.hpp"
#include "storage/manifest.hpp"
#include "storage/tile_store.hpp"

namespace tind {

/// One open .tind file under its name. Const access is thread safe.
struct Dataset {
  std::string name;  ///< The file's stem, or what the settings call it.
  TileStore store;
  Manifest manifest;
  std::string manifest_json;
  std::string version;          ///< 16 hex digits; changes with the file's manifest and with the daemon's version.
  std::uint32_t id = 0;         ///< Never 0, another for each that this process opens: for keys of caches.
  std::int64_t modified_s = 0;  ///< When the file was last written, seconds since 1970.
  std::string last_modified;    ///< The same as HTTP says it.
};

/// Opens a file, to be called `name` (empty: its stem). Fails as TileStore::open and decode_manifest do, and with
/// kInvalidInput on a name that a route has. `looked_at`: as there, but of files above 4 GB
/// only the way to the manifest is looked at.
Result<Dataset> open_dataset(const std::string& path, std::string name = {}, TreeExtent looked_at = TreeExtent::kWhole);

/// Reads and assembles a tile. nullopt: not stored. kCorrupt: a piece is missing or broken.
Result<std::optional<VirtualNode>> load_tile(const Dataset& dataset, const TileStore::Snapshot& snapshot,
                                             const TileKey& key);

/// Level, x and y in one number.
constexpr std::uint64_t packed(const TileKey& key) {
  static_assert(kMaxLevel <= 28, "level, x and y fit into 64 bits");
  return std::uint64_t{key.level} << 58 | std::uint64_t{key.x} << 29 | key.y;
}

/// The tiles of the same level that touch `key`, itself not included, wrapping in x, each once. At most eight.
std::vector<TileKey> neighbours_of(const TileKey& key);

/// The stored tiles of the same level that touch `key`, itself not included, wrapping in x, each once.
Result<std::vector<VirtualNode>> load_neighbours(const Dataset& dataset, const TileStore::Snapshot& snapshot,
                                                 const TileKey& key);

/// 16 hex digits of the 64-bit FNV-1a hash of the texts, one after another.
std::string fingerprint(std::initializer_list<std::string_view> texts);

}  // namespace tind
