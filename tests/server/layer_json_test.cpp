// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/layer_json.hpp"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <random>
#include <set>

namespace tind {
namespace {

TEST(LayerJson, RectanglesCoverExactlyTheStoredTiles) {
  std::mt19937 random(3);
  for (int round = 0; round < 50; ++round) {
    std::vector<TileRun> rows;
    std::set<std::pair<std::uint32_t, std::uint32_t>> stored, covered;
    for (std::uint32_t y = 0; y < 12; ++y) {
      for (std::uint32_t x = 0; x < 20;) {
        const std::uint32_t length = 1 + random() % 6;
        if (random() % 3 != 0) {
          rows.push_back({y, x, x + length - 1, static_cast<TileCoverage>(random() % 3)});
          for (std::uint32_t k = 0; k < length; ++k) stored.emplace(x + k, y);
        }
        x += length;
      }
    }
    for (const TileRectangle& r : available_rectangles(rows)) {
      for (std::uint32_t y = r.y_first; y <= r.y_last; ++y) {
        for (std::uint32_t x = r.x_first; x <= r.x_last; ++x) EXPECT_TRUE(covered.emplace(x, y).second);
      }
    }
    EXPECT_EQ(covered, stored);
  }
}

TEST(LayerJson, JoinsRunsAndRows) {
  const std::vector<TileRun> rows = {{2, 4, 5, TileCoverage::kFiller},
                                     {2, 6, 9, TileCoverage::kReal},
                                     {3, 4, 9, TileCoverage::kReal},
                                     {4, 4, 9, TileCoverage::kPartial},
                                     {6, 4, 9, TileCoverage::kReal}};
  EXPECT_EQ(available_rectangles(rows), (std::vector<TileRectangle>{{4, 2, 9, 4}, {4, 6, 9, 6}}));
  EXPECT_TRUE(available_rectangles({}).empty());
}

TEST(LayerJson, HasEveryFieldThatAClientNeeds) {
  Manifest manifest;
  manifest.attribution = "someone";
  manifest.heights = "ellipsoidal";
  manifest.vertical_datum = "WGS 84";
  manifest.bounds_deg = {1, 2, 3, 4};
  for (int level = 0; level < 3; ++level) {
    LevelInfo info;
    info.level = level;
    info.rows = {{0, 0, 1, TileCoverage::kReal}};
    manifest.levels.push_back(info);
  }
  const auto layer = nlohmann::json::parse(make_layer_json(manifest, {"n", "abc", rows_of(manifest), ""}));
  EXPECT_EQ(layer.at("format"), "quantized-mesh-1.0");
  EXPECT_EQ(layer.at("scheme"), "tms");
  EXPECT_EQ(layer.at("projection"), "EPSG:4326");
  EXPECT_EQ(layer.at("tilejson"), "2.1.0");
  EXPECT_TRUE(layer.at("version").is_string());
  EXPECT_EQ(layer.at("minzoom"), 0);
  EXPECT_EQ(layer.at("maxzoom"), 2);
  EXPECT_EQ(layer.at("bounds"), nlohmann::json({1.0, 2.0, 3.0, 4.0}));
  EXPECT_EQ(layer.at("tiles"), nlohmann::json::array({"{z}/{x}/{y}.terrain?v=abc"}));
  EXPECT_EQ(layer.at("extensions"), nlohmann::json::array({"octvertexnormals"}));
  EXPECT_EQ(layer.at("attribution"), "someone");
  EXPECT_EQ(layer.at("heights"), "ellipsoidal");
  EXPECT_EQ(layer.at("vertical_datum"), "WGS 84");
  EXPECT_FALSE(layer.contains("metadataAvailability"));
  EXPECT_FALSE(layer.contains("parentUrl"));
  const auto child = nlohmann::json::parse(make_layer_json(manifest, {"n", "abc", rows_of(manifest), "the base"}));
  EXPECT_EQ(child.at("parentUrl"), "../the%20base/");
  ASSERT_EQ(layer.at("available").size(), 3u);
  EXPECT_EQ(layer.at("available")[1], nlohmann::json::parse(R"([{"startX":0,"startY":0,"endX":1,"endY":0}])"));
}

}  // namespace
}  // namespace tind
