// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/earlier_pyramid.hpp"

#include <utility>

#include "storage/zstd_codec.hpp"

namespace tind {

Result<EarlierPyramid> EarlierPyramid::open(const std::string& path) {
  auto store = TileStore::open(path);
  if (!store) return tl::unexpected(store.error());
  auto snapshot = store->snapshot();
  if (!snapshot) return tl::unexpected(snapshot.error());
  const auto value = snapshot->find_manifest();
  const auto named = [&path](const Error& error) { return fail(error.kind, path + ": " + error.message); };
  if (!value) return fail(ErrorKind::kCorrupt, path + ": no manifest");
  const auto text = unpack_value(*value);
  if (!text) return named(text.error());
  auto manifest = decode_manifest(*text);
  if (!manifest) return named(manifest.error());
  return EarlierPyramid{std::move(*store), std::move(*snapshot), std::move(*manifest)};
}

}  // namespace tind
