// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/format/bytes.hpp"
#include "core/piece_key.hpp"
#include "core/result.hpp"
#include "storage/content_hash.hpp"
#include "storage/store_pages.hpp"

namespace tind {

/// The key of a piece's record (docs/format.md 2). Precondition: the piece's key is canonical or can be made so.
using PieceKeyBytes = std::array<std::uint8_t, 10>;
PieceKeyBytes piece_key_bytes(const PieceKey& key);
inline constexpr std::array<std::uint8_t, 2> kManifestKey = {0xff, 'm'};

/// The piece that a record's key names (docs/format.md 2); nullopt: not one that a builder writes.
std::optional<PieceKey> parse_piece_key(ByteView key);
/// True iff it is the key of the manifest's record.
bool is_manifest_key(ByteView key);
/// True iff it could be the key of a kind of piece that this version does not know: readers pass over those.
bool is_unknown_kind(ByteView key);

/// Reads one `.tind` file (docs/format.md 2) through LMDB's memory map.
/// The store is thread safe; a Snapshot belongs to one thread at a time.
class TileStore {
 public:
  /// A read transaction. Views it hands out stay valid until it is destroyed or renewed. Movable, cheap to renew.
  class Snapshot {
   public:
    Snapshot(Snapshot&&) noexcept;
    Snapshot& operator=(Snapshot&&) noexcept;
    ~Snapshot();
    /// The stored value (a record or a zstd frame) of a piece. `key` need not be canonical. nullopt: not stored.
    std::optional<ByteView> find(const PieceKey& key) const;
    /// The stored values of a tile's nine pieces, in the order of pieces_of(). Faster than nine find(): pieces that lie
    /// side by side are walked to. False: the tile is not stored. A piece that is missing beside a body that is there
    /// is an empty view.
    bool find_tile(const TileKey& key, std::array<ByteView, 9>& values) const;
    /// The stored value of the manifest. nullopt: the file has none.
    std::optional<ByteView> find_manifest() const;

   private:
    friend class TileStore;
    struct Impl;
    explicit Snapshot(std::unique_ptr<Impl> impl);
    std::unique_ptr<Impl> impl_;
  };

  struct Piece {
    PieceKey key;
    ByteView value;
  };
  /// Walks all pieces in storage order. The snapshot must outlive it; one thread.
  class Cursor {
   public:
    explicit Cursor(const Snapshot& snapshot);
    Cursor(Cursor&&) noexcept;
    Cursor& operator=(Cursor&&) noexcept;
    ~Cursor();
    /// The next piece of a kind that this version knows; nullopt at the end. kCorrupt on a key that no builder writes.
    /// The view is the snapshot's.
    Result<std::optional<Piece>> next();

   private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
  };

  /// Opens read-only, after a look at the tree's pages: LMDB trusts them, and a damaged one would take the program
  /// down. `looked_at`: kLastPath when only the manifest will be read, or the whole was looked at before. Fails with
  /// kNotFound, kIo, or kCorrupt (not an LMDB file; damaged pages; no manifest).
  static Result<TileStore> open(const std::string& path, TreeExtent looked_at = TreeExtent::kWhole);
  TileStore(TileStore&&) noexcept;
  TileStore& operator=(TileStore&&) noexcept;
  ~TileStore();

  /// Starts a read transaction.
  Result<Snapshot> snapshot() const;
  /// The file in memory; empty where that cannot be told.
  ByteView map() const;
  /// Its descriptor, the store's own.
  int file() const;

 private:
  struct Impl;
  explicit TileStore(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// The content hash of a file's pieces. Fails as Cursor::next does. `first`, if not null, gets the digests of the first
/// values that it covers, `most` of them or all; for kXxh3 only.
Result<std::string> content_hash(const TileStore::Snapshot& snapshot, ContentHash::Kind kind,
                                 std::vector<ContentHash::ValueDigest>* first = nullptr, std::size_t most = 0);

/// Where a writer's transactions end: a transaction's dirty pages are in memory, and what is not committed is lost in a
/// crash. LMDB's pages depend on where transactions end, so that depends on nothing but what is written.
class CommitPlaces {
 public:
  /// A piece with a value of so many bytes. True: a transaction ends behind it.
  bool add(std::size_t n_bytes) {
    uncommitted_bytes_ += n_bytes + std::tuple_size_v<PieceKeyBytes>;
    if (uncommitted_bytes_ < kCommitBytes) return false;
    uncommitted_bytes_ = 0;
    ++n_commits_;
    return true;
  }
  std::uint64_t n_commits() const { return n_commits_; }

 private:
  static constexpr std::size_t kCommitBytes = std::size_t{1} << 20;
  std::size_t uncommitted_bytes_ = 0;
  std::uint64_t n_commits_ = 0;
};

/// Writes a `.tind` file. One thread. Keys must come in storage order, the manifest last. What was appended is on disk
/// every few megabytes; a file that was left there, by a crash or a full disk, can be gone on with, and then has the
/// same bytes in the end as one written without a stop.
class TileStoreWriter {
 public:
  /// Creates `path`, which must not exist.
  static Result<TileStoreWriter> create(const std::string& path);
  /// Opens what an earlier writer left unfinished, or creates `path`. The same pieces must be appended again from the
  /// first on: those that are there are compared and cost no writing. `kind`: of content_hash(). kCorrupt: not such a
  /// file.
  static Result<TileStoreWriter> go_on(const std::string& path, ContentHash::Kind kind = ContentHash::Kind::kXxh3);
  TileStoreWriter(TileStoreWriter&&) noexcept;
  TileStoreWriter& operator=(TileStoreWriter&&) noexcept;
  /// Without finish() the file is left as it is, unfinished; the caller removes it.
  ~TileStoreWriter();

  const std::string& path() const;
  /// Appends one piece. `value`: what pack_value made. kIo on a full disk; kCorrupt when an earlier writer left another
  /// value there.
  Result<void> append(const PieceKey& key, ByteView value);
  /// Whether there is anything on disk to go on with, of an earlier writer or of this one.
  bool has_pieces() const;
  /// The value that an earlier writer left under `key`. nullopt: none. The view is valid until the next append.
  std::optional<ByteView> find_earlier(const PieceKey& key) const;
  /// A stored value of this writer, committed or not. The view is valid until the next append.
  std::optional<ByteView> find(const PieceKey& key) const;
  /// The file in memory; empty where that cannot be told. Valid until the next append.
  ByteView map() const;
  /// Of the pieces appended so far.
  std::string content_hash() const;
  /// Writes the manifest, commits, syncs to disk and closes.
  Result<void> finish(ByteView manifest_value);

 private:
  struct Impl;
  explicit TileStoreWriter(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace tind
