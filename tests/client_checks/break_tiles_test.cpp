// SPDX-License-Identifier: GPL-3.0-or-later
// Tiles, manifest and routes broken on purpose: the right check must see it.
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>

#include "core/format/vn.hpp"
#include "tests/client/terrain_decode.hpp"
#include "tests/client_checks/checks_of.hpp"

namespace tind::test {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::Not;

class BrokenTiles : public testing::Test {
 protected:
  MemoryPyramid pyramid{small_world().tind};
  const int bottom = pyramid.manifest().bottom_level;

  /// The bottom tile with the most interior vertices.
  TileKey busiest() {
    TileKey best;
    std::size_t most = 0;
    for (const TileKey& key : pyramid.tiles(bottom)) {
      const auto n = pyramid.pieces(key).body.interior.size();
      if (n > most) {
        most = n;
        best = key;
      }
    }
    EXPECT_GE(most, 10u);
    return best;
  }
  std::set<std::string> failed_after() {
    report_ = run_checks(pyramid);
    return failed_checks(*report_);
  }
  std::string offenders(const std::string& id) { return offenders_of(*report_, id); }

 private:
  std::unique_ptr<client::Report> report_;
};

TEST_F(BrokenTiles, RaisedInteriorVertexBreaksThePromise) {
  const TileKey key = busiest();
  TilePieces pieces = pyramid.pieces(key);
  const double tolerance = pyramid.manifest().levels[key.level].tolerance_m;
  pieces.body.interior[3].z +=
      static_cast<std::int32_t>(std::ldexp(2.5 * tolerance, pyramid.manifest().lattice.height_exponent));
  pyramid.serve_pieces(key, pieces);
  const auto failed = failed_after();
  EXPECT_THAT(failed, Contains("source-error"));
  EXPECT_THAT(failed, Contains("stored-error"));
  EXPECT_THAT(failed, Not(Contains("cuts"))) << "the surface stays watertight";
  EXPECT_THAT(offenders("source-error"), HasSubstr("tile " + text_of(key) + ": post at longitude"));
}

TEST_F(BrokenTiles, VertexRaisedWithinTheToleranceBreaksTheStoredErrorOnly) {
  const TileKey key = busiest();
  TilePieces pieces = pyramid.pieces(key);
  pieces.body.stats.max_error_m *= 0.5f;
  pieces.body.stats.rmse_m *= 0.5f;
  pyramid.serve_pieces(key, pieces);
  const auto failed = failed_after();
  EXPECT_THAT(failed, Contains("stored-error"));
  EXPECT_THAT(failed, Not(Contains("source-error")));
  EXPECT_THAT(offenders("stored-error"), HasSubstr(text_of(key)));
}

TEST_F(BrokenTiles, WrongPostCountIsSeen) {
  const TileKey key = busiest();
  TilePieces pieces = pyramid.pieces(key);
  pieces.body.stats.n_posts -= 1;
  pyramid.serve_pieces(key, pieces);
  EXPECT_THAT(failed_after(), Contains("stored-error"));
  EXPECT_THAT(offenders("stored-error"), HasSubstr("source posts"));
}

TEST_F(BrokenTiles, VtThatBulgesAfterTessellationIsSeenInsideVts) {
  // Lift one vertex of a line that a coarser neighbour meets: at every level at once, so that all stays nested and
  // shared, and by less than the tile's own E_L allows only where the promise inside re-triangulated triangles breaks.
  const int coarse = bottom - 1;
  const auto lift = static_cast<std::int32_t>(
      std::ldexp(2.2 * pyramid.manifest().levels[static_cast<std::size_t>(coarse)].tolerance_m,
                 pyramid.manifest().lattice.height_exponent));
  for (const TileKey& key : pyramid.tiles(bottom)) {
    const TileKey east{key.level, (key.x + 1) % TileKey::count_x(key.level), key.y};
    const bool cousins = key.x % 2 == 1 && pyramid.manifest().has_tile(east);
    if (!cousins || pyramid.pieces(key).body.stats.coverage != TileCoverage::kReal) continue;
    TilePieces here = pyramid.pieces(key), there = pyramid.pieces(east);
    for (std::size_t k = 0; k < here.edges[1].inner.size(); ++k) {
      if (here.edges[1].inner[k].entry != bottom) continue;
      here.edges[1].inner[k].z += lift;
      there.edges[3].inner[k].z += lift;
      pyramid.serve_pieces(key, here);
      pyramid.serve_pieces(east, there);
      const auto failed = failed_after();
      EXPECT_THAT(failed, Contains("tessellated-error"));
      EXPECT_THAT(failed, Contains("cut-error"));
      EXPECT_THAT(failed, Not(Contains("shared-edges")));
      EXPECT_THAT(failed, Not(Contains("nested-borders")));
      EXPECT_THAT(failed, Not(Contains("cuts")));
      EXPECT_THAT(offenders("tessellated-error"), HasSubstr("against level " + std::to_string(bottom)));
      return;
    }
  }
  FAIL() << "no such vertex";
}

TEST_F(BrokenTiles, TurnedTriangleIsSeen) {
  const TileKey key = busiest();
  TilePieces pieces = pyramid.pieces(key);
  std::swap(pieces.body.triangles[5][1], pieces.body.triangles[5][2]);
  pyramid.serve_pieces(key, pieces);
  const auto failed = failed_after();
  EXPECT_THAT(failed, Contains("triangles"));
  EXPECT_THAT(failed, Contains("cuts"));
  EXPECT_THAT(offenders("triangles"), HasSubstr("negative plan area"));
}

TEST_F(BrokenTiles, ChangedTriangleIsSeen) {
  const TileKey key = busiest();
  TilePieces pieces = pyramid.pieces(key);
  auto& t = pieces.body.triangles.back();
  const auto n = static_cast<std::uint32_t>(pieces.body.ring_size() + pieces.body.interior.size());
  t[2] = t[2] + 1 < n ? t[2] + 1 : t[2] - 1;
  pyramid.serve_pieces(key, pieces);
  EXPECT_THAT(failed_after(), Contains("triangles"));
}

TEST_F(BrokenTiles, RemovedTriangleLeavesAHole) {
  const TileKey key = busiest();
  VirtualNode node = pyramid.node(key);
  node.triangles.pop_back();
  node.virtual_triangles.clear();
  pyramid.serve_node(key, node);
  const auto failed = failed_after();
  EXPECT_THAT(failed, Contains("triangles"));
  EXPECT_THAT(failed, Contains("assembly"));
  EXPECT_THAT(failed, Contains("cuts"));
  EXPECT_THAT(offenders("triangles"), HasSubstr("do not sum"));
}

TEST_F(BrokenTiles, VertexOffItsSideIsSeenAsOutline) {
  const TileKey key = busiest();
  VirtualNode node = pyramid.node(key);
  node.vertices[1].y += 1;
  pyramid.serve_node(key, node);
  EXPECT_THAT(failed_after(), Contains("outline"));
  EXPECT_THAT(offenders("outline"), HasSubstr("south border"));
}

TEST_F(BrokenTiles, InteriorOutOfOrderIsSeen) {
  const TileKey key = busiest();
  VirtualNode node = pyramid.node(key);
  const std::size_t first = 4 + node.n_side[0] + node.n_side[1] + node.n_side[2] + node.n_side[3];
  std::swap(node.vertices[first], node.vertices[first + 1]);
  pyramid.serve_node(key, node);
  EXPECT_THAT(failed_after(), Contains("interior"));
  EXPECT_THAT(offenders("interior"), HasSubstr("Morton"));
}

TEST_F(BrokenTiles, MissingAndWrongVtEntriesAreSeen) {
  const TileKey key = busiest();
  TilePieces pieces = pyramid.pieces(key);
  pieces.body.virtual_triangles.erase(pieces.body.virtual_triangles.begin() + 1);
  pyramid.serve_pieces(key, pieces);
  EXPECT_THAT(failed_after(), Contains("virtual-triangles"));

  pieces = pyramid.pieces(key);
  auto& vts = pieces.body.virtual_triangles;
  std::swap(vts[1].triangle, vts[2].triangle);
  pyramid.serve_pieces(key, pieces);
  EXPECT_THAT(failed_after(), Contains("virtual-triangles"));
}

TEST_F(BrokenTiles, TruncatedBodiesAreSeen) {
  for (const std::string suffix : {".vn", ".parts", ".terrain?extensions=octvertexnormals"}) {
    MemoryPyramid fresh(small_world().tind);
    const std::string path = text_of(busiest()) + suffix;
    Bytes bytes = fresh.body_of(path);
    bytes.resize(bytes.size() - bytes.size() / 3);
    fresh.replace(path, bytes);
    const auto report = run_checks(fresh);
    EXPECT_THAT(failed_checks(*report), Contains("decode")) << suffix;
    EXPECT_THAT(offenders_of(*report, "decode"), HasSubstr(text_of(busiest()))) << suffix;
  }
}

TEST_F(BrokenTiles, MissingTileIsSeen) {
  pyramid.replace(text_of(busiest()) + ".vn", {}, 404);
  EXPECT_THAT(failed_after(), Contains("tiles-answer"));
  EXPECT_THAT(offenders("tiles-answer"), HasSubstr("answers 404"));
}

TEST_F(BrokenTiles, TileThatShouldNotExistIsSeen) {
  pyramid.replace(text_of({static_cast<std::uint8_t>(bottom + 1), 0, 0}) + ".vn", {1, 2, 3}, 200);
  EXPECT_EQ(failed_after(), std::set<std::string>{"outside"});
}

TEST_F(BrokenTiles, WrongToleranceIsSeen) {
  const TileKey key = busiest();
  pyramid.replace(text_of(key) + ".vn", encode_vn(pyramid.manifest().lattice, pyramid.node(key),
                                                  pyramid.manifest().levels[key.level].tolerance_m * 2));
  EXPECT_EQ(failed_after(), std::set<std::string>{"tile-header"});
}

TEST_F(BrokenTiles, ManifestCountsAreCompared) {
  Manifest manifest = pyramid.manifest();
  manifest.levels[2].n_triangles += 1;
  pyramid.serve_manifest(manifest);
  EXPECT_EQ(failed_after(), std::set<std::string>{"totals"});
  EXPECT_THAT(offenders("totals"), HasSubstr("n_triangles"));
}

TEST_F(BrokenTiles, ToleranceThatDoesNotFallIsSeen) {
  Manifest manifest = pyramid.manifest();
  manifest.levels[1].tolerance_m = manifest.levels[0].tolerance_m;
  pyramid.serve_manifest(manifest);
  EXPECT_THAT(failed_after(), Contains("manifest"));
  EXPECT_THAT(offenders("manifest"), HasSubstr("falls from level to level"));
}

TEST_F(BrokenTiles, MissingSiblingIsSeen) {
  Manifest manifest = pyramid.manifest();
  TileRun& run = manifest.levels.back().rows.back();
  if (run.x_first == run.x_last) {
    manifest.levels.back().rows.pop_back();
  } else {
    --run.x_last;
  }
  pyramid.serve_manifest(manifest);
  EXPECT_THAT(failed_after(), Contains("manifest"));
  EXPECT_THAT(offenders("manifest"), HasSubstr("sibling"));
}

TEST_F(BrokenTiles, WrongSinglePieceIsSeen) {
  const TileKey root{0, 0, 0};
  Bytes record = pyramid.body_of("body/" + text_of(root));
  record.back() ^= 1;
  pyramid.replace("body/" + text_of(root), record);
  EXPECT_EQ(failed_after(), std::set<std::string>{"pieces"});
}

TEST_F(BrokenTiles, WrongCodesAreSeen) {
  for (const TileKey& key : pyramid.tiles(1)) {
    const Bytes body = pyramid.body_of("codes/" + text_of(key));
    auto codes = nlohmann::json::parse(body.begin(), body.end());
    auto& run = codes["gaps"][0]["borders"][2]["runs"][0];
    run = run.get<int>() + 1;
    pyramid.replace_text("codes/" + text_of(key), codes.dump());
  }
  EXPECT_EQ(failed_after(), std::set<std::string>{"codes"});
  EXPECT_THAT(offenders("codes"), HasSubstr("/gaps/0/borders/2/runs/0"));
}

TEST_F(BrokenTiles, LayerJsonThatPromisesTooMuchOrTooLittleIsSeen) {
  const Bytes body = pyramid.body_of("layer.json");
  auto layer = nlohmann::json::parse(body.begin(), body.end());
  layer["available"][1] = {{{"startX", 0}, {"startY", 0}, {"endX", 0}, {"endY", 0}}};
  pyramid.replace_text("layer.json", layer.dump());
  EXPECT_EQ(failed_after(), std::set<std::string>{"layer-json"});
  layer.erase("available");
  pyramid.replace_text("layer.json", layer.dump());
  EXPECT_EQ(failed_after(), std::set<std::string>{"layer-json"});
}

TEST_F(BrokenTiles, TerrainTriangleTurnedOverIsSeen) {
  const TileKey key = busiest();
  const std::string path = text_of(key) + ".terrain?extensions=octvertexnormals";
  Bytes bytes = pyramid.body_of(path);
  const auto mesh = client::read_terrain(bytes);
  ASSERT_TRUE(mesh.has_value());
  // Move one inner vertex far away in u: some of its triangles turn over.
  for (std::uint32_t k = 0; k + 1 < mesh->u.size(); ++k) {
    if (mesh->u[k] < 3000 || mesh->u[k] > 29000 || mesh->v[k] < 3000 || mesh->v[k] > 29000) continue;
    const auto put = [&](std::uint32_t at, int delta) {
      const auto code = static_cast<std::uint16_t>((delta << 1) ^ (delta >> 31));
      std::memcpy(bytes.data() + 92 + 2 * at, &code, 2);
    };
    const int moved = mesh->u[k] > 16000 ? 1 : 32766, before = k == 0 ? 0 : mesh->u[k - 1];
    put(k, moved - before);
    put(k + 1, mesh->u[k + 1] - moved);
    break;
  }
  pyramid.replace(path, bytes);
  EXPECT_THAT(failed_after(), Contains("terrain"));
  EXPECT_THAT(offenders("terrain"), HasSubstr("turned over"));
}

// All heights a few hundred metres up, which is more than E_L: sound otherwise, a tile with borders of its own.
TEST_F(BrokenTiles, TerrainThatMissesThePostsIsSeen) {
  const TileKey key = busiest();
  const std::string path = text_of(key) + ".terrain?extensions=octvertexnormals";
  Bytes bytes = pyramid.body_of(path);
  for (const std::size_t at : {24, 28}) {  // lowest and highest height
    float height = 0;
    std::memcpy(&height, bytes.data() + at, 4);
    height += 900;
    std::memcpy(bytes.data() + at, &height, 4);
  }
  pyramid.replace(path, bytes);
  EXPECT_THAT(failed_after(), Contains("terrain-error"));
  EXPECT_THAT(offenders("terrain-error"), HasSubstr("as .terrain: post at longitude"));
}

TEST_F(BrokenTiles, TerrainHeaderHeightsAreCompared) {
  const TileKey key = busiest();
  const std::string path = text_of(key) + ".terrain?extensions=octvertexnormals";
  Bytes bytes = pyramid.body_of(path);
  float high = 0;
  std::memcpy(&high, bytes.data() + 28, 4);
  high += 20000;
  std::memcpy(bytes.data() + 28, &high, 4);
  pyramid.replace(path, bytes);
  EXPECT_THAT(failed_after(), Contains("terrain"));
  EXPECT_THAT(offenders("terrain"), HasSubstr("more than twice"));
}

TEST_F(BrokenTiles, NothingThereIsARefusalNotAPass) {
  client::VerifyOptions options;
  options.dataset = "nothing";
  const auto report = client::verify(pyramid, nullptr, options);
  ASSERT_FALSE(report.has_value());
  EXPECT_THAT(report.error(), HasSubstr("404"));
  pyramid.replace_text("meta.json", "{\"format\":\"tind\"}");
  options.dataset = "p";
  const auto broken = client::verify(pyramid, nullptr, options);
  ASSERT_FALSE(broken.has_value());
  EXPECT_THAT(broken.error(), HasSubstr("missing"));
}

TEST_F(BrokenTiles, WithoutSourceTheSourceChecksSayTheyDidNotRun) {
  client::VerifyOptions options;
  options.dataset = "p";
  options.cuts = 4;
  const auto report = client::verify(pyramid, nullptr, options);
  ASSERT_TRUE(report.has_value());
  EXPECT_TRUE((*report)->all_held()) << (*report)->text();
  EXPECT_THAT((*report)->find("source-error")->skipped(), HasSubstr("--source"));
  EXPECT_THAT((*report)->text(), HasSubstr("not run: no --source was given"));
}

TEST_F(BrokenTiles, SampleLooksAtFewerTilesAndStillHolds) {
  client::VerifyOptions options;
  options.dataset = "p";
  options.cuts = 8;
  options.sample = 0.3;
  const auto report = client::verify(pyramid, &world_posts(), options);
  ASSERT_TRUE(report.has_value());
  EXPECT_TRUE((*report)->all_held()) << (*report)->text();
  EXPECT_LT((*report)->tiles_checked, (*report)->tiles_stored);
  EXPECT_GE(static_cast<double>((*report)->tiles_checked), 0.3 * static_cast<double>((*report)->tiles_stored));
}

}  // namespace
}  // namespace tind::test
