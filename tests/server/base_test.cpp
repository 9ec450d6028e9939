// SPDX-License-Identifier: GPL-3.0-or-later
// Datasets over bases, through the handler (docs/http.md, "Datasets that change, and datasets over others").
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "server/catalog.hpp"
#include "server/handler.hpp"
#include "test_site.hpp"

namespace tind {
namespace {

using testing::HasSubstr;

struct Answer {
  int status;
  std::string fields, body;
  std::string field(const std::string& name) const {
    const std::string all = "\r\n" + fields;
    const auto at = all.find("\r\n" + name + ": ");
    if (at == all.npos) return "";
    const auto begin = at + name.size() + 4;
    return all.substr(begin, all.find("\r\n", begin) - begin);
  }
};

// The region has a third level. Its data lie around tile 1/2/1 (real); 1/2/0 is partly inside, the rest is not.
TileCoverage region_coverage(const TileKey& key) {
  const std::uint32_t x1 = key.level == 2 ? key.x / 2 : key.x, y1 = key.level == 2 ? key.y / 2 : key.y;
  if (key.level == 0) return key.x == 1 ? TileCoverage::kPartial : TileCoverage::kFiller;
  if (x1 == 2 && y1 == 1) return TileCoverage::kReal;
  return x1 == 2 && y1 == 0 ? TileCoverage::kPartial : TileCoverage::kFiller;
}

class BaseTest : public testing::Test {
 protected:
  void open(BaseMode mode) {
    test::write_pyramid(path("base.tind"), 60);
    test::write_pyramid(path("region.tind"), 40, std::nullopt, 3, region_coverage);
    Settings settings;
    DatasetSpec region(path("region.tind"));
    region.base = "base";
    region.base_mode = mode;
    DatasetSpec alone(path("region.tind"));
    alone.name = "alone";
    settings.datasets = {region, {path("base.tind")}, alone};
    auto catalog = Catalog::open(settings);
    ASSERT_TRUE(catalog.has_value()) << catalog.error().message;
    catalog_ = std::move(*catalog);
    state_ = std::make_unique<WorkerState>(catalog_->holder());
    handler_ = std::make_unique<Handler>(settings);
  }
  Answer get(const std::string& target, const std::string& if_none_match = {}) {
    Request request;
    request.method = "GET";
    request.target = target;
    if (!if_none_match.empty()) request[RequestField::kIfNoneMatch] = if_none_match;
    Response response;
    handler_->handle(request, *state_, response);
    Answer answer{response.status, response.fields, response.lead};
    for (const ByteView slice : response.slices()) answer.body.append(slice.begin(), slice.end());
    return answer;
  }
  nlohmann::json layer(const std::string& name) { return nlohmann::json::parse(get("/" + name + "/layer.json").body); }
  std::string path(const std::string& file) const { return directory_.path + "/" + file; }

  test::TemporaryDirectory directory_;
  std::unique_ptr<Catalog> catalog_;
  std::unique_ptr<WorkerState> state_;
  std::unique_ptr<Handler> handler_;
};

TEST_F(BaseTest, EachTileComesWholeFromOneOfTheTwo) {
  open(BaseMode::kMerge);
  const struct {
    const char* tile;
    const char* owner;
  } cases[] = {
      {"0/0/0", "base"},   {"0/1/0", "base"},   {"1/0/0", "base"},   {"1/2/0", "base"},
      {"1/2/1", "region"}, {"2/4/2", "region"}, {"2/5/3", "region"},  // real
      {"2/4/0", "region"}, {"2/5/1", "region"},                       // partly inside, and the base has none
      {"2/0/0", ""},       {"2/7/3", ""},                             // no data: the base is what there is
  };
  for (const auto& c : cases) {
    SCOPED_TRACE(c.tile);
    for (const char* format : {".terrain", ".vn", ".parts"}) {
      const Answer merged = get(std::string("/region/") + c.tile + format);
      if (c.owner[0] == '\0') {
        EXPECT_EQ(merged.status, 404);
        continue;
      }
      const bool from_base = std::string(c.owner) == "base";
      const Answer own = get(std::string(from_base ? "/base/" : "/alone/") + c.tile + format);
      EXPECT_EQ(merged.status, 200);
      EXPECT_TRUE(merged.body == own.body);
      EXPECT_EQ(merged.field("ETag"), own.field("ETag"));
      EXPECT_EQ(merged.field("Tind-Dataset"), from_base ? "base" : "");
      EXPECT_EQ(own.field("Tind-Dataset"), "");
      const Answer again = get(std::string("/region/") + c.tile + format, merged.field("ETag"));
      EXPECT_EQ(again.status, 304);
      EXPECT_EQ(again.field("Tind-Dataset"), from_base ? "base" : "");
    }
  }
  EXPECT_EQ(get("/region/codes/1/0/0").body, get("/base/codes/1/0/0").body);
  EXPECT_EQ(get("/region/body/1/0/0").body, get("/alone/body/1/0/0").body) << "pieces are its own";
}

TEST_F(BaseTest, TheMergedLayerListsBothAndItsVersionIsThatOfBoth) {
  open(BaseMode::kMerge);
  const auto merged = layer("region");
  EXPECT_FALSE(merged.contains("parentUrl"));
  // Each tile that is listed is there, and no other.
  ASSERT_EQ(merged["available"].size(), 3u);
  for (std::uint32_t level = 0; level < 3; ++level) {
    for (std::uint32_t y = 0; y < TileKey::count_y(static_cast<std::uint8_t>(level)); ++y) {
      for (std::uint32_t x = 0; x < TileKey::count_x(static_cast<std::uint8_t>(level)); ++x) {
        bool listed = false;
        for (const auto& r : merged["available"][level]) {
          listed = listed || (r["startX"] <= x && x <= r["endX"] && r["startY"] <= y && y <= r["endY"]);
        }
        const std::string tile = std::to_string(level) + "/" + std::to_string(x) + "/" + std::to_string(y);
        EXPECT_EQ(get("/region/" + tile + ".terrain").status == 200, listed) << tile;
      }
    }
  }
  const std::string address = merged["tiles"][0];
  const std::string version = address.substr(address.find("v=") + 2);
  EXPECT_THAT(get("/region/1/0/0.terrain?v=" + version).field("Cache-Control"), HasSubstr("immutable"));
  EXPECT_THAT(get("/region/1/2/1.terrain?v=" + version).field("Cache-Control"), HasSubstr("immutable"));
  const std::string base_address = layer("base")["tiles"][0];
  EXPECT_NE(address, base_address);
  const std::string base_version = base_address.substr(base_address.find("v=") + 2);
  EXPECT_THAT(get("/region/1/0/0.terrain?v=" + base_version).field("Cache-Control"), HasSubstr("max-age=60"));
}

TEST_F(BaseTest, ThroughParentUrlTheClientAsksBoth) {
  open(BaseMode::kParentUrl);
  const auto own = layer("region");
  EXPECT_EQ(own["parentUrl"], "../base/");
  EXPECT_EQ(own["available"][0], nlohmann::json::array()) << "the base has better ones";
  EXPECT_EQ(own["available"][1], nlohmann::json::parse(R"([{"startX":2,"startY":1,"endX":2,"endY":1}])"));
  EXPECT_EQ(own["available"][2], nlohmann::json::parse(R"([{"startX":4,"startY":0,"endX":5,"endY":3}])"));
  const Answer tile = get("/region/1/0/0.terrain");
  EXPECT_EQ(tile.field("Tind-Dataset"), "");
  EXPECT_EQ(tile.body, get("/alone/1/0/0.terrain").body);
}

}  // namespace
}  // namespace tind
