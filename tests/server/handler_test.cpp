// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/handler.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include <filesystem>
#include <nlohmann/json.hpp>

#include "server/catalog.hpp"
#include "storage/piece_blob.hpp"
#include "storage/zstd_codec.hpp"
#include "test_site.hpp"

namespace tind {
namespace {

using testing::HasSubstr;
using testing::Not;

Bytes body_of(const Response& response) {
  Bytes out(response.lead.begin(), response.lead.end());
  for (const ByteView slice : response.slices()) out.insert(out.end(), slice.begin(), slice.end());
  return out;
}
std::string text_of(const Response& response) {
  const Bytes bytes = body_of(response);
  return {bytes.begin(), bytes.end()};
}
std::string field(const Response& response, const std::string& name) {
  const std::string all = "\r\n" + response.fields;
  const auto at = all.find("\r\n" + name + ": ");
  if (at == all.npos) return "";
  const auto begin = at + name.size() + 4;
  return all.substr(begin, all.find("\r\n", begin) - begin);
}
Bytes gunzip(const Bytes& bytes) {
  Bytes out(std::size_t{1} << 22);
  z_stream stream{};
  EXPECT_EQ(inflateInit2(&stream, 15 + 16), Z_OK);
  stream.next_in = const_cast<Bytef*>(bytes.data());
  stream.avail_in = static_cast<uInt>(bytes.size());
  stream.next_out = out.data();
  stream.avail_out = static_cast<uInt>(out.size());
  EXPECT_EQ(inflate(&stream, Z_FINISH), Z_STREAM_END);
  EXPECT_EQ(stream.avail_in, 0u);  // one member
  out.resize(stream.total_out);
  inflateEnd(&stream);
  return out;
}

class HandlerTest : public testing::Test {
 protected:
  void SetUp() override {
    test::write_pyramid(directory_.path + "/world.tind");
    Settings settings;
    settings.datasets = {directory_.path + "/world.tind"};
    settings.cesium = test::write_cesium(directory_.path);
    auto catalog = Catalog::open(settings);
    ASSERT_TRUE(catalog.has_value()) << catalog.error().message;
    catalog_ = std::move(*catalog);
    state_ = std::make_unique<WorkerState>(catalog_->holder());
  }
  const Dataset& dataset() const { return *state_->site().slots.front()->if_open()->dataset; }
  Response get(const std::string& target, std::optional<std::string> encoding = std::nullopt,
               std::optional<std::string> if_none_match = std::nullopt,
               std::optional<std::string> accept = std::nullopt, const std::string& method = "GET") {
    const auto view = [](const std::optional<std::string>& text) {
      return text ? std::optional<std::string_view>(*text) : std::nullopt;
    };
    Request request{method, target, {}};
    request[RequestField::kAccept] = view(accept);
    request[RequestField::kAcceptEncoding] = view(encoding);
    request[RequestField::kIfNoneMatch] = view(if_none_match);
    return ask(request);
  }
  Response ask(const Request& request) {
    Response response;
    handler_.handle(request, *state_, response);
    return response;
  }
  test::TemporaryDirectory directory_;
  std::unique_ptr<Catalog> catalog_;
  std::unique_ptr<WorkerState> state_;
  Handler handler_{Settings{}};
};

const char* const kAllRoutes[] = {"/",
                                  "/world/",
                                  "/datasets",
                                  "/world/meta.json",
                                  "/world/layer.json",
                                  "/world/1/2/1.terrain",
                                  "/world/1/2/1.vn",
                                  "/world/1/2/1.parts",
                                  "/world/corner/1/4/1",
                                  "/world/edge/1/h/3/2",
                                  "/world/edge/1/v/4/1",
                                  "/world/body/1/3/1",
                                  "/world/codes/1/3/1",
                                  "/health",
                                  "/ready",
                                  "/tind/globe.js",
                                  "/tind/style.css",
                                  "/cesium/Cesium.js",
                                  "/cesium/Widgets/a.png"};

TEST_F(HandlerTest, EveryRouteAnswersWithExactLengthTypeAndCors) {
  for (const char* target : kAllRoutes) {
    SCOPED_TRACE(target);
    for (const char* encoding : {"", "gzip", "zstd"}) {
      const Response response = get(target, encoding);
      EXPECT_EQ(response.status, 200);
      EXPECT_EQ(response.content_length, body_of(response).size());
      EXPECT_NE(field(response, "Content-Type"), "");
      EXPECT_EQ(field(response, "Access-Control-Allow-Origin"), "*");
      EXPECT_NE(field(response, "Cache-Control"), "");
    }
  }
}

TEST_F(HandlerTest, CodedBodiesDecodeToTheIdentityBody) {
  for (const char* target : kAllRoutes) {
    SCOPED_TRACE(target);
    const Bytes plain = body_of(get(target));
    const Response zstd = get(target, "zstd"), gzip = get(target, "gzip");
    EXPECT_EQ(field(get(target), "Content-Encoding"), "");
    if (field(zstd, "Content-Encoding") == "zstd") {
      EXPECT_EQ(unpack_value(body_of(zstd)), plain);
      EXPECT_LT(body_of(zstd).size(), plain.size());
    } else {
      EXPECT_EQ(body_of(zstd), plain);
    }
    if (field(gzip, "Content-Encoding") == "gzip") {
      EXPECT_EQ(gunzip(body_of(gzip)), plain);
      EXPECT_LT(body_of(gzip).size(), plain.size());
    } else {
      EXPECT_EQ(body_of(gzip), plain);
    }
  }
  EXPECT_EQ(field(get("/world/1/2/1.terrain", "zstd"), "Content-Encoding"), "zstd");
  EXPECT_EQ(field(get("/world/1/2/1.terrain", "gzip"), "Content-Encoding"), "gzip");
  EXPECT_EQ(field(get("/world/1/2/1.parts", "gzip"), "Content-Encoding"), "");
  EXPECT_EQ(field(get("/cesium/Widgets/a.png", "gzip"), "Content-Encoding"), "");
}

TEST_F(HandlerTest, StoredFramesGoOutUntouched) {
  const auto snapshot = dataset().store.snapshot();
  ASSERT_TRUE(snapshot.has_value());
  const auto value = snapshot->find({PieceKind::kBody, 1, 3, 1});
  ASSERT_TRUE(value && is_zstd_frame(*value));
  const Response response = get("/world/body/1/3/1", "zstd");
  EXPECT_EQ(field(response, "Content-Encoding"), "zstd");
  ASSERT_EQ(response.slices().size(), 1u);
  EXPECT_EQ(response.slices()[0].data(), value->data()) << "from the memory map, not copied";
  EXPECT_TRUE(decode_body(body_of(get("/world/body/1/3/1"))).has_value());
}

TEST_F(HandlerTest, EntityTagsDifferByCodingAndVariantAndGive304) {
  const std::string accept = "application/vnd.quantized-mesh;extensions=octvertexnormals-watermask-metadata,*/*;q=0.01";
  std::vector<std::string> tags;
  for (const char* encoding : {"", "gzip", "zstd"}) {
    for (const bool normals : {false, true}) {
      const auto wish = normals ? std::optional(accept) : std::nullopt;
      const Response full = get("/world/1/2/1.terrain", encoding, std::nullopt, wish);
      const std::string tag = field(full, "ETag");
      EXPECT_THAT(tags, Not(testing::Contains(tag)));
      tags.push_back(tag);
      EXPECT_EQ(tag.front(), '"') << "strong";
      for (const std::string& condition : {tag, "W/" + tag, "\"x\", " + tag, std::string("*")}) {
        const Response same = get("/world/1/2/1.terrain", encoding, condition, wish);
        EXPECT_EQ(same.status, 304);
        EXPECT_TRUE(body_of(same).empty());
        EXPECT_FALSE(same.content_length.has_value());
        EXPECT_EQ(field(same, "ETag"), tag);
        EXPECT_EQ(field(same, "Vary"), field(full, "Vary"));
        EXPECT_EQ(field(same, "Cache-Control"), field(full, "Cache-Control"));
      }
      EXPECT_EQ(get("/world/1/2/1.terrain", encoding, "\"other\"", wish).status, 200);
    }
  }
  for (const char* target : kAllRoutes) {
    const std::string tag = field(get(target), "ETag");
    if (tag.empty()) continue;  // health, ready
    EXPECT_EQ(get(target, std::nullopt, tag).status, 304) << target;
  }
}

TEST_F(HandlerTest, VaryNamesWhatTheAnswerDependsOn) {
  EXPECT_EQ(field(get("/world/1/2/1.terrain"), "Vary"), "Accept, Accept-Encoding");
  EXPECT_EQ(field(get("/world/1/2/1.vn"), "Vary"), "Accept-Encoding");
  EXPECT_EQ(field(get("/world/layer.json"), "Vary"), "Accept-Encoding");
  EXPECT_EQ(field(get("/world/1/2/1.parts"), "Vary"), "");
}

TEST_F(HandlerTest, VersionedAddressesAreImmutable) {
  const auto layer = nlohmann::json::parse(text_of(get("/world/layer.json")));
  std::string tile = layer.at("tiles")[0];
  for (const auto& [from, to] : {std::pair{"{z}", "1"}, {"{x}", "2"}, {"{y}", "1"}}) {
    tile.replace(tile.find(from), 3, to);
  }
  EXPECT_THAT(field(get("/world/" + tile), "Cache-Control"), HasSubstr("immutable"));
  EXPECT_THAT(field(get("/world/1/2/1.terrain"), "Cache-Control"), Not(HasSubstr("immutable")));
  EXPECT_THAT(field(get("/world/1/2/1.terrain?v=old"), "Cache-Control"), Not(HasSubstr("immutable")));
}

TEST_F(HandlerTest, NormalsByAcceptOrQuery) {
  const std::string accept = "application/vnd.quantized-mesh;extensions=octvertexnormals-watermask-metadata";
  const Bytes plain = body_of(get("/world/1/2/1.terrain"));
  const Bytes by_accept = body_of(get("/world/1/2/1.terrain", std::nullopt, std::nullopt, accept));
  const Bytes by_query = body_of(get("/world/1/2/1.terrain?extensions=octvertexnormals-metadata"));
  EXPECT_EQ(by_accept, by_query);
  const std::size_t n_vertices = 4 + 4 * 60 + 1;
  EXPECT_EQ(by_accept.size(), plain.size() + 1 + 4 + 2 * n_vertices);
  EXPECT_TRUE(std::equal(plain.begin(), plain.end(), by_accept.begin()));
}

TEST_F(HandlerTest, HeadIsGetWithoutBody) {
  for (const char* target : kAllRoutes) {
    for (const char* encoding : {"", "gzip", "zstd"}) {
      const Response full = get(target, encoding);
      const Response head = get(target, encoding, std::nullopt, std::nullopt, "HEAD");
      EXPECT_EQ(head.status, full.status);
      EXPECT_EQ(head.fields, full.fields);
      EXPECT_EQ(head.content_length, full.content_length);
      EXPECT_TRUE(body_of(head).empty());
    }
  }
}

TEST_F(HandlerTest, StatusesOfWhatIsNotThere) {
  for (const char* target : {"/nowhere/", "/nowhere/1/2/1.vn", "/world/2/0/0.terrain", "/world/2/0/0.vn",
                             "/world/2/0/0.parts", "/world/corner/2/0/0", "/world/codes/2/0/0", "/world/x", "/nowhere",
                             "/cesium/none.js", "/cesium/link.txt", "/cesium/Widgets", "/favicon.ico"}) {
    EXPECT_EQ(get(target).status, 404) << target;
    EXPECT_EQ(field(get(target), "Access-Control-Allow-Origin"), "*");
  }
  EXPECT_EQ(get("/%").status, 400);
  for (const char* method : {"POST", "PUT", "DELETE", "PATCH", "TRACE", "CONNECT"}) {
    const Response response = get("/", std::nullopt, std::nullopt, std::nullopt, method);
    EXPECT_EQ(response.status, 405) << method;
    EXPECT_EQ(field(response, "Allow"), "GET, HEAD, OPTIONS");
  }
  for (const char* method : {"get", "FETCH"}) {
    EXPECT_EQ(get("/", std::nullopt, std::nullopt, std::nullopt, method).status, 501) << method;
  }
}

TEST_F(HandlerTest, OptionsAnswersPreflight) {
  for (const char* target : {"/world/1/2/1.vn", "*"}) {
    const Response response = get(target, std::nullopt, std::nullopt, std::nullopt, "OPTIONS");
    EXPECT_EQ(response.status, 204);
    EXPECT_FALSE(response.content_length.has_value());
    EXPECT_TRUE(body_of(response).empty());
    EXPECT_EQ(field(response, "Access-Control-Allow-Methods"), "GET, HEAD, OPTIONS");
    EXPECT_EQ(field(response, "Access-Control-Allow-Headers"), "*");
  }
}

TEST_F(HandlerTest, FolderWithoutSlashIsRedirected) {
  const Response response = get("/world");
  EXPECT_EQ(response.status, 308);
  EXPECT_EQ(field(response, "Location"), "world/");
}

TEST_F(HandlerTest, PartsAreTheNineValuesOfTheStore) {
  const Bytes bundle = body_of(get("/world/1/2/1.parts"));
  ByteReader in(bundle);
  const ByteView magic = in.raw(4);
  EXPECT_EQ(std::string(magic.begin(), magic.end()), "TVP1");
  EXPECT_EQ(in.fixed<std::uint8_t>(), 1);
  EXPECT_EQ(in.fixed<std::uint8_t>(), 9);
  EXPECT_EQ(in.fixed<std::uint16_t>(), 0);
  EXPECT_EQ(in.fixed<std::uint32_t>(), 2u);
  EXPECT_EQ(in.fixed<std::uint32_t>(), 1u);
  std::array<std::uint32_t, 9> lengths;
  for (auto& length : lengths) length = in.fixed<std::uint32_t>();
  const auto snapshot = dataset().store.snapshot();
  const auto keys = pieces_of({1, 2, 1});
  for (std::size_t k = 0; k < 9; ++k) {
    const ByteView value = in.raw(lengths[k]);
    const auto stored = snapshot->find(keys[k]);
    ASSERT_TRUE(stored.has_value());
    EXPECT_EQ(Bytes(value.begin(), value.end()), Bytes(stored->begin(), stored->end()));
  }
  EXPECT_TRUE(in.finished());
}

// Who takes no zstd gets what a stored frame holds: unpacked and coded the first time only, pieces and codings apart.
TEST_F(HandlerTest, PiecesAreUnpackedAndCodedOnce) {
  const std::vector<std::string> targets = {"/world/edge/1/h/2/1", "/world/edge/1/v/2/1", "/world/body/1/2/1",
                                            "/world/body/1/2/0"};
  std::vector<Bytes> first;
  for (const std::string& target : targets) {
    for (const char* coding : {"identity", "gzip"}) first.push_back(body_of(get(target, coding)));
  }
  const std::uint64_t n_made = handler_.cache().counts().n_puts;
  EXPECT_GE(n_made, 4u) << "bodies are stored as frames";
  const auto snapshot = dataset().store.snapshot();
  for (std::size_t k = 0; k < first.size(); ++k) {
    const Response again = get(targets[k / 2], k % 2 == 0 ? "identity" : "gzip");
    EXPECT_EQ(body_of(again), first[k]) << targets[k / 2];
    for (std::size_t other = 0; other < k; ++other) EXPECT_NE(first[other], first[k]) << targets[k / 2];
  }
  const auto record = unpack_value(*snapshot->find({PieceKind::kBody, 1, 2, 0}));
  EXPECT_EQ(first[6], *record);
  EXPECT_EQ(handler_.cache().counts().n_puts, n_made);
}

TEST_F(HandlerTest, CodesCutBordersAtCoarserVertices) {
  const auto codes = nlohmann::json::parse(text_of(get("/world/codes/1/3/1")));
  EXPECT_EQ(codes.at("level"), 1);
  ASSERT_EQ(codes.at("gaps").size(), 1u);
  const auto& borders = codes.at("gaps")[0].at("borders");
  ASSERT_EQ(borders.size(), 4u);
  // Every second inner vertex of a level-1 edge entered at level 1: 30 pieces of one, then one of none.
  EXPECT_EQ(borders[0].at("runs").size(), 31u);
  EXPECT_EQ(borders[0].at("starts_inside"), false);
  EXPECT_EQ(nlohmann::json::parse(text_of(get("/world/codes/0/0/0"))).at("gaps").size(), 0u);
}

TEST_F(HandlerTest, DrainingMakesReadyFail) {
  EXPECT_EQ(get("/ready").status, 200);
  handler_.set_draining();
  EXPECT_EQ(get("/ready").status, 503);
  EXPECT_EQ(get("/health").status, 200);
}

TEST_F(HandlerTest, PagesEscapeAndAskNoOtherHost) {
  EXPECT_THAT(text_of(get("/")), HasSubstr("A &amp; B"));
  for (const char* target : {"/", "/world/", "/tind/globe.js", "/tind/style.css"}) {
    const std::string page = text_of(get(target));
    EXPECT_THAT(page, Not(HasSubstr("http://"))) << target;
    EXPECT_THAT(page, Not(HasSubstr("https://"))) << target;
  }
  EXPECT_THAT(text_of(get("/world/")), HasSubstr("../cesium/Cesium.js"));
}

TEST_F(HandlerTest, WithoutCesiumThePageSaysSo) {
  Settings settings;
  settings.datasets = {directory_.path + "/world.tind"};
  auto catalog = Catalog::open(settings);
  ASSERT_TRUE(catalog.has_value());
  catalog_->holder().replace((*catalog)->holder().current());
  state_->begin_batch();
  EXPECT_THAT(text_of(get("/world/")), HasSubstr("CesiumJS is not installed"));
  EXPECT_THAT(text_of(get("/")), HasSubstr("--cesium"));
  EXPECT_EQ(get("/cesium/Cesium.js").status, 404);
}

TEST_F(HandlerTest, SiteRefusesTwinsReservedNamesAndMissingFiles) {
  namespace fs = std::filesystem;
  fs::create_directory(directory_.path + "/other");
  fs::copy_file(directory_.path + "/world.tind", directory_.path + "/other/world.tind");
  fs::copy_file(directory_.path + "/world.tind", directory_.path + "/health.tind");
  Settings settings;
  settings.datasets = {directory_.path + "/world.tind", directory_.path + "/other/world.tind"};
  EXPECT_THAT(Catalog::open(settings).error().message, HasSubstr("twice"));
  settings.datasets = {directory_.path + "/health.tind"};
  EXPECT_EQ(Catalog::open(settings).error().kind, ErrorKind::kInvalidInput);
  settings.datasets = {directory_.path + "/missing.tind"};
  EXPECT_THAT(Catalog::open(settings).error().message, HasSubstr("missing.tind: no such file"));
  settings.datasets = {directory_.path + "/secret.txt"};
  EXPECT_FALSE(Catalog::open(settings).has_value());
  settings.datasets = {directory_.path + "/world.tind"};
  settings.cesium = directory_.path;
  EXPECT_THAT(Catalog::open(settings).error().message, HasSubstr("Cesium.js"));
}

}  // namespace
}  // namespace tind
