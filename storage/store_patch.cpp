// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/store_patch.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

#include "storage/store_pages.hpp"

namespace tind {
namespace {

constexpr std::size_t kBytesAtOnce = std::size_t{16} << 20;

struct Change {
  ByteView value;
  bool is_there = false;  // in a leaf
};

bool write_at(int file, ByteView bytes, std::uint64_t offset) {
  while (!bytes.empty()) {
    const ssize_t n = ::pwrite(file, bytes.data(), bytes.size(), static_cast<off_t>(offset));
    if (n <= 0) return false;
    bytes = bytes.subspan(static_cast<std::size_t>(n));
    offset += static_cast<std::uint64_t>(n);
  }
  return true;
}

}  // namespace

StorePatch::StorePatch(const TileStore& earlier, const std::string& path)
    : earlier_(earlier), path_(path), copy_path_(copy_path(path)), copier_([this] { copy(); }) {}

StorePatch::~StorePatch() {
  stop_ = true;
  if (copier_.joinable()) copier_.join();
  if (file_ < 0) return;
  ::close(file_);
  if (!is_in_place_) ::unlink(copy_path_.c_str());
}

void StorePatch::copy() {
  file_ = ::open(copy_path_.c_str(), O_CREAT | O_TRUNC | O_RDWR | O_CLOEXEC, 0644);
  struct stat info {};
  if (file_ < 0 || ::fstat(earlier_.file(), &info) != 0) return;
  off_t from = 0;
  while (from < info.st_size && !stop_) {
    // Where the file system can it shares the blocks.
    if (::copy_file_range(earlier_.file(), &from, file_, nullptr, kBytesAtOnce, 0) <= 0) return;
  }
  // So that little is left to be synced in the end.
  is_copied_ = from == info.st_size && ::fdatasync(file_) == 0;
}

bool StorePatch::finish(const Values& values, ByteView manifest_value) {
  copier_.join();
  if (!is_copied_ || !put_values(values, manifest_value) || ::fdatasync(file_) != 0) return false;
  // Whoever had the name locked has it still.
  is_in_place_ = ::flock(file_, LOCK_EX | LOCK_NB) == 0 && std::rename(copy_path_.c_str(), path_.c_str()) == 0;
  return is_in_place_;
}

bool StorePatch::put_values(const Values& values, ByteView manifest_value) {
  const auto pages = StorePages::of_file(earlier_.file(), path_);
  if (!pages || pages->file_bytes() != pages->n_pages() * pages->page_bytes()) return false;
  const auto snapshot = earlier_.snapshot();
  if (!snapshot) return false;

  // Transactions end where they ended.
  CommitPlaces then, now;
  std::size_t n_changed = 0;
  TileStore::Cursor cursor(*snapshot);
  for (;;) {
    const auto piece = cursor.next();
    if (!piece) return false;
    if (!*piece) break;
    const auto changed = values.find((*piece)->key);
    const std::size_t before = (*piece)->value.size();
    n_changed += changed != values.end() ? 1 : 0;
    if (then.add(before) != now.add(changed != values.end() ? changed->second.size() : before)) return false;
  }
  if (n_changed != values.size() || pages->n_transactions() != then.n_commits() + 1) return false;

  // A value stands where it stood, in the tree and in leaves that once were of it.
  std::map<std::string, Change> changes;
  for (const auto& [key, value] : values) {
    const PieceKeyBytes bytes = piece_key_bytes(key);
    changes[{bytes.begin(), bytes.end()}].value = value;
  }
  changes[{kManifestKey.begin(), kManifestKey.end()}].value = manifest_value;
  bool fits = true;
  const bool is_known = pages->visit_all_leaves([&](const StorePages::LeafNode& node) {
    const auto at = changes.find({node.key.begin(), node.key.end()});
    if (!fits || at == changes.end()) return;
    const ByteView value = at->second.value;
    at->second.is_there = true;
    if (node.n_pages == 0) {
      fits = value.size() == node.n_bytes && write_at(file_, value, node.value_at);
      return;
    }
    // The writer fills up the last page with zeros.
    fits = pages->n_pages_of(node.key.size(), value.size()) == node.n_pages;
    if (!fits) return;
    const std::array<std::uint8_t, 4> size = {
        static_cast<std::uint8_t>(value.size()), static_cast<std::uint8_t>(value.size() >> 8),
        static_cast<std::uint8_t>(value.size() >> 16), static_cast<std::uint8_t>(value.size() >> 24)};
    const Bytes zeros(std::max<std::uint64_t>(node.n_bytes, value.size()) - value.size(), 0);
    fits = write_at(file_, size, node.size_at) && write_at(file_, value, node.value_at) &&
           write_at(file_, zeros, node.value_at + value.size());
  });
  return fits && is_known &&
         std::all_of(changes.begin(), changes.end(), [](const auto& change) { return change.second.is_there; });
}

}  // namespace tind
