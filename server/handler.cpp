// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/handler.hpp"

#include <fmt/format.h>

#include <array>
#include <cstdio>
#include <cstring>
#include <iterator>
#include <nlohmann/json.hpp>

#include "core/format/quantized_mesh.hpp"
#include "core/format/vn.hpp"
#include "core/tessellation.hpp"
#include "server/negotiation.hpp"
#include "server/route.hpp"
#include "server/static_files.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

constexpr int kOk = 200, kNoContent = 204, kMovedPermanently = 308, kNotModified = 304, kNotFound = 404,
              kMethodNotAllowed = 405, kInternalError = 500, kUnavailable = 503;
constexpr const char* kAllow = "GET, HEAD, OPTIONS";
// An address that carries the dataset's version never changes its bytes; all others are asked again after a minute.
constexpr const char* kForever = "public, max-age=31536000, immutable";
constexpr const char* kShortly = "public, max-age=60";

template <class... Visitors>
struct Overloaded : Visitors... {
  using Visitors::operator()...;
};
template <class... Visitors>
Overloaded(Visitors...) -> Overloaded<Visitors...>;

std::shared_ptr<const Coded> share(Coded coded) { return std::make_shared<const Coded>(std::move(coded)); }

Bytes to_bytes(std::string_view text) { return Bytes(text.begin(), text.end()); }

}  // namespace

const char* reason_phrase(int status) {
  switch (status) {
    case 200:
      return "OK";
    case 204:
      return "No Content";
    case 304:
      return "Not Modified";
    case 308:
      return "Permanent Redirect";
    case 400:
      return "Bad Request";
    case 404:
      return "Not Found";
    case 405:
      return "Method Not Allowed";
    case 408:
      return "Request Timeout";
    case 414:
      return "URI Too Long";
    case 431:
      return "Request Header Fields Too Large";
    case 500:
      return "Internal Server Error";
    case 501:
      return "Not Implemented";
    case 503:
      return "Service Unavailable";
    case 505:
      return "HTTP Version Not Supported";
    default:
      return "";
  }
}

Response text_response(int status, const std::string& text, const std::string& more_fields) {
  auto body = std::make_shared<const Bytes>(to_bytes(text + "\n"));
  Response response;
  response.status = status;
  response.fields = "Content-Type: text/plain; charset=utf-8\r\nAccess-Control-Allow-Origin: *\r\n" + more_fields;
  response.content_length = body->size();
  response.body.push_back({*body, body});
  return response;
}

// What the answers to one request share.
struct Handler::Context {
  const Request& request;
  Target target;
  Coding wanted = Coding::kIdentity;

  /// One representation: type, entity tag, caching. `etag_base` is unique for the resource's bytes, before coding.
  const char* content_type = "";
  std::string etag_base = {};
  const char* cache_control = kShortly;
  const char* vary = "Accept-Encoding";

  std::string etag() const {
    const char* suffix = vary[0] == '\0' || wanted == Coding::kIdentity ? "" : wanted == Coding::kZstd ? "-z" : "-g";
    return '"' + etag_base + suffix + '"';
  }
  std::string fields() const {
    std::string out = fmt::format(
        "ETag: {}\r\nCache-Control: {}\r\nAccess-Control-Allow-Origin: *\r\n"
        "Access-Control-Expose-Headers: ETag\r\n",
        etag(), cache_control);
    if (vary[0] != '\0') out += fmt::format("Vary: {}\r\n", vary);
    return out;
  }
  std::optional<Response> not_modified() const {
    if (!request.if_none_match || !etag_matches(*request.if_none_match, etag())) return std::nullopt;
    Response response;
    response.status = kNotModified;
    response.fields = fields();
    return response;
  }
  Response ok(Coding coding) const {
    Response response;
    response.fields = fmt::format("Content-Type: {}\r\nX-Content-Type-Options: nosniff\r\n{}", content_type, fields());
    if (coding != Coding::kIdentity) response.fields += fmt::format("Content-Encoding: {}\r\n", coding_name(coding));
    return response;
  }
  Response whole(const std::shared_ptr<const Coded>& body) const {
    Response response = ok(body->coding);
    response.content_length = body->bytes.size();
    response.body.push_back({body->bytes, body});
    return response;
  }
  void set_version(const Dataset& dataset) {
    if (query_value(target.query, "v") == dataset.version) cache_control = kForever;
  }
};

