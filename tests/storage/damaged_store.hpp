// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <filesystem>
#include <functional>
#include <map>
#include <string>

#include <nlohmann/json.hpp>

#include "core/piece_key.hpp"
#include "storage/content_hash.hpp"
#include "storage/doctor/doctor.hpp"
#include "storage/manifest.hpp"
#include "storage/tile_store.hpp"

namespace tind::test {

/// LMDB's order of keys. (g++ 12 warns of vector's own comparison.)
struct ByteOrder {
  bool operator()(const Bytes& a, const Bytes& b) const {
    return std::lexicographical_compare(a.begin(), a.end(), b.begin(), b.end());
  }
};
using Records = std::map<Bytes, Bytes, ByteOrder>;

/// All records of a `.tind` file, to be changed and written anew: damage planted with LMDB's own hands.
class DamagedStore {
 public:
  /// Reads a sound file.
  explicit DamagedStore(const std::string& path);

  static Bytes key_of(const PieceKey& key);
  Bytes& value(const PieceKey& key);
  void erase(const PieceKey& key);
  Records& records() { return records_; }

  /// The record of a piece, decoded, changed and packed again.
  void change_corner(const PieceKey& key, const std::function<void(Corner&)>& change);
  void change_edge(const PieceKey& key, const std::function<void(EdgeChain&)>& change);
  void change_body(const TileKey& tile, const std::function<void(TileBody&)>& change);
  TileBody body(const TileKey& tile);
  EdgeChain edge(const PieceKey& key);
  nlohmann::json manifest();
  void change_manifest(const std::function<void(nlohmann::json&)>& change);
  /// Makes the manifest's content hash and its bytes per level those of the pieces as they are: damage that only
  /// structure can tell.
  void renew_hash(ContentHash::Kind kind = ContentHash::Kind::kXxh3);

  /// A new LMDB file with these records.
  void write(const std::string& path) const;

 private:
  Records records_;
};

}  // namespace tind::test
