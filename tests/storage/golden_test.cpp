// SPDX-License-Identifier: GPL-3.0-or-later
// The bytes of every format version are a contract: what an older program wrote is read for ever. The files come from
// tests/golden/make_v1.py, which follows docs/format.md and shares no code with tind.
#include <fstream>
#include <iterator>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/assembler.hpp"
#include "core/format/vn.hpp"
#include "storage/manifest.hpp"
#include "storage/piece_blob.hpp"
#include "storage/tile_store.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

using testing::ElementsAreArray;

std::string path_of(const std::string& name) { return std::string(TIND_TEST_DATA "/../golden/v1/") + name; }

Bytes golden(const std::string& name) {
  std::ifstream in(path_of(name), std::ios::binary);
  Bytes bytes{std::istreambuf_iterator<char>(in), {}};
  EXPECT_FALSE(bytes.empty()) << path_of(name);
  return bytes;
}

const Corner kCorner{-1234};
const EdgeChain kEdge{1, 3, {{5, 700, 3}, {30000, -2, 1}, {65535, 100000, 3}}};

TileBody body_value() {
  TileBody body;
  body.stats = {TileCoverage::kPartial, -1234, 100000, 44100, 24.5f, 3.25f};
  body.n_side = {1, 0, 0, 0};
  body.interior = {{300, 200, -40}, {1000, 60000, 800}};
  body.triangles = {{0, 1, 5}, {0, 5, 4}, {1, 2, 5}, {2, 3, 6}, {2, 6, 5}, {3, 4, 6}, {4, 5, 6}};
  body.n_gaps = 2;
  body.virtual_triangles = {
      {0, 1, 0, 0, {2, 3}}, {2, 1, 0, 1, {0, 300}}, {3, 1, 1, 0, {0, 0}}, {5, 1, 2, 0, {1, 1}}, {1, 1, 3, 0, {0, 7}}};
  return body;
}

Manifest manifest_value() {
  Manifest m;
  m.generator = "tind-build 0.0";
  m.attribution = "nobody \u00e9";
  m.vertical_datum = "EGM96";
  m.mode = "non-standard";
  m.lattice.level = 3;
  m.lattice.height_exponent = 4;
  m.base_height_m = -2.5;
  m.falloff_posts = 64;
  m.disagreement_m = 0.5;
  m.bounds_deg = {-106, 37, -104, 38};
  m.spacing_deg = {0.25, 0.125};
  m.heights = "orthometric";
  m.vertical_operation = "vgridshift grids=egm96_15.gtx";
  m.source_kind = "warped";
  m.resampling = "cubic";
  m.lines = {5, 2, 1, 321};
  m.sources = {{"a.tif", "00ff", 9, 7, 17, "WGS 84 / UTM zone 11N (EPSG:32611)", "proj=utm zone=11"}};
  m.n_source_posts = 63;
  m.n_filled_posts = 2;
  m.n_falloff_posts = 1000;
  m.options_json = R"({"falloff_posts":64})";
  m.content_hash = "0123456789abcdef";
  LevelInfo level;
  level.tolerance_m = 32.5;
  level.spacing_m = 40.25;
  level.height_step_m = 0.5;
  level.n_tiles = 2;
  level.n_partial = level.n_filler = 1;
  level.n_vertices = 11;
  level.n_border_vertices = 7;
  level.n_seed_vertices = 3;
  level.n_triangles = 12;
  level.n_posts = 63;
  level.max_error_m = 24.5;
  level.rmse_m = 3.25;
  level.bytes = 321;
  level.rows = {{0, 0, 0, TileCoverage::kPartial}, {0, 1, 1, TileCoverage::kFiller}};
  m.levels = {level};
  return m;
}

TEST(GoldenV1, CornerRecord) {
  EXPECT_THAT(encode_corner(kCorner), ElementsAreArray(golden("corner.bin")));
  EXPECT_EQ(decode_corner(golden("corner.bin")).value(), kCorner);
}

TEST(GoldenV1, EdgeRecord) {
  EXPECT_THAT(encode_edge(kEdge), ElementsAreArray(golden("edge.bin")));
  EXPECT_EQ(decode_edge(golden("edge.bin")).value(), kEdge);
}

