// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/earlier_pyramid.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <system_error>
#include <utility>

#include "storage/zstd_codec.hpp"

namespace tind {

Result<EarlierPyramid> EarlierPyramid::open(const std::string& path, TreeExtent looked_at) {
  auto store = TileStore::open(path, looked_at);
  if (!store) return tl::unexpected(store.error());
  auto snapshot = store->snapshot();
  const auto named = [&path](const Error& error) { return fail(error.kind, path + ": " + error.message); };
  if (!snapshot) return named(snapshot.error());
  const auto value = snapshot->find_manifest();
  if (!value) return fail(ErrorKind::kCorrupt, path + ": no manifest; the file is not complete, build it again");
  const auto text = unpack_value(*value);
  if (!text) return named(text.error());
  auto manifest = decode_manifest(*text);
  if (!manifest) return named(manifest.error());
  // A tile takes more than 16 bytes: no damaged manifest makes us list more tiles than the file can hold.
  std::error_code no_size;
  const auto n_bytes = std::filesystem::file_size(path, no_size);
  for (const LevelInfo& level : manifest->levels) {
    std::uint64_t n_tiles = 0;
    for (const TileRun& run : level.rows) n_tiles += std::uint64_t{run.x_last} - run.x_first + 1;
    if (no_size || n_tiles > n_bytes / 16) {
      return fail(ErrorKind::kCorrupt,
                  fmt::format("{}: the manifest lists more tiles of level {} than the file holds", path, level.level));
    }
  }
  const ByteView map = store->map();
  // Read-only and shared: LMDB's map of a file.
  ResidentMap resident(const_cast<std::uint8_t*>(map.data()), map.size());
  return EarlierPyramid{std::move(*store), std::move(*snapshot), std::move(*manifest), std::move(resident)};
}

bool EarlierPyramid::has(const PieceKey& key, ByteView value) const {
  const auto stored = snapshot.find(key);
  return stored && std::equal(stored->begin(), stored->end(), value.begin(), value.end());
}

Result<void> EarlierPyramid::check_content(const std::string& path) {
  if (manifest.content_hash.empty()) return {};
  const auto own = store.snapshot();
  if (!own) return tl::unexpected(own.error());
  digests.clear();
  const auto hash = content_hash(*own, ContentHash::kind_of(manifest.content_hash), &digests, kMostDigests);
  if (!hash) return fail(hash.error().kind, path + ": " + hash.error().message);
  if (*hash == manifest.content_hash) return {};
  return fail(ErrorKind::kCorrupt, path +
                                       ": its pieces are not those that its manifest was written for: the file is "
                                       "damaged; build it anew");
}

}  // namespace tind
