// SPDX-License-Identifier: GPL-3.0-or-later
// Borders broken on purpose: the right check must see it.
#include <algorithm>
#include <cstring>

#include "tests/client/terrain_decode.hpp"
#include "tests/client_checks/checks_of.hpp"

namespace tind::test {
namespace {

using testing::Contains;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

class BrokenBorders : public testing::Test {
 protected:
  MemoryPyramid pyramid{small_world().tind};
  const int bottom = pyramid.manifest().bottom_level;

  /// A tile of the level with an east neighbour and at least two inner vertices on its east edge.
  TileKey tile_with_east_edge(int level) {
    for (const TileKey& key : pyramid.tiles(level)) {
      const TileKey east{key.level, (key.x + 1) % TileKey::count_x(level), key.y};
      if (pyramid.manifest().has_tile(east) && pyramid.pieces(key).edges[1].inner.size() >= 2) return key;
    }
    ADD_FAILURE() << "no tile of level " << level << " has an east edge to break";
    return {};
  }
  TileKey east_of(const TileKey& key) { return {key.level, (key.x + 1) % TileKey::count_x(key.level), key.y}; }
  /// A level whose tiles have tiles below them.
  int middle() const { return bottom - 1; }
};

TEST_F(BrokenBorders, NothingBrokenEveryCheckHolds) {
  const auto report = run_checks(pyramid, 60);
  ASSERT_NE(report, nullptr);
  EXPECT_THAT(failed_checks(*report), IsEmpty()) << report->text();
  EXPECT_TRUE(report->all_held());
  for (const char* id :
       {"source-error", "tessellated-error", "cut-error", "runs", "cuts", "terrain-borders", "totals"}) {
    EXPECT_EQ(report->find(id)->skipped(), "") << id;
    EXPECT_GT(report->find(id)->count(), 0u) << id;
  }
  // The data lie across longitude 180, and the cuts meet large gaps there.
  EXPECT_GE(report->cuts.joints_by_gap.size(), static_cast<std::size_t>(bottom) + 1);
}

TEST_F(BrokenBorders, MovedEdgeVertexIsSeenAsSharedEdge) {
  const TileKey key = tile_with_east_edge(bottom);
  TilePieces pieces = pyramid.pieces(key);
  pieces.edges[1].inner[1].t += 1;
  pyramid.serve_pieces(key, pieces);
  const auto report = run_checks(pyramid);
  const auto failed = failed_checks(*report);
  EXPECT_THAT(failed, Contains("shared-edges"));
  EXPECT_THAT(failed, Contains("cuts")) << "the crack is open in the cut that is divided everywhere";
  EXPECT_THAT(failed, Not(Contains("assembly"))) << "parts and assembled tile agree";
  EXPECT_THAT(offenders_of(*report, "shared-edges"), HasSubstr(text_of(key)));
}

TEST_F(BrokenBorders, RaisedEdgeVertexOpensTheCuts) {
  const TileKey key = tile_with_east_edge(bottom);
  TilePieces pieces = pyramid.pieces(key);
  pieces.edges[1].inner[0].z += 1;
  pyramid.serve_pieces(key, pieces);
  const auto report = run_checks(pyramid);
  EXPECT_THAT(failed_checks(*report), Contains("shared-edges"));
  EXPECT_THAT(offenders_of(*report, "cuts"), HasSubstr("another height"));
}

TEST_F(BrokenBorders, DroppedEdgeVertexIsSeen) {
  const TileKey key = tile_with_east_edge(bottom);
  VirtualNode node = pyramid.node(key);
  // The first inner vertex of the east border falls onto C1: its triangles collapse or stretch, no hole opens.
  const std::uint32_t gone = node.n_side[0] + 2;
  node.vertices.erase(node.vertices.begin() + gone);
  node.side_entries[1].erase(node.side_entries[1].begin() + 1);
  --node.n_side[1];
  std::vector<Triangle> kept;
  for (Triangle t : node.triangles) {
    for (auto& index : t) index -= index >= gone ? 1 : 0;
    if (t[0] != t[1] && t[1] != t[2] && t[0] != t[2]) kept.push_back(t);
  }
  node.triangles = kept;
  node.virtual_triangles.clear();
  pyramid.serve_node(key, node);
  const auto report = run_checks(pyramid);
  const auto failed = failed_checks(*report);
  EXPECT_THAT(failed, Contains("shared-edges"));
  EXPECT_THAT(failed, Contains("assembly"));
  EXPECT_THAT(failed, Contains("cuts"));
  EXPECT_THAT(offenders_of(*report, "assembly"), HasSubstr("numbers of border vertices"));
}

TEST_F(BrokenBorders, DroppedVertexOnBothSidesIsSeenAsNesting) {
  // Both tiles beside a bottom edge lose the same old vertex: they agree with each other, but not with the level above.
  for (const TileKey& key : pyramid.tiles(bottom)) {
    if (!pyramid.manifest().has_tile(east_of(key))) continue;
    TilePieces west = pyramid.pieces(key);
    auto& inner = west.edges[1].inner;
    const auto old = std::find_if(inner.begin(), inner.end(), [&](const EdgeVertex& v) { return v.entry < bottom; });
    if (old == inner.end()) continue;
    const auto at = old - inner.begin();
    // Instead of a new triangulation: the vertex stays, its entry level is one that the level above does not keep.
    old->entry = static_cast<std::uint8_t>(bottom);
    pyramid.serve_pieces(key, west);
    TilePieces east = pyramid.pieces(east_of(key));
    east.edges[3].inner[static_cast<std::size_t>(at)].entry = static_cast<std::uint8_t>(bottom);
    pyramid.serve_pieces(east_of(key), east);
    const auto report = run_checks(pyramid);
    const auto failed = failed_checks(*report);
    EXPECT_THAT(failed, Contains("nested-borders"));
    EXPECT_THAT(failed, Not(Contains("shared-edges")));
    EXPECT_THAT(failed, Contains("cuts")) << "the coarse neighbour's vertex is appended instead of ending an interval";
    return;
  }
  FAIL() << "no bottom edge holds an older vertex";
}

TEST_F(BrokenBorders, EntryLevelBelowTheLineIsSeen) {
  for (const TileKey& key : pyramid.tiles(bottom)) {
    // A meridian with an odd index is first used at this very level.
    if (key.x % 2 != 0 || !pyramid.manifest().has_tile(east_of(key))) continue;
    TilePieces west = pyramid.pieces(key), east = pyramid.pieces(east_of(key));
    if (west.edges[1].inner.empty()) continue;
    west.edges[1].inner[0].entry = east.edges[3].inner[0].entry = 0;
    pyramid.serve_pieces(key, west);
    pyramid.serve_pieces(east_of(key), east);
    const auto report = run_checks(pyramid);
    EXPECT_THAT(failed_checks(*report), Contains("nested-borders"));
    EXPECT_THAT(offenders_of(*report, "nested-borders"), HasSubstr("outside the line's levels"));
    return;
  }
  FAIL() << "no such edge";
}

TEST_F(BrokenBorders, SwappedNeighbourIsSeen) {
  const TileKey key = tile_with_east_edge(bottom);
  // The neighbour's pieces under this tile's own address and name.
  pyramid.serve_pieces(key, pyramid.pieces(east_of(key)));
  const auto report = run_checks(pyramid);
  EXPECT_THAT(failed_checks(*report), Contains("shared-edges"));
  EXPECT_THAT(failed_checks(*report), Contains("cuts"));
}

TEST_F(BrokenBorders, NeighbourUnderItsOwnNameAtTheWrongAddressIsSeen) {
  const TileKey key = tile_with_east_edge(bottom);
  pyramid.replace(text_of(key) + ".vn", pyramid.body_of(text_of(east_of(key)) + ".vn"));
  const auto report = run_checks(pyramid);
  EXPECT_THAT(failed_checks(*report), Contains("tile-header"));
  EXPECT_THAT(offenders_of(*report, "tile-header"), HasSubstr("its header says it is " + text_of(east_of(key))));
}

TEST_F(BrokenBorders, WrongCornerHeightIsSeen) {
  const TileKey key = tile_with_east_edge(bottom);
  TilePieces pieces = pyramid.pieces(key);
  pieces.corners[2].z += 3;
  pyramid.serve_pieces(key, pieces);
  const auto report = run_checks(pyramid);
  EXPECT_THAT(failed_checks(*report), Contains("shared-corners"));
  EXPECT_THAT(offenders_of(*report, "shared-corners"), HasSubstr(text_of(key)));
}

TEST_F(BrokenBorders, WrongPoleHeightIsSeen) {
  TilePieces pieces = pyramid.pieces({0, 1, 0});
  pieces.corners[2].z += 1;
  pyramid.serve_pieces({0, 1, 0}, pieces);
  const auto report = run_checks(pyramid);
  EXPECT_THAT(offenders_of(*report, "shared-corners"), HasSubstr("pole"));
}

TEST_F(BrokenBorders, WrongRunIsSeenAndNothingElse) {
  for (const TileKey& key : pyramid.tiles(middle())) {
    TilePieces pieces = pyramid.pieces(key);
    auto& vts = pieces.body.virtual_triangles;
    if (vts.empty() || pieces.body.n_gaps == 0 || pyramid.manifest().has_tile(key.child(0)) == false) continue;
    vts[0].runs.back() += 1;
    pyramid.serve_pieces(key, pieces);
    const auto report = run_checks(pyramid);
    EXPECT_EQ(failed_checks(*report), std::set<std::string>{"runs"});
    EXPECT_THAT(offenders_of(*report, "runs"), HasSubstr("tile " + text_of(key) + ": r_"));
    return;
  }
  FAIL() << "no tile with runs";
}

TEST_F(BrokenBorders, TerrainBorderHeightOffByOneStepIsSeen) {
  for (const TileKey& key : pyramid.tiles(bottom)) {
    const std::string path = text_of(key) + ".terrain?extensions=octvertexnormals";
    Bytes bytes = pyramid.body_of(path);
    const auto mesh = client::read_terrain(bytes);
    ASSERT_TRUE(mesh.has_value()) << mesh.error();
    if (!pyramid.manifest().has_tile(east_of(key)) || mesh->edges[2].size() < 3) continue;
    const std::uint32_t vertex = mesh->edges[2][1];
    if (mesh->h[vertex] == 32767 || vertex + 1 == mesh->u.size()) continue;
    // One step up for this vertex: its delta grows by one, the next one's falls by one.
    const auto put = [&](std::uint32_t k, int delta) {
      const auto code = static_cast<std::uint16_t>((delta << 1) ^ (delta >> 31));
      std::memcpy(bytes.data() + 92 + 2 * (2 * mesh->u.size() + k), &code, 2);
    };
    const int before = vertex == 0 ? 0 : mesh->h[vertex - 1];
    put(vertex, mesh->h[vertex] + 1 - before);
    put(vertex + 1, mesh->h[vertex + 1] - (mesh->h[vertex] + 1));
    pyramid.replace(path, bytes);
    const auto report = run_checks(pyramid);
    EXPECT_EQ(failed_checks(*report), std::set<std::string>{"terrain-borders"});
    EXPECT_THAT(offenders_of(*report, "terrain-borders"), HasSubstr("height"));
    return;
  }
  FAIL() << "no tile to break";
}

TEST_F(BrokenBorders, TerrainBorderNormalIsSeen) {
  for (const TileKey& key : pyramid.tiles(bottom)) {
    const std::string path = text_of(key) + ".terrain?extensions=octvertexnormals";
    Bytes bytes = pyramid.body_of(path);
    const auto mesh = client::read_terrain(bytes);
    if (!pyramid.manifest().has_tile(east_of(key))) continue;
    ASSERT_FALSE(mesh->normals.empty());
    // The normals are the last bytes of the file here.
    bytes[bytes.size() - 2 * mesh->normals.size() + 2 * mesh->edges[2][0]] ^= 1;
    pyramid.replace(path, bytes);
    const auto report = run_checks(pyramid);
    EXPECT_EQ(failed_checks(*report), std::set<std::string>{"terrain-borders"});
    return;
  }
  FAIL() << "no tile to break";
}

}  // namespace
}  // namespace tind::test
