// SPDX-License-Identifier: GPL-3.0-or-later
// What is told of a resource besides its bytes: entity tags over updates, dates, ranges, failures, cross-origin fields.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>

#include "server/catalog.hpp"
#include "server/handler.hpp"
#include "server/http_date.hpp"
#include "test_site.hpp"

namespace tind {
namespace {

using testing::HasSubstr;
using testing::Not;
using enum RequestField;

std::string body_of(const Response& response) {
  std::string out = response.lead;
  for (const ByteView slice : response.slices()) out.append(slice.begin(), slice.end());
  return out;
}
std::string field(const Response& response, const std::string& name) {
  std::string all = "\r\n";
  all += response.fields;
  const auto at = all.find("\r\n" + name + ": ");
  if (at == all.npos) return "";
  const auto begin = at + name.size() + 4;
  return all.substr(begin, all.find("\r\n", begin) - begin);
}

class RepresentationTest : public testing::Test {
 protected:
  using Fields = std::vector<std::pair<RequestField, std::string>>;

  void SetUp() override {
    test::write_pyramid(path_);
    Settings settings;
    settings.datasets = {path_};
    auto catalog = Catalog::open(settings);
    ASSERT_TRUE(catalog.has_value()) << catalog.error().message;
    catalog_ = std::move(*catalog);
    state_ = std::make_unique<WorkerState>(catalog_->holder());
  }
  // Puts another file in the place of the one that is served.
  void swap_in(std::optional<TileKey> changed) {
    test::write_pyramid(path_ + ".new", 60, changed);
    std::filesystem::rename(path_ + ".new", path_);
    ASSERT_EQ(catalog_->refresh(true).replaced.size(), 1u);
    state_->begin_batch();
  }
  Response get(const std::string& target, const Fields& fields = {}, const std::string& method = "GET") {
    Request request{method, target, {}};
    for (const auto& [name, value] : fields) request[name] = value;
    Response response;
    handler_->handle(request, *state_, response);
    return response;
  }
  std::string etag(const std::string& target, const Fields& fields = {}) { return field(get(target, fields), "ETag"); }

