// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/tile_store.hpp"

#include <fcntl.h>
#include <lmdb.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cerrno>
#include <cinttypes>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <new>

namespace tind {
namespace {

constexpr std::size_t kKeyBytes = std::tuple_size_v<PieceKeyBytes>;
constexpr mdb_mode_t kFileMode = 0644;
// Address space, not disk. Fixed, because LMDB writes it into the file and the same input must give the same bytes.
constexpr std::size_t kMapBytes = std::size_t{1} << 38;
MDB_val to_val(ByteView bytes) { return {bytes.size(), const_cast<std::uint8_t*>(bytes.data())}; }

std::optional<ByteView> get(MDB_txn* txn, MDB_dbi dbi, ByteView key) {
  MDB_val k = to_val(key), v{};
  if (mdb_get(txn, dbi, &k, &v) != 0) return std::nullopt;
  return ByteView(static_cast<const std::uint8_t*>(v.mv_data), v.mv_size);
}

// Where an environment's file lies in memory. LMDB does not tell, but the system does: the first map of that file.
// Empty where /proc is not what Linux makes of it.
ByteView map_of(MDB_env* env) {
  int file = -1;
  struct stat info {};
  if (mdb_env_get_fd(env, &file) != 0 || ::fstat(file, &info) != 0) return {};
  std::ifstream maps("/proc/self/maps");
  for (std::string line; std::getline(maps, line);) {
    // Begin-end permissions offset major:minor inode path
    std::uintptr_t begin = 0, end = 0;
    unsigned long offset = 0, inode = 0;
    unsigned major_number = 0, minor_number = 0;
    if (std::sscanf(line.c_str(), "%" SCNxPTR "-%" SCNxPTR " %*s %lx %x:%x %lu", &begin, &end, &offset, &major_number,
                    &minor_number, &inode) != 6) {
      continue;
    }
    if (inode != info.st_ino || offset != 0 || makedev(major_number, minor_number) != info.st_dev) continue;
    return {reinterpret_cast<const std::uint8_t*>(begin), end - begin};
  }
  return {};
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

PieceKeyBytes piece_key_bytes(const PieceKey& key) {
  const PieceKey k = key.canonical();
  PieceKeyBytes bytes{};
  bytes[0] = k.level;
  const std::uint64_t code = morton_code(k.i, k.j);
  for (int b = 0; b < 8; ++b) bytes[static_cast<std::size_t>(1 + b)] = static_cast<std::uint8_t>(code >> (56 - 8 * b));
  bytes[9] = static_cast<std::uint8_t>(k.kind);
  return bytes;
}

std::optional<PieceKey> parse_piece_key(ByteView bytes) {
  if (bytes.size() != kKeyBytes || bytes[9] > static_cast<std::uint8_t>(PieceKind::kInputs)) return std::nullopt;
  std::uint64_t code = 0;
  for (std::size_t b = 0; b < 8; ++b) code = code << 8 | bytes[1 + b];
  const PieceKey key{static_cast<PieceKind>(bytes[9]), bytes[0], morton_decode_even(code),
                     morton_decode_even(code >> 1)};
  if (!key.valid() || key != key.canonical()) return std::nullopt;
  return key;
}

bool is_manifest_key(ByteView key) {
  return key.size() == kManifestKey.size() && key[0] == kManifestKey[0] && key[1] == kManifestKey[1];
}

bool is_unknown_kind(ByteView key) {
  return key.size() == kKeyBytes && key[0] <= kMaxLevel && key[9] > static_cast<std::uint8_t>(PieceKind::kInputs);
}

struct TileStore::Impl {
  std::string path;
  MDB_env* env = nullptr;
  MDB_dbi dbi = 0;
  ~Impl() { mdb_env_close(env); }
};

struct TileStore::Snapshot::Impl {
  MDB_txn* txn = nullptr;
  MDB_dbi dbi = 0;
  MDB_cursor* cursor = nullptr;  // of find_tile, from its first call on
  ~Impl() {
    if (cursor) mdb_cursor_close(cursor);
    mdb_txn_abort(txn);
  }

  // The value under a key: that after the one found before, or searched for. Empty: none.
  ByteView walk_to(const PieceKeyBytes& key, bool is_next) {
    MDB_val k{}, v{};
    if (is_next && mdb_cursor_get(cursor, &k, &v, MDB_NEXT) == 0 && k.mv_size == key.size() &&
        std::memcmp(k.mv_data, key.data(), key.size()) == 0) {
      return {static_cast<const std::uint8_t*>(v.mv_data), v.mv_size};
    }
    k = to_val(key);
    if (mdb_cursor_get(cursor, &k, &v, MDB_SET) != 0) return {};
    return {static_cast<const std::uint8_t*>(v.mv_data), v.mv_size};
  }
};

TileStore::Snapshot::Snapshot(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TileStore::Snapshot::Snapshot(Snapshot&&) noexcept = default;
TileStore::Snapshot& TileStore::Snapshot::operator=(Snapshot&&) noexcept = default;
TileStore::Snapshot::~Snapshot() = default;

std::optional<ByteView> TileStore::Snapshot::find(const PieceKey& key) const {
  if (!key.valid()) return std::nullopt;
  return get(impl_->txn, impl_->dbi, piece_key_bytes(key));
}

bool TileStore::Snapshot::find_tile(const TileKey& key, std::array<ByteView, 9>& values) const {
  // Places in pieces_of(): the body, without which there is no tile; then by where they are stored, the tile's own cell
  // (corner, edges), the cells to the east and the north, and the corner beyond both.
  constexpr std::array<std::size_t, 9> kOrder = {8, 0, 1, 7, 2, 3, 6, 5, 4};
  if (!key.valid()) return false;
  if (!impl_->cursor && mdb_cursor_open(impl_->txn, impl_->dbi, &impl_->cursor) != 0) throw std::bad_alloc();
  const auto keys = pieces_of(key);
  const PieceKey* before = nullptr;
  for (const std::size_t k : kOrder) {
    const PieceKey& piece = keys[k];
    const bool is_next = before && before->i == piece.i && before->j == piece.j;
    values[k] = impl_->walk_to(piece_key_bytes(piece), is_next);
    before = values[k].empty() ? nullptr : &piece;
    if (k == 8 && values[8].empty()) return false;
  }
  return true;
}

std::optional<ByteView> TileStore::Snapshot::find_manifest() const { return get(impl_->txn, impl_->dbi, kManifestKey); }

struct TileStore::Cursor::Impl {
  MDB_cursor* cursor = nullptr;
  bool started = false;
  ~Impl() { mdb_cursor_close(cursor); }
};

TileStore::Cursor::Cursor(const Snapshot& snapshot) : impl_(std::make_unique<Impl>()) {
  // Fails without memory only.
  if (mdb_cursor_open(snapshot.impl_->txn, snapshot.impl_->dbi, &impl_->cursor) != 0) throw std::bad_alloc();
}
TileStore::Cursor::Cursor(Cursor&&) noexcept = default;
TileStore::Cursor& TileStore::Cursor::operator=(Cursor&&) noexcept = default;
TileStore::Cursor::~Cursor() = default;

Result<std::optional<TileStore::Piece>> TileStore::Cursor::next() {
  for (;;) {
    MDB_val k{}, v{};
    const int code = mdb_cursor_get(impl_->cursor, &k, &v, impl_->started ? MDB_NEXT : MDB_FIRST);
    impl_->started = true;
    if (code == MDB_NOTFOUND) return std::nullopt;
    if (code != 0) return fail(ErrorKind::kIo, std::string("reading failed: ") + mdb_strerror(code));
    const ByteView key(static_cast<const std::uint8_t*>(k.mv_data), k.mv_size);
    if (is_manifest_key(key)) return std::nullopt;  // the last key
    if (is_unknown_kind(key)) continue;
    const auto piece = parse_piece_key(key);
    if (!piece) return fail(ErrorKind::kCorrupt, "a key that is no piece's");
    return Piece{*piece, ByteView(static_cast<const std::uint8_t*>(v.mv_data), v.mv_size)};
  }
}

TileStore::TileStore(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TileStore::TileStore(TileStore&&) noexcept = default;
TileStore& TileStore::operator=(TileStore&&) noexcept = default;
TileStore::~TileStore() = default;

Result<TileStore> TileStore::open(const std::string& path, TreeExtent looked_at) {
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
  int file = -1;
  mdb_env_get_fd(impl->env, &file);
  const auto pages = StorePages::of_file(file, path);
  if (!pages) return tl::unexpected(pages.error());
  if (const auto fault = pages->find_tree_fault(looked_at)) {
    return fail(ErrorKind::kCorrupt, path + ": damaged: " + *fault + "; tind --check tells more");
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

ByteView TileStore::map() const { return map_of(impl_->env); }

int TileStore::file() const {
  int file = -1;
  mdb_env_get_fd(impl_->env, &file);
  return file;
}

Result<std::string> content_hash(const TileStore::Snapshot& snapshot, ContentHash::Kind kind,
                                 std::vector<ContentHash::ValueDigest>* first, std::size_t most) {
  ContentHash hash(kind);
  TileStore::Cursor cursor(snapshot);
  for (;;) {
    const auto piece = cursor.next();
    if (!piece) return tl::unexpected(piece.error());
    if (!*piece) return hash.hex();
    if ((*piece)->key.kind == PieceKind::kInputs) continue;
    const auto key = piece_key_bytes((*piece)->key);
    if (kind != ContentHash::Kind::kXxh3) {
      hash.add(key, (*piece)->value);
      continue;
    }
    const auto digest = ContentHash::digest_of((*piece)->value);
    hash.add(key, digest);
    if (first != nullptr && first->size() < most) first->push_back(digest);
  }
}

struct TileStoreWriter::Impl {
  std::string path;
  MDB_env* env = nullptr;
  MDB_txn* txn = nullptr;
  MDB_dbi dbi = 0;
  CommitPlaces places;
  bool has_committed = false;
  std::optional<PieceKeyBytes> last_earlier;  // largest key that an earlier writer left
  bool had_manifest = false;
  ContentHash hash;

  Impl(std::string path_given, ContentHash::Kind kind) : path(std::move(path_given)), hash(kind) {}
  ~Impl() {
    if (txn) mdb_txn_abort(txn);
    if (env) mdb_env_close(env);
  }

  Result<void> open() {
    int code = mdb_env_create(&env);
    if (code == 0) code = mdb_env_set_mapsize(env, kMapBytes);
    // Nobody else sees the file before finish(): no lock. Every commit is on disk before the next begins.
    if (code == 0) code = mdb_env_open(env, path.c_str(), MDB_NOSUBDIR | MDB_NOLOCK, kFileMode);
    if (code == 0) code = mdb_txn_begin(env, nullptr, 0, &txn);
    if (code == 0) code = mdb_dbi_open(txn, nullptr, 0, &dbi);
    if (code == MDB_INVALID || code == MDB_VERSION_MISMATCH || code == MDB_CORRUPTED) {
      return fail(ErrorKind::kCorrupt, path + ": not what an interrupted build leaves, or damaged; remove it");
    }
    if (code != 0) return tl::unexpected(lmdb_error(path, "creating", code));
    return {};
  }

  Result<void> find_last_earlier() {
    MDB_cursor* cursor = nullptr;
    if (mdb_cursor_open(txn, dbi, &cursor) != 0) throw std::bad_alloc();
    MDB_val k{}, v{};
    int code = mdb_cursor_get(cursor, &k, &v, MDB_LAST);
    if (code == 0 && k.mv_size == kManifestKey.size()) {
      had_manifest = true;
      code = mdb_cursor_get(cursor, &k, &v, MDB_PREV);
    }
    if (code == 0 && k.mv_size == kKeyBytes) {
      last_earlier.emplace();
      std::memcpy(last_earlier->data(), k.mv_data, kKeyBytes);
    }
    mdb_cursor_close(cursor);
    if (code != 0 && code != MDB_NOTFOUND) return tl::unexpected(lmdb_error(path, "reading", code));
    return {};
  }

  // Puts a record, or finds the same one there. A put at the end costs no search.
  Result<void> put(ByteView key, ByteView value, bool is_earlier) {
    if (is_earlier) {
      const auto there = get(txn, dbi, key);
      if (there && std::equal(there->begin(), there->end(), value.begin(), value.end())) return {};
      return fail(ErrorKind::kCorrupt, path +
                                           ": what the interrupted build left there is not what this one makes; "
                                           "remove it and start anew");
    }
    MDB_val k = to_val(key), v = to_val(value);
    if (const int code = mdb_put(txn, dbi, &k, &v, MDB_APPEND)) {
      return tl::unexpected(lmdb_error(path, "writing", code));
    }
    return {};
  }
};

const std::string& TileStoreWriter::path() const { return impl_->path; }

ByteView TileStoreWriter::map() const { return map_of(impl_->env); }

TileStoreWriter::TileStoreWriter(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TileStoreWriter::TileStoreWriter(TileStoreWriter&&) noexcept = default;
TileStoreWriter& TileStoreWriter::operator=(TileStoreWriter&&) noexcept = default;
TileStoreWriter::~TileStoreWriter() = default;

Result<TileStoreWriter> TileStoreWriter::create(const std::string& path) {
  // Made here first, because LMDB would silently open a file that exists.
  const int fd = ::open(path.c_str(), O_CREAT | O_EXCL | O_RDWR | O_CLOEXEC, kFileMode);
  if (fd < 0) return fail(ErrorKind::kIo, path + ": cannot be created: " + std::strerror(errno));
  ::close(fd);
  auto impl = std::make_unique<Impl>(path, ContentHash::Kind::kXxh3);
  if (auto opened = impl->open(); !opened) return tl::unexpected(opened.error());
  return TileStoreWriter(std::move(impl));
}

Result<TileStoreWriter> TileStoreWriter::go_on(const std::string& path, ContentHash::Kind kind) {
  // Stopped before its first two pages were there, a file is none yet.
  struct stat info {};
  if (::stat(path.c_str(), &info) == 0 && info.st_size < 2 * ::sysconf(_SC_PAGESIZE) &&
      ::truncate(path.c_str(), 0) != 0) {
    return fail(ErrorKind::kIo, path + ": cannot be written: " + std::strerror(errno));
  }
  auto impl = std::make_unique<Impl>(path, kind);
  if (auto opened = impl->open(); !opened) return tl::unexpected(opened.error());
  if (auto found = impl->find_last_earlier(); !found) return tl::unexpected(found.error());
  return TileStoreWriter(std::move(impl));
}

Result<void> TileStoreWriter::append(const PieceKey& key, ByteView value) {
  assert(key.valid() && key == key.canonical());
  const auto bytes = piece_key_bytes(key);
  const bool is_earlier = impl_->last_earlier && bytes <= *impl_->last_earlier;
  if (auto done = impl_->put(bytes, value, is_earlier); !done) return done;
  if (key.kind != PieceKind::kInputs) {
    impl_->hash.add(bytes, value);
  }
  if (!impl_->places.add(value.size())) return {};
  if (is_earlier) return {};  // the earlier writer committed here
  const int code = mdb_txn_commit(std::exchange(impl_->txn, nullptr));
  if (code != 0) return tl::unexpected(lmdb_error(impl_->path, "writing", code));
  impl_->has_committed = true;
  // LMDB keeps freed buffers, and with them old bytes for the gaps of later pages. Opened anew it has none, as after an
  // interruption; and the pages read so far are given back.
  mdb_env_close(std::exchange(impl_->env, nullptr));
  return impl_->open();
}

std::optional<ByteView> TileStoreWriter::find(const PieceKey& key) const {
  return get(impl_->txn, impl_->dbi, piece_key_bytes(key));
}

bool TileStoreWriter::has_pieces() const { return impl_->last_earlier.has_value() || impl_->has_committed; }

std::optional<ByteView> TileStoreWriter::find_earlier(const PieceKey& key) const {
  if (!impl_->last_earlier || piece_key_bytes(key) > *impl_->last_earlier) return std::nullopt;
  return find(key);
}

std::string TileStoreWriter::content_hash() const { return impl_->hash.hex(); }

Result<void> TileStoreWriter::finish(ByteView manifest_value) {
  if (auto done = impl_->put(kManifestKey, manifest_value, impl_->had_manifest); !done) return done;
  if (!impl_->had_manifest) {
    int code = mdb_txn_commit(std::exchange(impl_->txn, nullptr));
    if (code == 0) code = mdb_env_sync(impl_->env, 1);
    if (code != 0) return tl::unexpected(lmdb_error(impl_->path, "writing", code));
  }
  if (impl_->txn) mdb_txn_abort(std::exchange(impl_->txn, nullptr));
  mdb_env_close(std::exchange(impl_->env, nullptr));
  return {};
}

}  // namespace tind
