// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/tile_store.hpp"

#include <fcntl.h>
#include <lmdb.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cassert>
#include <cerrno>
#include <cstring>

#include "core/format/fnv1a.hpp"

namespace tind {
namespace {

constexpr std::size_t kKeyBytes = 10;
constexpr std::array<std::uint8_t, 2> kManifestKey = {0xff, 'm'};
constexpr mdb_mode_t kFileMode = 0644;
// Address space, not disk. Fixed, because LMDB writes it into the file and the same input must give the same bytes.
constexpr std::size_t kMapBytes = std::size_t{1} << 38;
// A transaction's dirty pages are in memory: commit now and then.
constexpr std::size_t kCommitBytes = std::size_t{32} << 20;

std::array<std::uint8_t, kKeyBytes> key_bytes(const PieceKey& key) {
  const PieceKey k = key.canonical();
  std::array<std::uint8_t, kKeyBytes> bytes{};
  bytes[0] = k.level;
  const std::uint64_t code = morton_code(k.i, k.j);
  for (int b = 0; b < 8; ++b) bytes[static_cast<std::size_t>(1 + b)] = static_cast<std::uint8_t>(code >> (56 - 8 * b));
  bytes[9] = static_cast<std::uint8_t>(k.kind);
  return bytes;
}

MDB_val to_val(ByteView bytes) { return {bytes.size(), const_cast<std::uint8_t*>(bytes.data())}; }

std::optional<ByteView> get(MDB_txn* txn, MDB_dbi dbi, ByteView key) {
  MDB_val k = to_val(key), v{};
  if (mdb_get(txn, dbi, &k, &v) != 0) return std::nullopt;
  return ByteView(static_cast<const std::uint8_t*>(v.mv_data), v.mv_size);
}

Error lmdb_error(const std::string& path, const char* doing, int code) {
  if (code == MDB_MAP_FULL)
    return {ErrorKind::kUnsupported, path + ": a pyramid of more than 256 GiB; build it in parts"};
  if (code == ENOSPC || code == EDQUOT || code == EFBIG) {
    return {ErrorKind::kIo, path + ": no space left on the disk while " + doing + "; free some or write elsewhere"};
  }
  return {ErrorKind::kIo, path + ": " + doing + " failed: " + mdb_strerror(code)};
}

}  // namespace

struct TileStore::Impl {
  std::string path;
  MDB_env* env = nullptr;
  MDB_dbi dbi = 0;
  ~Impl() { mdb_env_close(env); }
};

struct TileStore::Snapshot::Impl {
  MDB_txn* txn = nullptr;
  MDB_dbi dbi = 0;
  ~Impl() { mdb_txn_abort(txn); }
};

TileStore::Snapshot::Snapshot(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TileStore::Snapshot::Snapshot(Snapshot&&) noexcept = default;
TileStore::Snapshot& TileStore::Snapshot::operator=(Snapshot&&) noexcept = default;
TileStore::Snapshot::~Snapshot() = default;

std::optional<ByteView> TileStore::Snapshot::find(const PieceKey& key) const {
  if (!key.valid()) return std::nullopt;
  return get(impl_->txn, impl_->dbi, key_bytes(key));
}

std::optional<ByteView> TileStore::Snapshot::find_manifest() const { return get(impl_->txn, impl_->dbi, kManifestKey); }

TileStore::TileStore(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TileStore::TileStore(TileStore&&) noexcept = default;
TileStore& TileStore::operator=(TileStore&&) noexcept = default;
TileStore::~TileStore() = default;

Result<TileStore> TileStore::open(const std::string& path) {
  struct stat info {};
  if (::stat(path.c_str(), &info) != 0) {
    return fail(errno == ENOENT ? ErrorKind::kNotFound : ErrorKind::kIo, path + ": " + std::strerror(errno));
  }
  if (!S_ISREG(info.st_mode)) return fail(ErrorKind::kInvalidInput, path + ": not a file; give a .tind file");
  auto impl = std::make_unique<Impl>();
  impl->path = path;
  const auto not_tind = [&] { return fail(ErrorKind::kCorrupt, path + ": not a .tind file, or a damaged one"); };
  if (info.st_size == 0) return not_tind();  // LMDB would call it missing
  if (const int code = mdb_env_create(&impl->env)) return tl::unexpected(lmdb_error(path, "opening", code));
  // Map the file, not the address space that its writer reserved.
  if (const int code = mdb_env_set_mapsize(impl->env, static_cast<std::size_t>(info.st_size))) {
    return tl::unexpected(lmdb_error(path, "opening", code));
  }
  // The file is never written while it is served, so readers need no lock file and no reader table.
  const unsigned flags = MDB_NOSUBDIR | MDB_RDONLY | MDB_NOLOCK | MDB_NOTLS;
  if (const int code = mdb_env_open(impl->env, path.c_str(), flags, kFileMode)) {
    if (code == MDB_INVALID || code == MDB_VERSION_MISMATCH || code == MDB_CORRUPTED) return not_tind();
    return tl::unexpected(lmdb_error(path, "opening", code));
  }
  MDB_envinfo env_info{};
  MDB_stat env_stat{};
  mdb_env_info(impl->env, &env_info);
  mdb_env_stat(impl->env, &env_stat);
  // A truncated file would be a SIGBUS on the first look past its end.
  const auto needed = (static_cast<std::uint64_t>(env_info.me_last_pgno) + 1) * env_stat.ms_psize;
  if (static_cast<std::uint64_t>(info.st_size) < needed) {
    return fail(ErrorKind::kCorrupt,
                path + ": truncated: " + std::to_string(info.st_size) + " of " + std::to_string(needed) + " bytes");
  }
  MDB_txn* txn = nullptr;
  if (const int code = mdb_txn_begin(impl->env, nullptr, MDB_RDONLY, &txn)) {
    return tl::unexpected(lmdb_error(path, "opening", code));
  }
  const int code = mdb_dbi_open(txn, nullptr, 0, &impl->dbi);
  const bool has_manifest = code == 0 && get(txn, impl->dbi, kManifestKey).has_value();
  mdb_txn_commit(txn);
  if (!has_manifest) return not_tind();
  return TileStore(std::move(impl));
}

Result<TileStore::Snapshot> TileStore::snapshot() const {
  auto snapshot = std::make_unique<Snapshot::Impl>();
  snapshot->dbi = impl_->dbi;
  if (const int code = mdb_txn_begin(impl_->env, nullptr, MDB_RDONLY, &snapshot->txn)) {
    return tl::unexpected(lmdb_error(impl_->path, "reading", code));
  }
  return Snapshot(std::move(snapshot));
}

struct TileStoreWriter::Impl {
  std::string path;
  MDB_env* env = nullptr;
  MDB_txn* txn = nullptr;
  MDB_dbi dbi = 0;
  std::size_t uncommitted_bytes = 0;
  Fnv1a hash;

  ~Impl() {
    if (txn) mdb_txn_abort(txn);
    if (env) mdb_env_close(env);
  }
  int put(ByteView key, ByteView value) {
    MDB_val k = to_val(key), v = to_val(value);
    return mdb_put(txn, dbi, &k, &v, MDB_APPEND);
  }
};

TileStoreWriter::TileStoreWriter(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TileStoreWriter::TileStoreWriter(TileStoreWriter&&) noexcept = default;
TileStoreWriter& TileStoreWriter::operator=(TileStoreWriter&&) noexcept = default;
TileStoreWriter::~TileStoreWriter() = default;

Result<TileStoreWriter> TileStoreWriter::create(const std::string& path) {
  // Made here first, because LMDB would silently open a file that exists.
  const int fd = ::open(path.c_str(), O_CREAT | O_EXCL | O_RDWR | O_CLOEXEC, kFileMode);
  if (fd < 0) return fail(ErrorKind::kIo, path + ": cannot be created: " + std::strerror(errno));
  ::close(fd);
  auto impl = std::make_unique<Impl>();
  impl->path = path;
  int code = mdb_env_create(&impl->env);
  if (code == 0) code = mdb_env_set_mapsize(impl->env, kMapBytes);
  // Nobody else sees the file before finish(), which syncs: no lock, no sync per commit.
  if (code == 0) code = mdb_env_open(impl->env, path.c_str(), MDB_NOSUBDIR | MDB_NOLOCK | MDB_NOSYNC, kFileMode);
  if (code == 0) code = mdb_txn_begin(impl->env, nullptr, 0, &impl->txn);
  if (code == 0) code = mdb_dbi_open(impl->txn, nullptr, 0, &impl->dbi);
  if (code != 0) return tl::unexpected(lmdb_error(path, "creating", code));
  return TileStoreWriter(std::move(impl));
}

Result<void> TileStoreWriter::append(const PieceKey& key, ByteView value) {
  assert(key.valid() && key == key.canonical());
  const auto bytes = key_bytes(key);
  if (const int code = impl_->put(bytes, value)) return tl::unexpected(lmdb_error(impl_->path, "writing", code));
  impl_->hash.add(bytes);
  impl_->hash.add(value);
  impl_->uncommitted_bytes += value.size() + kKeyBytes;
  if (impl_->uncommitted_bytes < kCommitBytes) return {};
  impl_->uncommitted_bytes = 0;
  const int code = mdb_txn_commit(std::exchange(impl_->txn, nullptr));
  if (code != 0) return tl::unexpected(lmdb_error(impl_->path, "writing", code));
  if (const int begun = mdb_txn_begin(impl_->env, nullptr, 0, &impl_->txn)) {
    return tl::unexpected(lmdb_error(impl_->path, "writing", begun));
  }
  return {};
}

std::optional<ByteView> TileStoreWriter::find(const PieceKey& key) const {
  return get(impl_->txn, impl_->dbi, key_bytes(key));
}

std::string TileStoreWriter::content_hash() const { return impl_->hash.hex(); }

Result<void> TileStoreWriter::finish(ByteView manifest_value) {
  int code = impl_->put(kManifestKey, manifest_value);
  if (code == 0) code = mdb_txn_commit(std::exchange(impl_->txn, nullptr));
  if (code == 0) code = mdb_env_sync(impl_->env, 1);
  if (code != 0) return tl::unexpected(lmdb_error(impl_->path, "writing", code));
  mdb_env_close(std::exchange(impl_->env, nullptr));
  return {};
}

}  // namespace tind