  test::TemporaryDirectory directory_;
  std::string path_ = directory_.path + "/world.tind";
  std::unique_ptr<Catalog> catalog_;
  std::unique_ptr<WorkerState> state_;
  std::unique_ptr<Handler> handler_ = std::make_unique<Handler>(Settings{}), other_;
};

const char* const kNormals = "?extensions=octvertexnormals";

TEST_F(RepresentationTest, AnUpdateKeepsTheTagsOfWhatItLeavesAlone) {
  // Not neighbours of tile 1/2/1, in which one vertex moves.
  const std::vector<std::string> untouched = {"/world/1/0/0.vn",      "/world/1/0/0.parts",
                                              "/world/1/0/0.terrain", std::string("/world/1/0/0.terrain") + kNormals,
                                              "/world/codes/1/0/0",   "/world/body/1/0/0",
                                              "/world/corner/1/2/1",  "/world/edge/1/v/2/1",
                                              "/world/1/1/1.terrain"};
  const std::vector<std::string> touched = {"/world/1/2/1.vn", "/world/1/2/1.parts", "/world/1/2/1.terrain",
                                            std::string("/world/1/2/1.terrain") + kNormals, "/world/body/1/2/1",
                                            // A neighbour's border normals see the vertex.
                                            std::string("/world/1/1/1.terrain") + kNormals, "/world/meta.json"};
  std::map<std::string, std::pair<std::string, std::string>> before;
  for (const auto& list : {untouched, touched}) {
    for (const std::string& target : list) before[target] = {etag(target), body_of(get(target))};
  }
  swap_in(TileKey{1, 2, 1});
  for (const std::string& target : untouched) {
    EXPECT_EQ(etag(target), before[target].first) << target;
    EXPECT_EQ(body_of(get(target)), before[target].second) << target;
    EXPECT_EQ(get(target, {{kIfNoneMatch, before[target].first}}).status, 304) << target;
  }
  for (const std::string& target : touched) {
    EXPECT_NE(etag(target), before[target].first) << target;
    EXPECT_EQ(get(target, {{kIfNoneMatch, before[target].first}}).status, 200) << target;
  }
  EXPECT_NE(body_of(get("/world/1/2/1.vn")), before["/world/1/2/1.vn"].second);
  swap_in(std::nullopt);
  for (const std::string& target : touched) EXPECT_EQ(etag(target), before[target].first) << "as it was: " << target;
}

TEST_F(RepresentationTest, TagsAreTheSameColdAndWarmAndWithoutACache) {
  Settings settings;
  settings.cache_mb = 0;
  for (const char* target : {"/world/1/2/1.terrain", "/world/1/2/1.vn", "/world/codes/1/2/1", "/world/layer.json"}) {
    for (const char* coding : {"", "gzip", "zstd"}) {
      const Response cold = get(target, {{kAcceptEncoding, coding}}), warm = get(target, {{kAcceptEncoding, coding}});
      other_ = std::make_unique<Handler>(settings);
      handler_.swap(other_);
      const Response uncached = get(target, {{kAcceptEncoding, coding}});
      handler_.swap(other_);
      for (const Response* other : {&warm, &uncached}) {
        EXPECT_EQ(cold.fields, other->fields) << target;
        EXPECT_EQ(body_of(cold), body_of(*other)) << target;
      }
    }
  }
}

TEST_F(RepresentationTest, TilesHaveTheDateOfTheirFile) {
  const std::string date = field(get("/world/1/2/1.parts"), "Last-Modified");
  const auto then = parse_http_date(date, 0);
  ASSERT_TRUE(then.has_value()) << date;
  for (const char* target : {"/world/1/2/1.terrain", "/world/1/2/1.vn", "/world/1/2/1.parts", "/world/body/1/2/1"}) {
    EXPECT_EQ(field(get(target), "Last-Modified"), date);
    const Response same = get(target, {{kIfModifiedSince, date}});
    EXPECT_EQ(same.status, 304) << target;
    EXPECT_EQ(field(same, "Last-Modified"), date);
    EXPECT_EQ(get(target, {{kIfModifiedSince, format_http_date(*then - 1)}}).status, 200);
    EXPECT_EQ(get(target, {{kIfModifiedSince, date}, {kIfNoneMatch, "\"x\""}}).status, 200) << "the tag counts alone";
    EXPECT_EQ(get(target, {{kIfMatch, "\"x\""}}).status, 412);
    EXPECT_EQ(get(target, {{kIfMatch, "*"}}).status, 200);
  }
}

TEST_F(RepresentationTest, RangesOfWhatIsNotCoded) {
  for (const char* target : {"/world/1/2/1.parts", "/world/body/1/3/1", "/world/1/2/1.vn", "/world/layer.json"}) {
    SCOPED_TRACE(target);
    const Response whole = get(target);
    const std::string bytes = body_of(whole);
    EXPECT_EQ(field(whole, "Accept-Ranges"), "bytes");
    for (const auto& [first, last] : {std::pair{0, 9}, {5, 60}, {51, 52}, {70, 300}}) {
      const std::string wanted = std::to_string(first) + "-" + std::to_string(last);
      const Response part = get(target, {{kRange, "bytes=" + wanted}});
      EXPECT_EQ(part.status, 206);
      EXPECT_EQ(field(part, "Content-Range"), "bytes " + wanted + "/" + std::to_string(bytes.size()));
      EXPECT_EQ(body_of(part),
                bytes.substr(static_cast<std::size_t>(first), static_cast<std::size_t>(last - first + 1)));
      EXPECT_EQ(part.content_length, body_of(part).size());
      EXPECT_EQ(field(part, "ETag"), field(whole, "ETag"));
    }
    const Response outside = get(target, {{kRange, "bytes=" + std::to_string(bytes.size()) + "-"}});
    EXPECT_EQ(outside.status, 416);
    EXPECT_EQ(field(outside, "Content-Range"), "bytes */" + std::to_string(bytes.size()));
    EXPECT_EQ(get(target, {{kRange, "bytes=0-1,3-4"}}).status, 200) << "several ranges are not taken";
    EXPECT_EQ(get(target, {{kRange, "bytes=0-1"}}, "HEAD").status, 200) << "ranges are GET's";
    EXPECT_EQ(get(target, {{kRange, "bytes=0-1"}, {kIfRange, "\"x\""}}).status, 200);
    EXPECT_EQ(get(target, {{kRange, "bytes=0-1"}, {kIfRange, field(whole, "ETag")}}).status, 206);
    EXPECT_EQ(get(target, {{kRange, "bytes=0-1"}, {kIfNoneMatch, field(whole, "ETag")}}).status, 304);
  }
  const Response coded = get("/world/1/2/1.vn", {{kRange, "bytes=0-1"}, {kAcceptEncoding, "gzip"}});
  EXPECT_EQ(coded.status, 200);
  EXPECT_EQ(field(coded, "Accept-Ranges"), "");
}

TEST_F(RepresentationTest, FailuresAreProblemDetails) {
  const struct {
    const char* target;
    const char* method;
    int status;
  } cases[] = {{"/world/2/0/0.vn", "GET", 404},
               {"/nowhere", "GET", 404},
               {"/%", "GET", 400},
               {"/world/1/0/0.vn", "PUT", 405},
               {"/world/1/0/0.vn", "BREW", 501}};
  for (const auto& c : cases) {
    const Response response = get(c.target, {}, c.method);
    EXPECT_EQ(response.status, c.status);
    EXPECT_EQ(field(response, "Content-Type"), "application/problem+json");
    const auto problem = nlohmann::json::parse(body_of(response));
    EXPECT_EQ(problem.at("status"), c.status);
    EXPECT_EQ(problem.at("title"), std::string(reason_phrase(c.status)));
    EXPECT_EQ(problem.at("type"), "about:blank");
    EXPECT_EQ(problem.at("instance"), c.target);
    EXPECT_FALSE(problem.at("detail").get<std::string>().empty());
  }
}

TEST_F(RepresentationTest, OneFrameIsWhatAllAnswersAre) {
  const Response one = get("/world/1/2/1.vn?frames=1", {{kAcceptEncoding, "zstd"}});
  EXPECT_EQ(one.status, 200);
  EXPECT_EQ(body_of(one), body_of(get("/world/1/2/1.vn", {{kAcceptEncoding, "zstd"}})));
}

TEST_F(RepresentationTest, LinksAreAbsoluteWhereSomebodySaysWhereWeAre) {
  const auto tile = [&](const Fields& fields) {
    return nlohmann::json::parse(body_of(get("/world/layer.json", fields))).at("tiles")[0].get<std::string>();
  };
  const auto link = [&](const Fields& fields) {
    return nlohmann::json::parse(body_of(get("/datasets", fields)))
        .at("datasets")[0]
        .at("links")
        .at("meta")
        .get<std::string>();
  };
  const Fields forwarded = {
      {kForwardedProto, "https"}, {kForwardedHost, "a.example:8443, inner"}, {kForwardedPrefix, "/geo/"}};
  EXPECT_THAT(tile(forwarded), testing::StartsWith("{z}/")) << "nobody trusts it";
  const std::string relative = etag("/world/layer.json");

  Settings settings;
  settings.trust_proxy = "on";
  handler_ = std::make_unique<Handler>(settings);
  EXPECT_THAT(tile(forwarded), testing::StartsWith("https://a.example:8443/geo/world/{z}/{x}/{y}.terrain?v="));
  EXPECT_EQ(link(forwarded), "https://a.example:8443/geo/world/meta.json");
  EXPECT_NE(etag("/world/layer.json", forwarded), relative);
  EXPECT_THAT(field(get("/world/layer.json"), "Vary"), HasSubstr("X-Forwarded-Host"));
  EXPECT_THAT(tile({{kForwarded, "for=1.2.3.4;Proto=https;host=\"[2001:db8::1]:80\", for=x;host=y"}}),
              testing::StartsWith("https://[2001:db8::1]:80/world/"));
  for (const Fields& nothing : {Fields{}, Fields{{kForwardedProto, "https"}}, Fields{{kForwardedHost, "a\"b"}},
                                Fields{{kForwardedHost, "a"}, {kForwardedProto, "javascript"}},
                                Fields{{kForwardedHost, "a"}, {kForwardedPrefix, "no slash"}},
                                Fields{{kForwardedHost, std::string(300, 'a')}}, Fields{{kForwarded, "host=;proto"}}}) {
    EXPECT_THAT(tile(nothing), testing::StartsWith("{z}/"));
  }
  settings.public_url = "http://b.example/x/";
  handler_ = std::make_unique<Handler>(settings);
  EXPECT_THAT(tile(forwarded), testing::StartsWith("http://b.example/x/world/{z}/"));
  EXPECT_EQ(field(get("/world/layer.json"), "Vary"), "Accept-Encoding");
}

// docs/http.md, "Answers": which fields which status has.
TEST_F(RepresentationTest, FieldsAreThoseOfTheTable) {
  const std::string tile = "/world/1/2/1.terrain", version = catalog_->holder().current()->slots[0]->summary()->version;
  const std::string forever = "public, max-age=31536000, immutable", shortly = "public, max-age=60", never = "no-store";
  const std::string both = "Accept, Accept-Encoding", coding = "Accept-Encoding";
  struct Row {
    std::string target;
    Fields fields;
    int status;
    std::string cache_control, vary, ranges;
    bool has_tag, has_date;
    std::string method = "GET";
  };
  const std::vector<Row> rows = {
      {tile + "?v=" + version, {}, 200, forever, both, "bytes", true, true},
      {tile + "?v=" + version, {}, 200, forever, both, "bytes", true, true, "HEAD"},
      {tile, {{kAcceptEncoding, "gzip"}}, 200, shortly, both, "", true, true},
      {tile + "?v=" + version, {{kRange, "bytes=1-5"}}, 206, forever, both, "bytes", true, true},
      {tile + "?v=" + version, {{kIfNoneMatch, "*"}}, 304, forever, both, "", true, true},
      {tile, {{kIfMatch, "\"x\""}}, 412, "", "", "", false, false},
      {tile, {{kRange, "bytes=99999999-"}}, 416, "", "", "", false, false},
      {"/world/1/2/1.parts", {{kRange, "bytes=1-5"}}, 206, shortly, "", "bytes", true, true},
      {"/world/body/1/2/1?v=" + version, {}, 200, forever, coding, "bytes", true, true},
      {"/world/body/1/2/1", {{kAcceptEncoding, "zstd"}}, 200, shortly, coding, "", true, true},
      {"/world/codes/1/2/1", {}, 200, shortly, coding, "bytes", true, true},
      {"/world/layer.json", {}, 200, shortly, coding, "bytes", true, false},
      {"/health", {}, 200, never, "", "", false, false},
      {"/ready", {}, 200, never, "", "", false, false},
      {"/world", {}, 308, "", "", "", false, false},
      {"/world/9/0/0.vn", {}, 404, shortly, "", "", false, false},
      {"/%", {}, 400, "", "", "", false, false},
      {"/", {}, 405, "", "", "", false, false, "POST"},
      {"/", {}, 501, "", "", "", false, false, "FETCH"},
      {"/", {}, 204, "", "", "", false, false, "OPTIONS"},
  };
  for (const Row& row : rows) {
    SCOPED_TRACE(row.method + " " + row.target + " " + std::to_string(row.status));
    const Response response = get(row.target, row.fields, row.method);
    EXPECT_EQ(response.status, row.status);
    EXPECT_EQ(field(response, "Cache-Control"), row.cache_control);
    EXPECT_EQ(field(response, "Vary"), row.vary);
    EXPECT_EQ(field(response, "Accept-Ranges"), row.ranges);
    EXPECT_EQ(field(response, "ETag") != "", row.has_tag);
    EXPECT_EQ(field(response, "Access-Control-Expose-Headers") != "", row.has_tag);
    EXPECT_EQ(field(response, "Last-Modified") != "", row.has_date);
    EXPECT_EQ(field(response, "X-Content-Type-Options") == "nosniff", row.status != 204 && row.status != 304);
    EXPECT_EQ(field(response, "Access-Control-Allow-Origin"), "*");
    EXPECT_EQ(response.content_length.has_value(), row.status != 204 && row.status != 304);
  }
}

TEST_F(RepresentationTest, OriginsMayBeAFewOrNone) {
  Settings settings;
  settings.cors_origins = "https://a.example, https://b.example:8443";
  handler_ = std::make_unique<Handler>(settings);
  for (const char* target : {"/world/1/2/1.vn", "/world/1/2/1.parts", "/health", "/nowhere"}) {
    EXPECT_EQ(field(get(target, {{kOrigin, "https://b.example:8443"}}), "Access-Control-Allow-Origin"),
              "https://b.example:8443");
    EXPECT_EQ(field(get(target, {{kOrigin, "https://b.example"}}), "Access-Control-Allow-Origin"), "");
    EXPECT_EQ(field(get(target), "Access-Control-Allow-Origin"), "");
    EXPECT_THAT(get(target).fields, HasSubstr("Vary: Origin\r\n"));
  }
  settings.cors_origins = "";
  handler_ = std::make_unique<Handler>(settings);
  EXPECT_THAT(get("/world/1/2/1.vn", {{kOrigin, "https://a.example"}}).fields, Not(HasSubstr("Allow-Origin")));
}

}  // namespace
}  // namespace tind