namespace {

Response not_found(const char* what) {
  return text_response(kNotFound, what, fmt::format("Cache-Control: {}\r\n", kShortly));
}

Response internal_error(const Error& error) {
  std::fprintf(stderr, "tind: %s\n", error.message.c_str());
  return text_response(kInternalError, "this part of the dataset cannot be read");
}

}  // namespace

// The cached representation, or the one that `make` (-> Result<Bytes>) gives.
template <class Make>
Response Handler::coded(Context& context, const std::string& cache_key, Make&& make) {
  if (auto response = context.not_modified()) return std::move(*response);
  const std::string key = cache_key + "|" + coding_name(context.wanted);
  std::shared_ptr<const Coded> body = cache_.find(key);
  if (!body) {
    Result<Bytes> bytes = make();
    if (!bytes) return internal_error(bytes.error());
    body = share(apply_coding(std::move(*bytes), context.wanted));
    cache_.put(key, body);
  }
  return context.whole(body);
}

Response Handler::document(Context& context, const Document& document) {
  context.content_type = document.content_type;
  context.etag_base = document.etag_base;
  return coded(context, "document|" + document.etag_base, [&]() -> Result<Bytes> { return to_bytes(document.text); });
}

Response Handler::cesium(Context& context, const std::string& path) {
  if (site_.cesium_root.empty()) return not_found("CesiumJS is not installed; start tind with --cesium DIR");
  const auto file = find_static_file(site_.cesium_root, path);
  if (!file) return not_found("no such file in CesiumJS");
  context.content_type = file->content_type;
  context.etag_base = file->stamp;
  if (!file->compressible) {
    context.wanted = Coding::kIdentity;
    context.vary = "";
  }
  return coded(context, "file|" + file->path + "|" + file->stamp, [&] { return read_static_file(*file); });
}

// .terrain and .vn: assembled, then coded.
Response Handler::tile(Context& context, const Dataset& dataset, const TileKey& key, bool terrain) {
  auto snapshot = dataset.store.snapshot();
  if (!snapshot) return internal_error(snapshot.error());
  if (!snapshot->find(PieceKey{PieceKind::kBody, key.level, key.x, key.y})) return not_found("no such tile");
  bool normals = false;
  if (terrain) {
    const auto extensions = query_value(context.target.query, "extensions");
    normals =
        wants_normals(context.request.accept, extensions ? std::optional<std::string_view>(*extensions) : std::nullopt);
    context.vary = "Accept, Accept-Encoding";
  }
  context.content_type = terrain ? "application/vnd.quantized-mesh" : "application/vnd.tind.vn";
  context.etag_base = dataset.version + (terrain ? normals ? "-qn" : "-q" : "-vn");
  context.set_version(dataset);
  const std::string cache_key =
      fmt::format("{}|{}/{}/{}|{}", dataset.name, key.level, key.x, key.y, terrain ? normals ? "qn" : "q" : "vn");
  return coded(context, cache_key, [&]() -> Result<Bytes> {
    auto node = load_tile(dataset, *snapshot, key);
    if (!node) return tl::unexpected(node.error());
    if (!*node || key.level >= dataset.manifest.levels.size()) {
      return fail(ErrorKind::kCorrupt, dataset.name + ": a tile that the manifest does not know");
    }
    const LevelInfo& level = dataset.manifest.levels[key.level];
    const Lattice& lattice = dataset.manifest.lattice;
    if (!terrain) return encode_vn(lattice, **node, level.tolerance_m);
    std::vector<VirtualNode> neighbours;
    if (normals) {
      auto loaded = load_neighbours(dataset, *snapshot, key);
      if (!loaded) return tl::unexpected(loaded.error());
      neighbours = std::move(*loaded);
    }
    return encode_quantized_mesh(lattice, **node, {level.height_step_m, normals, neighbours});
  });
}

