// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/report/pyramid_file.hpp"

#include <utility>

#include <fmt/format.h>

#include "core/assembler.hpp"
#include "core/piece_key.hpp"
#include "storage/builder/earlier_pyramid.hpp"
#include "storage/piece_blob.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

std::string name_of(const TileKey& key) { return fmt::format("tile {}/{}/{}", key.level, key.x, key.y); }

}  // namespace

PyramidFile::PyramidFile(std::string path, TileStore store, TileStore::Snapshot snapshot, Manifest manifest)
    : path_(std::move(path)),
      store_(std::move(store)),
      snapshot_(std::move(snapshot)),
      manifest_(std::move(manifest)) {}

Result<PyramidFile> PyramidFile::open(const std::string& path) {
  auto file = EarlierPyramid::open(path);
  if (!file) return tl::unexpected(file.error());
  return PyramidFile(path, std::move(file->store), std::move(file->snapshot), std::move(file->manifest));
}

std::vector<TileKey> PyramidFile::surface_tiles(int level, const std::function<bool(const TileKey&)>& wanted) const {
  std::vector<TileKey> found, open;
  for (std::uint32_t x = TileKey::count_x(0); x-- > 0;) open.push_back({0, x, 0});
  while (!open.empty()) {
    const TileKey key = open.back();
    open.pop_back();
    if (!manifest_.has_tile(key) || !wanted(key)) continue;
    // All four children of a tile are stored, or none (docs/format.md 9).
    if (key.level >= level || key.level >= manifest_.bottom_level || !manifest_.has_tile(key.child(0))) {
      found.push_back(key);
      continue;
    }
    for (int c = 3; c >= 0; --c) open.push_back(key.child(c));
  }
  return found;
}

std::vector<TileKey> PyramidFile::stored_tiles(int level) const {
  std::vector<TileKey> tiles;
  for (const TileRun& run : manifest_.levels[static_cast<std::size_t>(level)].rows) {
    for (std::uint32_t x = run.x_first; x <= run.x_last; ++x) {
      tiles.push_back({static_cast<std::uint8_t>(level), x, run.y});
    }
  }
  return tiles;
}

Result<Bytes> PyramidFile::read_piece(const PieceKey& key) const {
  const auto value = snapshot_.find(key);
  if (!value) {
    return fail(ErrorKind::kCorrupt, fmt::format("{}: a piece at {}/{}/{} is missing; build the file again", path_,
                                                 key.level, key.i, key.j));
  }
  return Bytes(value->begin(), value->end());
}

Result<TileValues> PyramidFile::read_tile(const TileKey& key) const {
  TileValues values;
  const auto keys = pieces_of(key);
  for (std::size_t k = 0; k < keys.size(); ++k) {
    auto value = read_piece(keys[k]);
    if (!value) return tl::unexpected(value.error());
    values[k] = std::move(*value);
  }
  return values;
}

Result<VirtualNode> decode_tile(const Lattice& lattice, const TileKey& key, const TileValues& values) {
  const auto broken = [&](const Error& error) { return fail(error.kind, name_of(key) + ": " + error.message); };
  TilePieces pieces;
  for (std::size_t k = 0; k < values.size(); ++k) {
    const auto record = unpack_value(values[k]);
    if (!record) return broken(record.error());
    if (k == 8) {
      auto body = decode_body(*record);
      if (!body) return broken(body.error());
      pieces.body = std::move(*body);
    } else if (k % 2 == 0) {
      const auto corner = decode_corner(*record);
      if (!corner) return broken(corner.error());
      pieces.corners[k / 2] = *corner;
    } else {
      auto edge = decode_edge(*record);
      if (!edge) return broken(edge.error());
      pieces.edges[k / 2] = std::move(*edge);
    }
  }
  return assemble(lattice, key, std::move(pieces));
}

}  // namespace tind
