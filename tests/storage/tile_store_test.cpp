// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/tile_store.hpp"

#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <numeric>
#include <random>

#include <gtest/gtest.h>
#include <lmdb.h>

namespace tind {
namespace {

namespace fs = std::filesystem;

class TileStoreTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-tile-store-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { fs::remove_all(folder_); }

  std::string path(const std::string& name) const { return (folder_ / name).string(); }

  /// All pieces of level 2 in storage order, each with a value that names it; large ones among them.
  static std::vector<std::pair<PieceKey, Bytes>> pieces() {
    std::vector<PieceKey> keys;
    for (std::uint32_t y = 0; y < TileKey::count_y(2); ++y) {
      for (std::uint32_t x = 0; x < TileKey::count_x(2); ++x) {
        for (const PieceKey& key : pieces_of({2, x, y})) keys.push_back(key);
      }
    }
    std::sort(keys.begin(), keys.end());
    keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
    std::vector<std::pair<PieceKey, Bytes>> out;
    for (const PieceKey& key : keys) {
      out.emplace_back(key,
                       Bytes(key.kind == PieceKind::kBody ? 9000 : 3, static_cast<std::uint8_t>(key.i * 16 + key.j)));
    }
    return out;
  }

  std::string write_store(const std::string& name) const {
    auto writer = TileStoreWriter::create(path(name));
    EXPECT_TRUE(writer) << writer.error().message;
    for (const auto& [key, value] : pieces()) EXPECT_TRUE(writer->append(key, value));
    EXPECT_TRUE(writer->finish(Bytes{'{', '}'}));
    return path(name);
  }

  /// Kind of failure of opening; -1 when it opens.
  static int opens_with(const std::string& file) {
    const auto store = TileStore::open(file);
    return store ? -1 : static_cast<int>(store.error().kind);
  }