Response Handler::parts(Context& context, const Dataset& dataset, const TileKey& key) {
  constexpr std::size_t kPieces = 9;
  auto snapshot = dataset.store.snapshot();
  if (!snapshot) return internal_error(snapshot.error());
  const auto keys = pieces_of(key);
  if (!snapshot->find(keys[kPieces - 1])) return not_found("no such tile");
  context.content_type = "application/vnd.tind.parts";
  context.etag_base = dataset.version + "-parts";
  context.vary = "";  // the pieces are packed already
  context.set_version(dataset);
  if (auto response = context.not_modified()) return std::move(*response);

  ByteWriter head;
  head.raw(to_bytes("TVP1"));
  head.fixed(key.level);
  head.fixed(static_cast<std::uint8_t>(kPieces));
  head.fixed(std::uint16_t{0});
  head.fixed(key.x);
  head.fixed(key.y);
  Response response = context.ok(Coding::kIdentity);
  std::uint64_t length = 0;
  response.body.resize(1);
  for (const PieceKey& piece : keys) {
    const auto value = snapshot->find(piece);
    if (!value) return internal_error({ErrorKind::kCorrupt, dataset.name + ": a piece is missing"});
    head.fixed(static_cast<std::uint32_t>(value->size()));
    response.body.push_back({*value, nullptr});
    length += value->size();
  }
  const auto owned = std::make_shared<const Bytes>(head.take());
  response.body[0] = {*owned, owned};
  response.content_length = length + owned->size();
  response.pin = std::move(*snapshot);
  return response;
}

// One stored value: a zstd frame goes out as it is to whoever takes zstd.
Response Handler::piece(Context& context, const Dataset& dataset, const PieceKey& key) {
  auto snapshot = dataset.store.snapshot();
  if (!snapshot) return internal_error(snapshot.error());
  const auto value = snapshot->find(key);
  if (!value) return not_found("no such piece");
  context.content_type = "application/vnd.tind.piece";
  context.etag_base = dataset.version + "-piece";
  context.set_version(dataset);
  if (auto response = context.not_modified()) return std::move(*response);
  const bool packed = is_zstd_frame(*value);
  if (packed && context.wanted != Coding::kZstd) {
    auto record = unpack_value(*value);
    if (!record) return internal_error(record.error());
    return context.whole(share(apply_coding(std::move(*record), context.wanted)));
  }
  Response response = context.ok(packed ? Coding::kZstd : Coding::kIdentity);
  response.content_length = value->size();
  response.body.push_back({*value, nullptr});
  response.pin = std::move(*snapshot);
  return response;
}

Response Handler::codes(Context& context, const Dataset& dataset, const TileKey& key) {
  auto snapshot = dataset.store.snapshot();
  if (!snapshot) return internal_error(snapshot.error());
  if (!snapshot->find(PieceKey{PieceKind::kBody, key.level, key.x, key.y})) return not_found("no such tile");
  context.content_type = "application/json";
  context.etag_base = dataset.version + "-codes";
  context.set_version(dataset);
  const std::string cache_key = fmt::format("{}|{}/{}/{}|codes", dataset.name, key.level, key.x, key.y);
  return coded(context, cache_key, [&]() -> Result<Bytes> {
    using nlohmann::ordered_json;
    const auto node = load_tile(dataset, *snapshot, key);
    if (!node) return tl::unexpected(node.error());
    ordered_json gaps = ordered_json::array();
    for (int gap = 1; gap <= key.level; ++gap) {
      ordered_json borders = ordered_json::array();
      for (const auto& entries : (*node)->side_entries) {
        const CoarseRuns runs = coarse_runs(entries, key.level - gap);
        borders.push_back(
            {{"runs", runs.runs}, {"starts_inside", runs.starts_inside}, {"ends_inside", runs.ends_inside}});
      }
      gaps.push_back({{"gap", gap}, {"level", key.level - gap}, {"borders", std::move(borders)}});
    }
    const ordered_json all = {{"level", key.level}, {"x", key.x}, {"y", key.y}, {"gaps", std::move(gaps)}};
    return to_bytes(all.dump());
  });
}