TEST(GoldenV1, BodyRecord) {
  EXPECT_THAT(encode_body(body_value()), ElementsAreArray(golden("body.bin")));
  EXPECT_EQ(decode_body(golden("body.bin")).value(), body_value());
}

TEST(GoldenV1, ValueInAZstdFrame) {
  // Only decoded: another release of zstd may compress better.
  EXPECT_EQ(unpack_value(golden("body.zst")).value(), golden("body.bin"));
}

TEST(GoldenV1, VnTile) {
  Lattice lattice;
  lattice.level = 3;
  lattice.height_exponent = 4;
  TilePieces pieces;
  pieces.corners = {Corner{-1234}, Corner{10}, Corner{20}, Corner{100000}};
  pieces.edges[0] = {0, 2, {{30000, -2, 3}}};
  pieces.edges[1] = {2, 1, {}};
  pieces.edges[2] = {0, 1, {}};
  pieces.edges[3] = {0, 0, {}};
  pieces.body = body_value();
  const auto node = assemble(lattice, {3, 9, 2}, pieces);
  ASSERT_TRUE(node) << node.error().message;
  EXPECT_THAT(encode_vn(lattice, *node, 32.0), ElementsAreArray(golden("tile.vn")));
}

TEST(GoldenV1, Manifest) {
  const Bytes bytes = golden("manifest.json");
  EXPECT_EQ(encode_manifest(manifest_value()), std::string(bytes.begin(), bytes.end()));
  const auto decoded = decode_manifest(bytes);
  ASSERT_TRUE(decoded) << decoded.error().message;
  EXPECT_EQ(encode_manifest(*decoded), encode_manifest(manifest_value()));
  EXPECT_EQ(decoded->levels[0].rows[1].coverage, TileCoverage::kFiller);
  EXPECT_EQ(decoded->lattice.ellipsoid.inverse_flattening, 298.257223563);
}

TEST(GoldenV1, ManifestOfTheFirstBuilders) {
  const auto decoded = decode_manifest(golden("manifest_first.json"));
  ASSERT_TRUE(decoded) << decoded.error().message;
  Manifest expected = manifest_value();
  expected.heights = "unknown";
  expected.vertical_operation = "";
  expected.source_kind = "raster";
  expected.resampling = "none";
  expected.lines = {};
  expected.sources[0].n_points = 0;
  expected.sources[0].crs = expected.sources[0].operation = "";
  EXPECT_EQ(encode_manifest(*decoded), encode_manifest(expected));
}

// Written by TileStoreWriter of tind 0.1.0 with LMDB 0.9.24.
TEST(GoldenV1, WholeFile) {
  const auto store = TileStore::open(path_of("pieces.tind"));
  ASSERT_TRUE(store) << store.error().message;
  const auto snapshot = store->snapshot();
  ASSERT_TRUE(snapshot);
  const auto at = [&](PieceKind kind, std::uint32_t i, std::uint32_t j) {
    const auto value = snapshot->find({kind, 3, i, j});
    return value ? Bytes(value->begin(), value->end()) : Bytes();
  };
  EXPECT_EQ(at(PieceKind::kCorner, 9, 2), golden("corner.bin"));
  EXPECT_EQ(at(PieceKind::kEdgeH, 9, 2), golden("edge.bin"));
  EXPECT_EQ(at(PieceKind::kBody, 9, 2), golden("body.zst"));
  EXPECT_FALSE(snapshot->find({PieceKind::kBody, 3, 8, 2}));
  EXPECT_EQ(snapshot->find_manifest()->size(), 2u);  // "{}"
  // Both as libxxhash and Python make them of the records' files.
  EXPECT_EQ(content_hash(*snapshot, ContentHash::Kind::kXxh3).value(), "93199ae08fd4b262ab630c330f3c4833");
  EXPECT_EQ(content_hash(*snapshot, ContentHash::Kind::kFnv1a).value(), "cdd2d93d1f1f5ede");
}

}  // namespace
}  // namespace tind
