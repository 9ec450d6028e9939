// SPDX-License-Identifier: GPL-3.0-or-later
// Every field of every kind of record is damaged, one at a time, in a small real pyramid. Damage is planted twice: as
// it is, where the content hash must tell, and with the hash made right again, where the structure must.
#include <cmath>

#include "storage/piece_blob.hpp"
#include "storage/zstd_codec.hpp"
#include "tests/storage/doctor_fixture.hpp"

namespace tind::test {
namespace {

TEST_F(DoctorTest, FindsNothingInASoundFile) {
  const CheckReport report = check(path("sound.tind"));
  EXPECT_TRUE(report.is_sound()) << text_of(report);
  EXPECT_EQ(report.n_levels, 11);
  EXPECT_GT(report.n_tiles, 30u);
  EXPECT_GT(report.n_triangles, 1000u);
  // Nor in one that LMDB wrote anew, which the other cases build on.
  DamagedStore store(path("sound.tind"));
  EXPECT_EQ(store.manifest()["content_hash"], report.content_hash);
  EXPECT_TRUE(check(store).is_sound()) << text_of(check(store));
  store.renew_hash();
  EXPECT_EQ(store.manifest()["content_hash"], report.content_hash);
}

TEST_F(DoctorTest, ChecksFilesOfOlderBuilders) {
  DamagedStore store(path("sound.tind"));
  EXPECT_EQ(store.manifest()["content_hash"].get<std::string>().size(), 32u);
  store.renew_hash(ContentHash::Kind::kFnv1a);
  EXPECT_EQ(store.manifest()["content_hash"].get<std::string>().size(), 16u);
  EXPECT_TRUE(check(store).is_sound()) << text_of(check(store));
  EXPECT_EQ(check(store).content_hash, store.manifest()["content_hash"]);
  // Only the hash can tell.
  store.change_corner({PieceKind::kCorner, kLevel, tile_.x | 1u, tile_.y | 1u}, [](Corner& c) { ++c.z; });
  EXPECT_TRUE(has_fault(check(store), "manifest", "content_hash"));
  // Half of one hash is none of the other.
  DamagedStore cut(path("sound.tind"));
  cut.change_manifest(
      [](nlohmann::json& json) { json["content_hash"] = json["content_hash"].get<std::string>().substr(0, 16); });
  EXPECT_TRUE(has_fault(check(cut), "manifest", "content_hash"));
}

TEST_F(DoctorTest, FindsDamagedCorners) {
  const PieceKey corner{PieceKind::kCorner, kLevel, tile_.x & ~1u, tile_.y & ~1u};  // one that level 8 has, too
  expect_found(
      "z", [&](DamagedStore& s) { s.change_corner(corner, [](Corner& c) { ++c.z; }); }, name_of(corner),
      "on the line at level 8");
  expect_found(
      "tag", [&](DamagedStore& s) { s.value(corner)[0] = 'c'; }, name_of(corner), "broken corner");
  expect_found(
      "trailing byte", [&](DamagedStore& s) { s.value(corner).push_back(0); }, name_of(corner), "broken corner");
  expect_found(
      "cut off", [&](DamagedStore& s) { s.value(corner).pop_back(); }, name_of(corner), "broken corner");
  expect_found(
      "empty", [&](DamagedStore& s) { s.value(corner).clear(); }, name_of(corner), "empty value");
  // In the middle of a tile of level 8 no level above has the corner: only the content hash can tell of its height.
  DamagedStore store(path("sound.tind"));
  store.change_corner({PieceKind::kCorner, kLevel, tile_.x | 1u, tile_.y | 1u}, [](Corner& c) { ++c.z; });
  EXPECT_TRUE(has_fault(check(store), "manifest", "content_hash"));
}

TEST_F(DoctorTest, FindsDamagedEdges) {
  const std::string edge = name_of(south_), tile = name_of(tile_);
  expect_edge_fault(
      "start_entry", [](EdgeChain& e) { e.start_entry ^= 1; }, edge, "start corner has entry level");
  expect_edge_fault(
      "end_entry", [](EdgeChain& e) { e.end_entry ^= 1; }, edge, "end corner has entry level");
  expect_edge_fault(
      "entry of an old vertex", [&](EdgeChain& e) { e.inner[old_vertex_].entry ^= 1; }, edge, "line at level 8");
  expect_edge_fault(
      "entry made new", [&](EdgeChain& e) { e.inner[old_vertex_].entry = 9; }, edge, "at level 8");
  expect_edge_fault(
      "entry of a new vertex", [&](EdgeChain& e) { e.inner[new_vertex_].entry = 8; }, edge, "line at level 8");
  expect_edge_fault(
      "entry below its level", [&](EdgeChain& e) { e.inner[new_vertex_].entry = 10; }, edge, "line at level 8");
  expect_edge_fault(
      "t of an old vertex", [&](EdgeChain& e) { ++e.inner[old_vertex_].t; }, edge, "line at level 8");
  expect_edge_fault(
      "z of an old vertex", [&](EdgeChain& e) { ++e.inner[old_vertex_].z; }, edge, "line at level 8");
  // A new vertex is on the lines below: there it is missing.
  expect_edge_fault(
      "t of a new vertex", [&](EdgeChain& e) { ++e.inner[new_vertex_].t; }, "edge h 10/", "line at level 9");
  expect_edge_fault(
      "z of a new vertex", [&](EdgeChain& e) { ++e.inner[new_vertex_].z; }, "10/", "line at level 9");
  expect_edge_fault(
      "n", [](EdgeChain& e) { e.inner.pop_back(); }, tile, "counts other border vertices");
  expect_edge_fault(
      "t beyond the side", [](EdgeChain& e) { e.inner.back().t += std::int64_t{1} << 40; }, edge, "along a side of");
  const auto raw = [&](const std::string& field, const std::function<void(Bytes&)>& change) {
    expect_found(
        "edge: " + field,
        [&](DamagedStore& s) {
          Bytes record = unpack_value(s.value(south_)).value();
          change(record);
          s.value(south_) = record;
        },
        edge, "broken edge");
  };
  raw("tag", [](Bytes& r) { r[0] = 'B'; });
  raw("n too large", [](Bytes& r) { r[1] = 0x7f; });
  raw("trailing byte", [](Bytes& r) { r.push_back(0); });
  raw("cut off", [](Bytes& r) { r.pop_back(); });
  raw("step of nothing", [](Bytes& r) { r = {'E', 1, 9, 9, 9, 0, 0}; });
}

TEST_F(DoctorTest, FindsEntryLevelsOfALineThatBeginsHere) {
  const PieceKey first{PieceKind::kEdgeH, kLevel, tile_.x, tile_.y + 1};  // odd: no level above has the line
  for (const auto& [field, change] : std::map<std::string, std::function<void(EdgeChain&)>>{
           {"start", [](EdgeChain& e) { e.start_entry = 8; }},
           {"end", [](EdgeChain& e) { e.end_entry = 10; }},
           {"inner", [](EdgeChain& e) { e.inner.front().entry = 8; }}}) {
    expect_found(
        field, [&](DamagedStore& s) { s.change_edge(first, change); }, name_of(first), "begins at level 9");
  }
}

TEST_F(DoctorTest, FindsHeightsThatDifferAlongAPole) {
  const PieceKey pole{PieceKind::kEdgeH, 0, 0, 0};
  expect_found(
      "pole", [&](DamagedStore& s) { s.change_edge(pole, [](EdgeChain& e) { ++e.inner.front().z; }); }, name_of(pole),
      "along a pole");
}

TEST_F(DoctorTest, FindsDamagedBodies) {
  const auto fault = [&](const char* field, const std::function<void(TileBody&)>& change, const char* what) {
    expect_body_fault(field, change, what);
  };
  fault(
      "min_z", [](TileBody& b) { --b.stats.min_z; }, "min_z");
  fault(
      "max_z", [](TileBody& b) { ++b.stats.max_z; }, "max_z");
  fault(
      "max_error beyond E", [](TileBody& b) { b.stats.max_error_m = 1e6f; }, "max_error");
  fault(
      "max_error negative", [](TileBody& b) { b.stats.max_error_m = -1; }, "max_error");
  fault(
      "max_error not a number", [](TileBody& b) { b.stats.max_error_m = std::nanf(""); }, "max_error");
  fault(
      "rmse beyond max_error", [](TileBody& b) { b.stats.rmse_m = b.stats.max_error_m * 1.01f; }, "rmse");
  fault(
      "rmse not a number", [](TileBody& b) { b.stats.rmse_m = std::nanf(""); }, "rmse");
  fault(
      "n_posts", [](TileBody& b) { b.stats.n_posts = 0; }, "n_posts");
  fault(
      "coverage filler", [](TileBody& b) { b.stats.coverage = TileCoverage::kFiller; }, "coverage");
  for (std::size_t k = 0; k < 4; ++k) {
    fault(
        "n_side", [k](TileBody& b) { ++b.n_side[k]; }, "counts other border vertices");
  }
  fault(
      "n_interior",
      [](TileBody& b) {
        b.interior.push_back({1, 1, b.stats.min_z});
      },
      "interior vertices");
  fault(
      "interior twice", [](TileBody& b) { b.interior[1] = b.interior[0]; }, "Morton order");
  fault(
      "interior order", [](TileBody& b) { std::swap(b.interior[0], b.interior[1]); }, "Morton order");
  fault(
      "x outside", [](TileBody& b) { b.interior[0].x = -1; }, "outside the tile");
  fault(
      "y outside", [](TileBody& b) { b.interior.back().y = std::int64_t{1} << 40; }, "outside the tile");
  fault(
      "interior moved across",
      [](TileBody& b) {
        b.interior.front() = {1, 1, b.interior.front().z};
      },
      "triangle");
  fault(
      "z beyond max_z", [](TileBody& b) { b.interior[2].z = b.stats.max_z + 1; }, "max_z");
  fault(
      "z below min_z", [](TileBody& b) { b.interior[2].z = b.stats.min_z - 1; }, "min_z");
  fault(
      "n_triangles", [](TileBody& b) { b.triangles.pop_back(); }, "triangles: ");
  fault(
      "triangle twice", [](TileBody& b) { b.triangles[3] = b.triangles[2]; }, "out of order");
  fault(
      "triangle turned over", [](TileBody& b) { std::swap(b.triangles[2][1], b.triangles[2][2]); }, "triangle");
  fault(
      "triangle rotated",
      [](TileBody& b) {
        auto& t = b.triangles[2];
        t = {t[1], t[2], t[0]};
      },
      "smallest index");
  fault(
      "triangles in another order", [](TileBody& b) { std::swap(b.triangles[2], b.triangles[4]); }, "out of order");
  fault(
      "index of no vertex", [](TileBody& b) { b.triangles.back()[2] = 1u << 30; }, "vertex that does not exist");
  fault(
      "another vertex",
      [](TileBody& b) {
        auto& t = b.triangles.back();
        t[2] = t[2] == t[0] + 1 ? t[2] + 1 : t[0] + 1;
      },
      "triangle");
  fault(
      "n_gaps",
      [](TileBody& b) {
        ++b.n_gaps;
        for (auto& vt : b.virtual_triangles) vt.runs.resize(std::size_t{vt.n_edges} * b.n_gaps);
      },
      "n_gaps");
  fault(
      "n_vts", [](TileBody& b) { b.virtual_triangles.pop_back(); }, "virtual triangles");
  fault(
      "no vts", [](TileBody& b) { b.virtual_triangles.clear(); }, "virtual triangles");
  fault(
      "vt triangle", [](TileBody& b) { b.virtual_triangles[1].triangle ^= 1; }, "virtual triangle");
  fault(
      "vt of no triangle", [](TileBody& b) { b.virtual_triangles[1].triangle = 1u << 30; }, "virtual triangle");
  fault(
      "vt border", [](TileBody& b) { b.virtual_triangles[1].border ^= 2; }, "virtual triangle");
  fault(
      "vt interval", [](TileBody& b) { b.virtual_triangles[1].interval ^= 1; }, "virtual triangle");
  fault(
      "vt n_edges",
      [](TileBody& b) {
        auto& vt = b.virtual_triangles[1];
        vt.n_edges = static_cast<std::uint8_t>(3 - vt.n_edges);
        vt.runs.resize(std::size_t{vt.n_edges} * b.n_gaps);
      },
      "virtual triangle");
  fault(
      "vt order", [](TileBody& b) { std::swap(b.virtual_triangles[1], b.virtual_triangles[2]); }, "virtual triangle");
  fault(
      "runs", [](TileBody& b) { ++b.virtual_triangles[1].runs.back(); }, "run r_");
  fault(
      "runs of the first", [](TileBody& b) { ++b.virtual_triangles[0].runs.front(); }, "run r_");
  // A height inside the tile, between the lowest and the highest: nothing but the hash can tell.
  DamagedStore store(path("sound.tind"));
  store.change_body(tile_, [](TileBody& b) {
    for (LocalVertex& v : b.interior) {
      if (v.z > b.stats.min_z + 1 && v.z < b.stats.max_z - 1) ++v.z;
    }
  });
  const CheckReport hidden = check(store);
  EXPECT_TRUE(has_fault(hidden, "manifest", "content_hash")) << text_of(hidden);
}

TEST_F(DoctorTest, FindsBodiesThatAreNoRecords) {
  const auto raw = [&](const std::string& field, const std::function<void(Bytes&)>& change) {
    expect_found(
        "body: " + field,
        [&](DamagedStore& s) {
          Bytes record = unpack_value(s.value(body_)).value();
          change(record);
          s.value(body_) = record;
        },
        name_of(tile_), "body");
  };
  raw("tag", [](Bytes& r) { r[0] = 'E'; });
  raw("coverage", [](Bytes& r) { r[1] = 3; });
  raw("trailing byte", [](Bytes& r) { r.push_back(0); });
  raw("cut off", [](Bytes& r) { r.pop_back(); });
  raw("shape", [](Bytes& r) { r.resize(20); });
  raw("nothing but a tag", [](Bytes& r) { r.resize(1); });
}

}  // namespace
}  // namespace tind::test