Response Handler::answer(Context& context) {
  const auto with_dataset = [&](const std::string& name, auto&& use) {
    const Dataset* dataset = site_.find(name);
    return dataset ? use(*dataset) : not_found("no such dataset");
  };
  // Copied: the context is written to while it is visited.
  const Route route = context.target.route;
  return std::visit(
      Overloaded{[&](const IndexRoute&) { return document(context, site_.index); },
                 [&](const DatasetsRoute&) { return document(context, site_.list); },
                 [&](const ScriptRoute&) { return document(context, site_.script); },
                 [&](const StyleRoute&) { return document(context, site_.style); },
                 [&](const HealthRoute&) { return text_response(kOk, "ok", "Cache-Control: no-store\r\n"); },
                 [&](const ReadyRoute&) {
                   return draining_ ? text_response(kUnavailable, "stopping", "Cache-Control: no-store\r\n")
                                    : text_response(kOk, "ready", "Cache-Control: no-store\r\n");
                 },
                 [&](const CesiumRoute& r) { return cesium(context, r.path); },
                 [&](const DirectoryRoute& r) {
                   return with_dataset(r.name, [&](const Dataset&) {
                     // Relative, for the sake of proxies that serve us below another path.
                     return text_response(kMovedPermanently, "moved",
                                          fmt::format("Location: {}/\r\n", percent_encode(r.name)));
                   });
                 },
                 [&](const DocumentRoute& r) {
                   return with_dataset(r.name, [&](const Dataset& dataset) {
                     const auto index = static_cast<std::size_t>(&dataset - site_.datasets.data());
                     return document(context, r.document == DatasetDocument::kGlobe  ? site_.globe
                                              : r.document == DatasetDocument::kMeta ? site_.meta[index]
                                                                                     : site_.layer[index]);
                   });
                 },
                 [&](const TileRoute& r) {
                   return with_dataset(r.name, [&](const Dataset& dataset) {
                     return r.format == TileFormat::kParts
                                ? parts(context, dataset, r.key)
                                : tile(context, dataset, r.key, r.format == TileFormat::kTerrain);
                   });
                 },
                 [&](const PieceRoute& r) {
                   return with_dataset(r.name, [&](const Dataset& dataset) { return piece(context, dataset, r.key); });
                 },
                 [&](const CodesRoute& r) {
                   return with_dataset(r.name, [&](const Dataset& dataset) { return codes(context, dataset, r.key); });
                 }},
      route);
}

Response Handler::handle(const Request& request) {
  const bool is_head = request.method == "HEAD";
  if (request.method == "OPTIONS") {
    Response response;
    response.status = kNoContent;
    response.fields = fmt::format(
        "Allow: {0}\r\nAccess-Control-Allow-Origin: *\r\nAccess-Control-Allow-Methods: {0}\r\n"
        "Access-Control-Allow-Headers: *\r\nAccess-Control-Max-Age: 86400\r\n",
        kAllow);
    return response;
  }
  if (request.method != "GET" && !is_head) {
    return text_response(kMethodNotAllowed, "only GET, HEAD and OPTIONS", fmt::format("Allow: {}\r\n", kAllow));
  }
  Response response;
  auto parsed = parse_target(request.target);
  if (const int* status = std::get_if<int>(&parsed)) {
    response = *status == kNotFound ? not_found("no such address") : text_response(*status, "malformed address");
  } else {
    Context context{request, std::move(std::get<Target>(parsed)), choose_coding(request.accept_encoding)};
    response = answer(context);
  }
  if (is_head) {
    response.body.clear();
    response.pin.reset();
  }
  return response;
}

}  // namespace tind
