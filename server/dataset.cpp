// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/dataset.hpp"

#include <fmt/format.h>
#include <sys/stat.h>

#include <algorithm>
#include <atomic>
#include <filesystem>

#include "core/assembler.hpp"
#include "core/format/fnv1a.hpp"
#include "server/http_date.hpp"
#include "server/route.hpp"
#include "storage/piece_blob.hpp"
#include "storage/zstd_codec.hpp"

#ifndef TIND_VERSION
#error "the build gives TIND_VERSION"
#endif

namespace tind {
namespace {

// The pages of a larger file would take longer than a service manager waits for a sign of life.
constexpr std::uintmax_t kMostLookedAtBytes = std::uintmax_t{4} << 30;

std::string tile_name(const Dataset& dataset, const TileKey& key) {
  return fmt::format("{} {}/{}/{}", dataset.name, key.level, key.x, key.y);
}

}  // namespace

std::string fingerprint(std::initializer_list<std::string_view> texts) {
  Fnv1a hash;
  for (const std::string_view text : texts) {
    hash.add({reinterpret_cast<const std::uint8_t*>(text.data()), text.size()});
  }
  return hash.hex();
}

Result<Dataset> open_dataset(const std::string& path, std::string name, TreeExtent looked_at) {
  if (name.empty()) name = std::filesystem::path(path).stem().string();
  if (name.empty() || is_reserved_name(name)) {
    return fail(ErrorKind::kInvalidInput, path + ": '" + name + "' is a name the daemon needs itself; rename the file");
  }
  std::error_code no_size;
  if (std::filesystem::file_size(path, no_size) > kMostLookedAtBytes && !no_size) looked_at = TreeExtent::kLastPath;
  auto store = TileStore::open(path, looked_at);
  if (!store) return tl::unexpected(store.error());
  const auto broken = [&](const Error& error) { return fail(error.kind, path + ": " + error.message); };
  auto snapshot = store->snapshot();
  if (!snapshot) return broken(snapshot.error());
  const auto value = snapshot->find_manifest();
  if (!value) return fail(ErrorKind::kCorrupt, path + ": no manifest");
  const auto json = unpack_value(*value);
  if (!json) return broken(json.error());
  auto manifest = decode_manifest(*json);
  if (!manifest) return broken(manifest.error());
  std::string text(json->begin(), json->end());
  // The manifest has a hash of all pieces.
  std::string version = fingerprint({text, TIND_VERSION});
  static std::atomic<std::uint32_t> n_opened = 0;
  struct stat info {};
  const std::int64_t modified_s = ::stat(path.c_str(), &info) == 0 ? info.st_mtime : 0;
  return Dataset{std::move(name),    std::move(*store), std::move(*manifest), std::move(text),
                 std::move(version), ++n_opened,        modified_s,           format_http_date(modified_s)};
}

Result<std::optional<VirtualNode>> load_tile(const Dataset& dataset, const TileStore::Snapshot& snapshot,
                                             const TileKey& key) {
  const auto keys = pieces_of(key);
  const auto body_value = snapshot.find(keys[8]);
  if (!body_value) return std::nullopt;
  const auto broken = [&](const std::string& what) {
    return fail(ErrorKind::kCorrupt, tile_name(dataset, key) + ": " + what);
  };
  TilePieces pieces;
  for (std::size_t k = 0; k < 9; ++k) {
    const auto value = k == 8 ? body_value : snapshot.find(keys[k]);
    if (!value) return broken("a piece is missing");
    const auto record = unpack_value(*value);
    if (!record) return broken(record.error().message);
    if (k == 8) {
      auto body = decode_body(*record);
      if (!body) return broken(body.error().message);
      pieces.body = std::move(*body);
    } else if (k % 2 == 0) {
      const auto corner = decode_corner(*record);
      if (!corner) return broken(corner.error().message);
      pieces.corners[k / 2] = *corner;
    } else {
      auto edge = decode_edge(*record);
      if (!edge) return broken(edge.error().message);
      pieces.edges[k / 2] = std::move(*edge);
    }
  }
  auto node = assemble(dataset.manifest.lattice, key, std::move(pieces));
  if (!node) return tl::unexpected(node.error());
  return std::optional(std::move(*node));
}

std::vector<TileKey> neighbours_of(const TileKey& key) {
  std::vector<TileKey> seen = {key};  // level 0 has one tile both in the west and in the east
  const std::uint32_t n_x = TileKey::count_x(key.level), n_y = TileKey::count_y(key.level);
  for (std::uint32_t dy = 0; dy < 3; ++dy) {
    if (key.y + dy < 1 || key.y + dy > n_y) continue;
    for (std::uint32_t dx = 0; dx < 3; ++dx) {
      const TileKey other{key.level, (key.x + n_x + dx - 1) % n_x, key.y + dy - 1};
      if (std::find(seen.begin(), seen.end(), other) == seen.end()) seen.push_back(other);
    }
  }
  seen.erase(seen.begin());
  return seen;
}

Result<std::vector<VirtualNode>> load_neighbours(const Dataset& dataset, const TileStore::Snapshot& snapshot,
                                                 const TileKey& key) {
  std::vector<VirtualNode> neighbours;
  for (const TileKey& other : neighbours_of(key)) {
    auto tile = load_tile(dataset, snapshot, other);
    if (!tile) return tl::unexpected(tile.error());
    if (*tile) neighbours.push_back(std::move(**tile));
  }
  return neighbours;
}

}  // namespace tind
