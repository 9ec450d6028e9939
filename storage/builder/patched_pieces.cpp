// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/patched_pieces.hpp"

namespace tind {

PatchedPieces::PatchedPieces(const EarlierPyramid& earlier, const std::string& path) : earlier_(earlier) {
  copy_.emplace(earlier.store, path);
}

std::optional<ByteView> PatchedPieces::find(const PieceKey& key) const {
  const auto at = values_.find(key);
  if (at == values_.end()) return std::nullopt;
  return at->second;
}

Result<bool> PatchedPieces::store(ByteView manifest_value, TileStoreWriter& writer, const std::atomic<bool>* cancel) {
  StorePatch::Values values;
  for (const auto& [key, value] : values_) values.emplace(key, value);
  if (copy_->finish(values, manifest_value)) return true;
  copy_.reset();  // its room is needed
  auto appended = for_all([&](const PieceKey& key, ByteView value) -> Result<void> {
    if (cancel != nullptr && cancel->load(std::memory_order_relaxed)) {
      return fail(ErrorKind::kInterrupted, "interrupted");
    }
    return writer.append(key, value);
  });
  if (appended) appended = writer.finish(manifest_value);
  if (!appended) return tl::unexpected(appended.error());
  return false;
}

}  // namespace tind