  fs::path folder_;
};

TEST_F(TileStoreTest, GivesBackEveryPieceUnderEveryName) {
  const auto store = TileStore::open(write_store("a.tind"));
  ASSERT_TRUE(store) << store.error().message;
  const auto snapshot = store->snapshot();
  ASSERT_TRUE(snapshot);
  for (const auto& [key, value] : pieces()) {
    const auto found = snapshot->find(key);
    ASSERT_TRUE(found);
    EXPECT_EQ(Bytes(found->begin(), found->end()), value);
  }
  // Longitude 180 from the other side, a pole from any column.
  const auto east = snapshot->find({PieceKind::kEdgeV, 2, TileKey::count_x(2), 1});
  const auto west = snapshot->find({PieceKind::kEdgeV, 2, 0, 1});
  ASSERT_TRUE(east && west);
  EXPECT_EQ(east->data(), west->data());
  EXPECT_EQ(snapshot->find({PieceKind::kCorner, 2, 5, 0})->data(),
            snapshot->find({PieceKind::kCorner, 2, 0, 0})->data());
  EXPECT_FALSE(snapshot->find({PieceKind::kBody, 1, 0, 0}));
  EXPECT_FALSE(snapshot->find({PieceKind::kBody, 2, 0, 4}));
  EXPECT_EQ(snapshot->find_manifest()->size(), 2u);
}

TEST_F(TileStoreTest, KnowsWhereTheFileLiesInMemory) {
  // LMDB's first page, whose number is 0, and its magic number.
  const auto is_file = [](ByteView map) {
    std::uint32_t magic = 0;
    if (map.size() >= 4096) std::memcpy(&magic, map.data() + 16, sizeof magic);
    return magic == 0xBEEFC0DE;
  };
  auto writer = TileStoreWriter::create(path("growing.tind"));
  ASSERT_TRUE(writer);
  std::uint32_t x = 0;
  for (; !writer->has_pieces(); ++x) {
    ASSERT_TRUE(writer->append({PieceKind::kBody, 9, x, 0}, Bytes(100'000, 1)));
  }
  EXPECT_TRUE(is_file(writer->map()));
  const auto store = TileStore::open(write_store("a.tind"));
  ASSERT_TRUE(store);
  const ByteView map = store->map();
  ASSERT_TRUE(is_file(map));
  EXPECT_GE(map.size(), fs::file_size(path("a.tind")));
  const auto snapshot = store->snapshot();
  const auto value = snapshot->find(pieces().front().first);
  ASSERT_TRUE(value);
  EXPECT_GE(value->data(), map.data());
  EXPECT_LT(value->data(), map.data() + map.size());
}

TEST_F(TileStoreTest, FindsATilesNinePiecesAsOneByOne) {
  const auto store = TileStore::open(write_store("a.tind"));
  ASSERT_TRUE(store);
  const auto snapshot = store->snapshot();
  ASSERT_TRUE(snapshot);
  std::array<ByteView, 9> values;
  for (std::uint32_t y = 0; y < TileKey::count_y(2); ++y) {
    for (std::uint32_t x = 0; x < TileKey::count_x(2); ++x) {
      const TileKey tile{2, x, y};
      ASSERT_TRUE(snapshot->find_tile(tile, values));
      const auto keys = pieces_of(tile);
      for (std::size_t k = 0; k < keys.size(); ++k) {
        const auto alone = snapshot->find(keys[k]);
        ASSERT_TRUE(alone.has_value());
        EXPECT_EQ(values[k].data(), alone->data()) << x << " " << y << " " << k;
        EXPECT_EQ(values[k].size(), alone->size());
      }
    }
  }
  EXPECT_FALSE(snapshot->find_tile({1, 0, 0}, values));
  EXPECT_FALSE(snapshot->find_tile({3, 0, 0}, values));
  EXPECT_FALSE(snapshot->find_tile({2, 8, 0}, values)) << "out of range";
}

TEST_F(TileStoreTest, APieceThatIsMissingBesideItsBodyIsEmpty) {
  auto writer = TileStoreWriter::create(path("b.tind"));
  ASSERT_TRUE(writer);
  const PieceKey lost = pieces_of({2, 3, 1})[5];
  for (const auto& [key, value] : pieces()) {
    if (key == lost) continue;
    ASSERT_TRUE(writer->append(key, value));
  }
  ASSERT_TRUE(writer->finish(Bytes{'{', '}'}));
  const auto store = TileStore::open(path("b.tind"));
  const auto snapshot = store->snapshot();
  std::array<ByteView, 9> values;
  ASSERT_TRUE(snapshot->find_tile({2, 3, 1}, values));
  for (std::size_t k = 0; k < values.size(); ++k) EXPECT_EQ(values[k].empty(), k == 5) << k;
}

// Every tile of level 5 in a store of a few hundred leaf pages.
std::string write_deep_store(const std::string& file) {
  std::vector<PieceKey> keys;
  for (std::uint32_t y = 0; y < TileKey::count_y(5); ++y) {
    for (std::uint32_t x = 0; x < TileKey::count_x(5); ++x) {
      for (const PieceKey& key : pieces_of({5, x, y})) keys.push_back(key);
    }
  }
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  auto writer = TileStoreWriter::create(file);
  EXPECT_TRUE(writer) << writer.error().message;
  for (const PieceKey& key : keys) {
    EXPECT_TRUE(writer->append(key, Bytes(key.kind == PieceKind::kBody && key.i % 8 == 0 ? 5000 : 40, 1)));
  }
  EXPECT_TRUE(writer->finish(Bytes{'{', '}'}));
  return file;
}

std::string bytes_of(const std::string& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void write_bytes(const std::string& file, const std::string& bytes) {
  std::ofstream(file, std::ios::binary | std::ios::trunc)
      .write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}

constexpr std::size_t kPage = 4096;
enum : char { kBranchPage = 1, kLeafPage = 2 };

// Where pages of a kind begin (mdb.c: flags at byte 10 of a page).
std::vector<std::size_t> pages_of(const std::string& bytes, char kind) {
  std::vector<std::size_t> pages;
  for (std::size_t at = 2 * kPage; at < bytes.size(); at += kPage) {
    std::uint64_t number = 0;
    std::memcpy(&number, bytes.data() + at, sizeof number);
    if (number == at / kPage && bytes[at + 10] == kind && bytes[at + 11] == 0) pages.push_back(at);
  }
  return pages;
}

TEST_F(TileStoreTest, DamagedPagesAreRefusedBeforeLmdbTrustsThem) {
  const std::string sound = bytes_of(write_deep_store(path("deep.tind")));
  const auto leaves = pages_of(sound, kLeafPage), branches = pages_of(sound, kBranchPage);
  ASSERT_GT(leaves.size(), 50u);
  ASSERT_GE(branches.size(), 1u);
  int n_last_paths = 0, n_unused = 0;
  for (const auto& pages : {leaves, branches}) {
    for (const std::size_t page : pages) {
      std::string bytes = sound;
      bytes[page + 12] = static_cast<char>(0xff);  // where its list of nodes ends
      bytes[page + 13] = static_cast<char>(0x7f);
      write_bytes(path("hurt.tind"), bytes);
      const auto store = TileStore::open(path("hurt.tind"));
      if (store) {
        ++n_unused;
        continue;
      }
      EXPECT_EQ(store.error().kind, ErrorKind::kCorrupt);
      EXPECT_NE(store.error().message.find("damaged"), std::string::npos) << store.error().message;
      n_last_paths += TileStore::open(path("hurt.tind"), TreeExtent::kLastPath) ? 0 : 1;
    }
  }
  EXPECT_LE(n_unused, 4) << "pages that the writer gave up";
  EXPECT_GE(n_last_paths, 2) << "the last leaf, and a branch page at least";
  EXPECT_LT(n_last_paths, static_cast<int>(branches.size()) + 2) << "no leaf but the last";
}

TEST_F(TileStoreTest, WhatOpensAfterFlippedBitsCanBeReadWhole) {
  const std::string sound = bytes_of(write_deep_store(path("deep.tind")));
  std::vector<std::size_t> pages = pages_of(sound, kLeafPage);
  for (const std::size_t page : pages_of(sound, kBranchPage)) pages.insert(pages.end(), 20, page);
  std::mt19937_64 random(20261122);
  int n_opened = 0;
  for (int k = 0; k < 400; ++k) {
    std::string bytes = sound;
    const std::size_t at = pages[random() % pages.size()] + random() % (k % 2 == 0 ? 64 : kPage);
    bytes[at] = static_cast<char>(bytes[at] ^ (1 << random() % 8));
    write_bytes(path("hurt.tind"), bytes);
    const auto store = TileStore::open(path("hurt.tind"));
    if (!store) continue;
    ++n_opened;
    const auto snapshot = store->snapshot();
    ASSERT_TRUE(snapshot);
    std::size_t sum = 0;
    for (std::uint32_t x = 0; x < TileKey::count_x(5); ++x) {
      for (std::uint32_t y = 0; y < TileKey::count_y(5); ++y) {
        std::array<ByteView, 9> values;
        if (!snapshot->find_tile({5, x, y}, values)) continue;
        for (const ByteView value : values) sum = std::accumulate(value.begin(), value.end(), sum);
      }
    }
    EXPECT_GT(sum, 0u);
  }
  EXPECT_GT(n_opened, 40);
  EXPECT_LT(n_opened, 360);
}

TEST_F(TileStoreTest, KeepsKeysInStorageOrderWithTheManifestLast) {
  const std::string file = write_store("a.tind");
  MDB_env* env = nullptr;
  ASSERT_EQ(mdb_env_create(&env), 0);
  ASSERT_EQ(mdb_env_open(env, file.c_str(), MDB_NOSUBDIR | MDB_RDONLY | MDB_NOLOCK, 0), 0);
  MDB_txn* txn = nullptr;
  MDB_dbi dbi = 0;
  MDB_cursor* cursor = nullptr;
  ASSERT_EQ(mdb_txn_begin(env, nullptr, MDB_RDONLY, &txn), 0);
  ASSERT_EQ(mdb_dbi_open(txn, nullptr, 0, &dbi), 0);
  ASSERT_EQ(mdb_cursor_open(txn, dbi, &cursor), 0);
  MDB_val key{}, value{};
  std::vector<std::string> keys;
  while (mdb_cursor_get(cursor, &key, &value, MDB_NEXT) == 0) {
    keys.emplace_back(static_cast<const char*>(key.mv_data), key.mv_size);
  }
  mdb_cursor_close(cursor);
  mdb_txn_abort(txn);
  mdb_env_close(env);
  // docs/format.md 2, by hand.
  std::vector<std::string> expected;
  for (const auto& [k, v] : pieces()) {
    std::string bytes(10, '\0');
    bytes[0] = 2;
    std::uint64_t code = 0;
    for (unsigned bit = 0; bit < 32; ++bit) {
      code |= std::uint64_t{k.i >> bit & 1} << (2 * bit) | std::uint64_t{k.j >> bit & 1} << (2 * bit + 1);
    }
    for (std::size_t b = 0; b < 8; ++b) bytes[8 - b] = static_cast<char>(code >> (8 * b));
    bytes[9] = static_cast<char>(k.kind);
    expected.push_back(bytes);
  }
  expected.push_back("\xffm");
  EXPECT_EQ(keys, expected);
}

TEST_F(TileStoreTest, WritesTheSameBytesAgain) {
  const std::string a = write_store("a.tind"), b = write_store("b.tind");
  const auto read = [](const std::string& file) {
    std::ifstream in(file, std::ios::binary);
    return std::string{std::istreambuf_iterator<char>(in), {}};
  };
  EXPECT_EQ(read(a), read(b));
  EXPECT_GT(read(a).size(), 32 * 9000u);
}

TEST_F(TileStoreTest, RefusesWhatIsNoStore) {
  const int corrupt = static_cast<int>(ErrorKind::kCorrupt);
  EXPECT_EQ(opens_with(path("missing.tind")), static_cast<int>(ErrorKind::kNotFound));
  EXPECT_EQ(opens_with(folder_.string()), static_cast<int>(ErrorKind::kInvalidInput));
  for (const std::size_t n :
       {std::size_t{0}, std::size_t{1}, std::size_t{100}, std::size_t{5000}, std::size_t{100000}}) {
    std::ofstream(path("junk.tind"), std::ios::binary) << std::string(n, 'x');
    EXPECT_EQ(opens_with(path("junk.tind")), corrupt) << n << " bytes";
  }
  // Somebody else's LMDB file.
  MDB_env* env = nullptr;
  ASSERT_EQ(mdb_env_create(&env), 0);
  ASSERT_EQ(mdb_env_open(env, path("foreign.mdb").c_str(), MDB_NOSUBDIR | MDB_NOLOCK, 0644), 0);
  MDB_txn* txn = nullptr;
  MDB_dbi dbi = 0;
  ASSERT_EQ(mdb_txn_begin(env, nullptr, 0, &txn), 0);
  ASSERT_EQ(mdb_dbi_open(txn, nullptr, 0, &dbi), 0);
  MDB_val key{3, const_cast<char*>("abc")}, value{3, const_cast<char*>("xyz")};
  ASSERT_EQ(mdb_put(txn, dbi, &key, &value, 0), 0);
  ASSERT_EQ(mdb_txn_commit(txn), 0);
  mdb_env_close(env);
  EXPECT_EQ(opens_with(path("foreign.mdb")), corrupt);
}

TEST_F(TileStoreTest, RefusesATruncatedFileAtAnyLength) {
  const std::string file = write_store("a.tind");
  const auto size = static_cast<std::int64_t>(fs::file_size(file));
  for (std::int64_t n = size - 1; n >= 0; n -= 4001) {
    fs::resize_file(file, static_cast<std::uintmax_t>(n));
    EXPECT_EQ(opens_with(file), static_cast<int>(ErrorKind::kCorrupt)) << n << " of " << size;
  }
}

TEST_F(TileStoreTest, RefusesAFileThatWasNeverFinished) {
  {
    auto writer = TileStoreWriter::create(path("half.tind"));
    ASSERT_TRUE(writer);
    for (const auto& [key, value] : pieces()) ASSERT_TRUE(writer->append(key, value));
  }
  EXPECT_EQ(opens_with(path("half.tind")), static_cast<int>(ErrorKind::kCorrupt));
}

TEST_F(TileStoreTest, WriterFindsWhatItWroteAndRefusesAnExistingFile) {
  auto writer = TileStoreWriter::create(path("a.tind"));
  ASSERT_TRUE(writer);
  const Bytes large(3 << 20, 7);  // some commits on the way
  for (std::uint32_t i = 0; i < 16; ++i) ASSERT_TRUE(writer->append({PieceKind::kBody, 4, i, 0}, large));
  EXPECT_EQ(writer->find({PieceKind::kBody, 4, 0, 0})->size(), large.size());
  EXPECT_EQ(writer->find({PieceKind::kBody, 4, 15, 0})->size(), large.size());
  EXPECT_FALSE(writer->find({PieceKind::kBody, 4, 16, 0}));
  const auto second = TileStoreWriter::create(path("a.tind"));
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().kind, ErrorKind::kIo);
}

// The same pieces, cut off after `n` of them, gone on with: the bytes are those of one go.
TEST_F(TileStoreTest, TheWritersContentHashIsTheReaders) {
  for (const auto kind : {ContentHash::Kind::kXxh3, ContentHash::Kind::kFnv1a}) {
    const std::string file = path("hashed" + std::to_string(static_cast<int>(kind)));
    auto writer = TileStoreWriter::go_on(file, kind);
    ASSERT_TRUE(writer);
    for (const auto& [key, value] : pieces()) ASSERT_TRUE(writer->append(key, value));
    const std::string hash = writer->content_hash();
    EXPECT_EQ(ContentHash::kind_of(hash), kind) << hash;
    ASSERT_TRUE(writer->finish(Bytes{'{', '}'}));
    const auto store = TileStore::open(file);
    ASSERT_TRUE(store);
    EXPECT_EQ(content_hash(*store->snapshot(), kind).value(), hash);
  }
}

TEST_F(TileStoreTest, AContentHashIsOfKeysAndValuesInTheirOrder) {
  for (const auto kind : {ContentHash::Kind::kXxh3, ContentHash::Kind::kFnv1a}) {
    const auto hash_of = [&](const std::vector<std::pair<Bytes, Bytes>>& pieces) {
      ContentHash hash(kind);
      for (const auto& [key, value] : pieces) hash.add(key, value);
      return hash.hex();
    };
    const std::string whole = hash_of({{{1, 2}, {3}}, {{4, 5}, {6, 7}}});
    EXPECT_EQ(hash_of({{{1, 2}, {3}}, {{4, 5}, {6, 7}}}), whole);
    EXPECT_NE(hash_of({{{4, 5}, {6, 7}}, {{1, 2}, {3}}}), whole);
    EXPECT_NE(hash_of({{{1, 2}, {3}}, {{4, 5}, {7, 6}}}), whole);
    EXPECT_NE(hash_of({{{1, 3}, {3}}, {{4, 5}, {6, 7}}}), whole);
    EXPECT_NE(hash_of({{{1, 2}, {3}}}), whole);
  }
  ContentHash by_value(ContentHash::Kind::kXxh3), by_digest(ContentHash::Kind::kXxh3);
  const Bytes key{1, 2}, value{3, 4, 5};
  by_value.add(key, value);
  by_digest.add(key, ContentHash::digest_of(value));
  EXPECT_EQ(by_value.hex(), by_digest.hex());
  // As docs/format.md 9 has it: the digest stands where the value would.
  const auto digest = ContentHash::digest_of(value);
  Bytes both = key;
  both.insert(both.end(), digest.begin(), digest.end());
  const auto expected = ContentHash::digest_of(both);
  std::string digits = by_value.hex();
  ASSERT_EQ(digits.size(), 2 * expected.size());
  for (std::size_t k = 0; k < expected.size(); ++k)
    EXPECT_EQ(std::stoi(digits.substr(2 * k, 2), nullptr, 16), expected[k]);
}

TEST_F(TileStoreTest, GoneOnWithTheBytesAreTheSame) {
  // Large enough for several commits, of sizes that leave gaps in pages.
  std::vector<std::pair<PieceKey, Bytes>> many;
  for (std::uint32_t y = 0; y < TileKey::count_y(4); ++y) {
    for (std::uint32_t x = 0; x < TileKey::count_x(4); ++x) {
      const std::uint32_t size = 1 + (x * 977 + y * 3331) % 17000;
      many.emplace_back(PieceKey{PieceKind::kBody, 4, x, y}, Bytes(size, static_cast<std::uint8_t>(x + 31 * y)));
    }
  }
  std::sort(many.begin(), many.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  const auto write = [&](const std::string& name, std::size_t n, bool finish) {
    auto writer = TileStoreWriter::go_on(path(name));
    ASSERT_TRUE(writer) << writer.error().message;
    for (std::size_t k = 0; k < n; ++k) ASSERT_TRUE(writer->append(many[k].first, many[k].second));
    if (finish) {
      ASSERT_TRUE(writer->finish(Bytes{'{', '}'}));
    }
  };
  const auto bytes_of = [&](const std::string& name) {
    std::ifstream in(path(name), std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(in), {});
  };
  write("whole", many.size(), true);
  ASSERT_GT(bytes_of("whole").size(), 3'000'000u);
  for (const std::size_t stop : {std::size_t{1}, many.size() / 3, many.size() / 2, many.size() - 1}) {
    const std::string name = "stopped" + std::to_string(stop);
    write(name, stop, false);
    write(name, many.size(), true);
    EXPECT_TRUE(bytes_of(name) == bytes_of("whole")) << stop;
    // Finished already: everything is compared, nothing written.
    write(name, many.size(), true);
    EXPECT_TRUE(bytes_of(name) == bytes_of("whole")) << stop;
  }
  // Another value where something was committed is no going on.
  write("other", many.size() / 2, false);
  auto writer = TileStoreWriter::go_on(path("other"));
  ASSERT_TRUE(writer);
  EXPECT_TRUE(writer->has_pieces());
  EXPECT_TRUE(writer->find_earlier(many[0].first));
  EXPECT_FALSE(writer->find_earlier(many.back().first));
  const auto refused = writer->append(many[0].first, Bytes{1, 2, 3});
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kCorrupt);
}

}  // namespace
}  // namespace tind
