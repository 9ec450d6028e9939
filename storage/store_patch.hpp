// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <map>
#include <optional>
#include <string>
#include <thread>

#include "core/format/bytes.hpp"
#include "core/piece_key.hpp"
#include "storage/tile_store.hpp"

namespace tind {

/// Makes a `.tind` file out of a finished one of which few values become other ones: a copy in which these are put in
/// their places. Done only where TileStoreWriter would give the same pages to all values, so the bytes are those that
/// it would write, at the price of a copy by the operating system. One thread.
class StorePatch {
 public:
  /// Values of pieces that the file has, by their keys; not owned.
  using Values = std::map<PieceKey, ByteView>;

  /// Begins to copy `earlier`, on a thread of its own, to a file beside `path`. `earlier` must outlive it.
  StorePatch(const TileStore& earlier, const std::string& path);
  /// Removes the copy unless it was put in place. Until then the file at `path` is locked, as flock(2) does.
  ~StorePatch();
  StorePatch(const StorePatch&) = delete;
  StorePatch& operator=(const StorePatch&) = delete;

  /// Puts the values and the manifest in, syncs, and renames the copy to `path`. False, and no file is left: a value
  /// needs more or fewer pages, the file was not laid out by this writer, or it could not be copied.
  bool finish(const Values& values, ByteView manifest_value);

  /// The name of the copy: what a killed process may leave behind.
  static std::string copy_path(const std::string& path) { return path + ".copy"; }

 private:
  void copy();
  bool put_values(const Values& values, ByteView manifest_value);

  const TileStore& earlier_;
  const std::string path_, copy_path_;
  int file_ = -1;
  bool is_copied_ = false, is_in_place_ = false;
  std::atomic<bool> stop_{false};
  std::jthread copier_;
};

}  // namespace tind
