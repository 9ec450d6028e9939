// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/storage/damaged_store.hpp"

#include <lmdb.h>

#include <gtest/gtest.h>

#include "storage/content_hash.hpp"
#include "storage/piece_blob.hpp"
#include "storage/zstd_codec.hpp"

namespace tind::test {
namespace {

const Bytes kManifestKey = {0xff, 'm'};
constexpr std::size_t kMapBytes = std::size_t{1} << 30;

}  // namespace

Bytes DamagedStore::key_of(const PieceKey& key) {
  const PieceKey k = key.canonical();
  Bytes bytes = {k.level};
  const std::uint64_t code = morton_code(k.i, k.j);
  for (int shift = 56; shift >= 0; shift -= 8) bytes.push_back(static_cast<std::uint8_t>(code >> shift));
  bytes.push_back(static_cast<std::uint8_t>(k.kind));
  return bytes;
}

DamagedStore::DamagedStore(const std::string& path) {
  const auto store = TileStore::open(path);
  EXPECT_TRUE(store) << store.error().message;
  const auto snapshot = store->snapshot();
  TileStore::Cursor cursor(*snapshot);
  while (const auto piece = cursor.next().value()) {
    records_[key_of(piece->key)] = Bytes(piece->value.begin(), piece->value.end());
  }
  const auto manifest = snapshot->find_manifest();
  records_[kManifestKey] = Bytes(manifest->begin(), manifest->end());
}

Bytes& DamagedStore::value(const PieceKey& key) {
  const auto found = records_.find(key_of(key));
  EXPECT_NE(found, records_.end());
  return found->second;
}
void DamagedStore::erase(const PieceKey& key) { EXPECT_EQ(records_.erase(key_of(key)), 1u); }

void DamagedStore::change_corner(const PieceKey& key, const std::function<void(Corner&)>& change) {
  Corner corner = decode_corner(unpack_value(value(key)).value()).value();
  change(corner);
  value(key) = pack_value(encode_corner(corner));
}
EdgeChain DamagedStore::edge(const PieceKey& key) { return decode_edge(unpack_value(value(key)).value()).value(); }
void DamagedStore::change_edge(const PieceKey& key, const std::function<void(EdgeChain&)>& change) {
  EdgeChain changed = edge(key);
  change(changed);
  value(key) = pack_value(encode_edge(changed));
}
TileBody DamagedStore::body(const TileKey& tile) {
  return decode_body(unpack_value(value({PieceKind::kBody, tile.level, tile.x, tile.y})).value()).value();
}
void DamagedStore::change_body(const TileKey& tile, const std::function<void(TileBody&)>& change) {
  TileBody changed = body(tile);
  change(changed);
  value({PieceKind::kBody, tile.level, tile.x, tile.y}) = pack_body(changed);
}

nlohmann::json DamagedStore::manifest() {
  const Bytes text = unpack_value(records_.at(kManifestKey)).value();
  return nlohmann::json::parse(text.begin(), text.end());
}
void DamagedStore::change_manifest(const std::function<void(nlohmann::json&)>& change) {
  nlohmann::json json = manifest();
  change(json);
  const std::string text = json.dump();
  records_[kManifestKey] = pack_value(Bytes(text.begin(), text.end()));
}

void DamagedStore::renew_hash(ContentHash::Kind kind) {
  ContentHash hash(kind);
  std::map<std::size_t, std::uint64_t> n_bytes;
  for (const auto& [key, value] : records_) {
    const auto piece = parse_piece_key(key);
    if (!piece || piece->kind == PieceKind::kInputs) continue;
    hash.add(key, value);
    n_bytes[key[0]] += value.size();
  }
  change_manifest([&](nlohmann::json& json) {
    json["content_hash"] = hash.hex();
    for (nlohmann::json& level : json["levels"]) level["bytes"] = n_bytes[level["level"].get<std::size_t>()];
  });
}

void DamagedStore::write(const std::string& path) const {
  std::filesystem::remove(path);
  MDB_env* env = nullptr;
  MDB_txn* txn = nullptr;
  MDB_dbi dbi = 0;
  ASSERT_EQ(mdb_env_create(&env), 0);
  ASSERT_EQ(mdb_env_set_mapsize(env, kMapBytes), 0);
  ASSERT_EQ(mdb_env_open(env, path.c_str(), MDB_NOSUBDIR | MDB_NOLOCK | MDB_NOSYNC, 0644), 0);
  ASSERT_EQ(mdb_txn_begin(env, nullptr, 0, &txn), 0);
  ASSERT_EQ(mdb_dbi_open(txn, nullptr, 0, &dbi), 0);
  for (const auto& [key, value] : records_) {
    MDB_val k{key.size(), const_cast<std::uint8_t*>(key.data())};
    MDB_val v{value.size(), const_cast<std::uint8_t*>(value.data())};
    ASSERT_EQ(mdb_put(txn, dbi, &k, &v, MDB_APPEND), 0);
  }
  ASSERT_EQ(mdb_txn_commit(txn), 0);
  mdb_env_close(env);
}

}  // namespace tind::test
