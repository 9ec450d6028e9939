// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/route.hpp"

#include <gtest/gtest.h>

namespace tind {
namespace {

std::string scratch;

// Its views are good until the next call.
template <class R>
R route(const char* target) {
  const auto parsed = parse_target(target, scratch);
  const auto* found = std::get_if<Target>(&parsed);
  EXPECT_NE(found, nullptr) << target;
  if (!found) return {};
  const R* as = std::get_if<R>(&found->route);
  EXPECT_NE(as, nullptr) << target;
  return as ? *as : R{};
}
int status(const std::string& target) {
  const auto parsed = parse_target(target, scratch);
  return std::holds_alternative<int>(parsed) ? std::get<int>(parsed) : 200;
}

TEST(Route, FindsEveryRouteOfTheTable) {
  route<IndexRoute>("/");
  route<DatasetsRoute>("/datasets");
  route<HealthRoute>("/health");
  route<ReadyRoute>("/ready");
  route<ScriptRoute>("/tind/globe.js");
  route<StyleRoute>("/tind/style.css");
  EXPECT_EQ(route<CesiumRoute>("/cesium/Widgets/widgets.css").path, "Widgets/widgets.css");
  EXPECT_EQ(route<DirectoryRoute>("/alps").name, "alps");
  EXPECT_EQ(route<DocumentRoute>("/alps/").document, DatasetDocument::kGlobe);
  EXPECT_EQ(route<DocumentRoute>("/alps/meta.json").document, DatasetDocument::kMeta);
  EXPECT_EQ(route<DocumentRoute>("/alps/layer.json").document, DatasetDocument::kLayer);
  const auto tile = route<TileRoute>("/alps/3/15/7.terrain");
  EXPECT_EQ(tile.name, "alps");
  EXPECT_EQ(tile.key, (TileKey{3, 15, 7}));
  EXPECT_EQ(tile.format, TileFormat::kTerrain);
  EXPECT_EQ(route<TileRoute>("/alps/0/1/0.vn").format, TileFormat::kVn);
  EXPECT_EQ(route<TileRoute>("/alps/0/1/0.parts").format, TileFormat::kParts);
  EXPECT_EQ(route<PieceRoute>("/alps/corner/1/4/2").key, (PieceKey{PieceKind::kCorner, 1, 4, 2}));
  EXPECT_EQ(route<PieceRoute>("/alps/edge/1/h/3/2").key, (PieceKey{PieceKind::kEdgeH, 1, 3, 2}));
  EXPECT_EQ(route<PieceRoute>("/alps/edge/1/v/4/1").key, (PieceKey{PieceKind::kEdgeV, 1, 4, 1}));
  EXPECT_EQ(route<PieceRoute>("/alps/body/1/3/1").key, (PieceKey{PieceKind::kBody, 1, 3, 1}));
  EXPECT_EQ(route<CodesRoute>("/alps/codes/1/3/1").key, (TileKey{1, 3, 1}));
}

TEST(Route, KeysOutOfRangeAre404) {
  for (const char* target : {"/a/0/2/0.vn",
                             "/a/0/0/1.vn",
                             "/a/29/0/0.vn",
                             "/a/1/4/0.terrain",
                             "/a/4294967296/0/0.vn",
                             "/a/0/0/4294967296.vn",
                             "/a/corner/0/3/0",
                             "/a/corner/0/0/2",
                             "/a/edge/0/h/2/0",
                             "/a/edge/0/v/0/1",
                             "/a/body/0/0/1",
                             "/a/codes/0/2/0",
                             "/a/edge/0/x/0/0",
                             "/a/0/0/0.png",
                             "/a/0/0/0",
                             "/a/0/0/.vn",
                             "/a/00/0/0.vn",
                             "/a/0/01/0.vn",
                             "/a/+0/0/0.vn",
                             "/a/-0/0/0.vn",
                             "/a/0/0/0.vn/",
                             "/a/b",
                             "/a/0/0",
                             "/a/x/0/0/0",
                             "/tind/x",
                             "/a/0x0/0/0.vn"}) {
    EXPECT_EQ(status(target), 404) << target;
  }
}

TEST(Route, MalformedTargetsAre400) {
  for (const char* target :
       {"", "x", "*", "/%", "/%4", "/%zz", "/a b", "/a\x80", "/a\x01", "/a#b", "ftp://h/", "//\x7f"}) {
    EXPECT_EQ(status(target), 400) << target;
  }
}

TEST(Route, CesiumPathsCannotLeaveTheDirectory) {
  for (const char* target :
       {"/cesium/../x", "/cesium/%2e%2e/x", "/cesium/a/../../x", "/cesium/..%2fx", "/cesium//x", "/cesium/.hidden",
        "/cesium/a%00b", "/cesium/a%5c..%5cb", "/cesium/", "/cesium/a/", "/cesium/%2fetc/passwd"}) {
    EXPECT_EQ(status(target), 404) << target;
  }
}

TEST(Route, DecodesNamesAndKeepsTheQuery) {
  EXPECT_EQ(route<DocumentRoute>("/Monte%20Rosa/").name, "Monte Rosa");
  std::string odd = percent_encode("Gro\xc3\x9f/a");
  odd.insert(0, 1, '/').push_back('/');
  EXPECT_EQ(route<DocumentRoute>(odd.c_str()).name, "Gro\xc3\x9f/a");
  const auto parsed = parse_target("/a/0/0/0.terrain?v=12&extensions=octvertexnormals-metadata&x", scratch);
  const auto query = std::get<Target>(parsed).query;
  EXPECT_EQ(query_value(query, "v"), "12");
  EXPECT_EQ(query_value(query, "extensions"), "octvertexnormals-metadata");
  EXPECT_EQ(query_value(query, "x"), "");
  EXPECT_EQ(query_value(query, "y"), std::nullopt);
  EXPECT_EQ(query_value("v=%", "v"), std::nullopt);
}

TEST(Route, TakesAbsoluteForm) {
  route<HealthRoute>("http://example.org/health");
  route<IndexRoute>("https://example.org");
  EXPECT_EQ(status("http://example.org?x"), 400);
}

TEST(Route, ReservedNames) {
  for (const char* name : {"datasets", "health", "ready", "cesium", "tind"}) EXPECT_TRUE(is_reserved_name(name));
  EXPECT_FALSE(is_reserved_name("alps"));
}

}  // namespace
}  // namespace tind
