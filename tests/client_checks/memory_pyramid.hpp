// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "core/assembler.hpp"
#include "storage/manifest.hpp"
#include "storage/tile_store.hpp"
#include "tests/client/tile_source.hpp"

namespace tind::test {

/// Answers the routes of docs/http.md for one .tind file under the name "p", made with the writer's encoders and
/// without a socket. Single answers can be replaced by damaged ones. get() is thread safe once nothing is replaced any
/// more.
class MemoryPyramid : public client::TileSource {
 public:
  explicit MemoryPyramid(const std::string& tind_file);
  client::Outcome<client::Answer> get(const std::string& path) override;

  const Manifest& manifest() const { return manifest_; }
  /// Stored tiles of a level, in row order.
  std::vector<TileKey> tiles(int level) const;
  TilePieces pieces(const TileKey& key) const;
  VirtualNode node(const TileKey& key) const;

  /// From now on `path` (after "/p/") answers with these bytes and status.
  void replace(const std::string& path, Bytes body, int status = 200);
  void replace_text(const std::string& path, const std::string& text);
  /// Serves other pieces for a tile, in .parts, .vn and the body's own route alike.
  void serve_pieces(const TileKey& key, const TilePieces& pieces);
  /// Serves another assembled tile; its .parts stay.
  void serve_node(const TileKey& key, const VirtualNode& node);
  void serve_manifest(const Manifest& manifest);
  /// The bytes that are served now.
  Bytes body_of(const std::string& path);

 private:
  client::Outcome<client::Answer> make(const std::string& path) const;
  Bytes stored(const PieceKey& key) const;
  Bytes make_terrain(const TileKey& key) const;
  std::string make_codes(const TileKey& key) const;
  std::string make_layer() const;

  TileStore store_;
  Manifest manifest_;
  std::map<std::string, client::Answer> replaced_;
};

/// "level/x/y"
std::string text_of(const TileKey& key);

/// A small .tind file for a whole test program: mountains on 8 x 6 degrees that lie across longitude 180, built once by
/// the builder itself. Seven levels; real, partly real and filler tiles.
struct SmallWorld {
  std::string raster;  ///< GeoTIFF with the source posts.
  std::string tind;
};
const SmallWorld& small_world();

}  // namespace tind::test
