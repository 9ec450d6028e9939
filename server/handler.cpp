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

void text_response(Response& out, int status, std::string_view text, std::string_view more_fields) {
  auto body = std::make_shared<Bytes>(to_bytes(text));
  body->push_back('\n');
  out.reset();
  out.status = status;
  out.fields = "Content-Type: text/plain; charset=utf-8\r\nAccess-Control-Allow-Origin: *\r\n";
  out.fields += more_fields;
  out.content_length = body->size();
  out.add(*body);
  out.keep(std::move(body));
}

// What the answers to one request share.
struct Handler::Context {
  const Request& request;
  WorkerState& worker;
  Response& out;
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
    std::string text = fmt::format(
        "ETag: {}\r\nCache-Control: {}\r\nAccess-Control-Allow-Origin: *\r\n"
        "Access-Control-Expose-Headers: ETag\r\n",
        etag(), cache_control);
    if (vary[0] != '\0') text += fmt::format("Vary: {}\r\n", vary);
    return text;
  }
  bool not_modified() const {
    if (!request.if_none_match || !etag_matches(*request.if_none_match, etag())) return false;
    out.reset();
    out.status = kNotModified;
    out.fields = fields();
    return true;
  }
  void ok(Coding coding) const {
    out.reset();
    out.fields = fmt::format("Content-Type: {}\r\nX-Content-Type-Options: nosniff\r\n{}", content_type, fields());
    if (coding != Coding::kIdentity) out.fields += fmt::format("Content-Encoding: {}\r\n", coding_name(coding));
  }
  void whole(const std::shared_ptr<const Coded>& body) const {
    ok(body->coding);
    out.content_length = body->bytes.size();
    out.add(body->bytes);
    out.keep(body);
  }
  void set_version(const Dataset& dataset) {
    if (query_value(target.query, "v") == dataset.version) cache_control = kForever;
  }
};

namespace {

void not_found(Response& out, const char* what) {
  text_response(out, kNotFound, what, fmt::format("Cache-Control: {}\r\n", kShortly));
}

void internal_error(Response& out, const Error& error) {
  std::fprintf(stderr, "tind: %s\n", error.message.c_str());
  text_response(out, kInternalError, "this part of the dataset cannot be read");
}

}  // namespace

// The cached representation, or the one that `make` (-> Result<Bytes>) gives.
template <class Make>
void Handler::coded(Context& context, const std::string& cache_key, Make&& make) {
  if (context.not_modified()) return;
  const std::string key = cache_key + "|" + coding_name(context.wanted);
  std::shared_ptr<const Coded> body = cache_.find(key);
  if (!body) {
    Result<Bytes> bytes = make();
    if (!bytes) return internal_error(context.out, bytes.error());
    body = share(apply_coding(std::move(*bytes), context.wanted));
    cache_.put(key, body);
  }
  return context.whole(body);
}

void Handler::document(Context& context, const Document& document) {
  context.content_type = document.content_type;
  context.etag_base = document.etag_base;
  return coded(context, "document|" + document.etag_base, [&]() -> Result<Bytes> { return to_bytes(document.text); });
}

void Handler::cesium(Context& context, const std::string& path) {
  if (context.worker.site().cesium_root.empty())
    return not_found(context.out, "CesiumJS is not installed; start tind with --cesium DIR");
  const auto file = find_static_file(context.worker.site().cesium_root, path);
  if (!file) return not_found(context.out, "no such file in CesiumJS");
  context.content_type = file->content_type;
  context.etag_base = file->stamp;
  if (!file->compressible) {
    context.wanted = Coding::kIdentity;
    context.vary = "";
  }
  return coded(context, "file|" + file->path + "|" + file->stamp, [&] { return read_static_file(*file); });
}

// .terrain and .vn: assembled, then coded.
void Handler::tile(Context& context, const ServedDataset& served, const TileKey& key, bool terrain) {
  const Dataset& dataset = *served.dataset;
  const auto opened = context.worker.snapshot(served.dataset);
  if (!opened) return internal_error(context.out, opened.error());
  const TileStore::Snapshot& snapshot = **opened;
  if (!snapshot.find(PieceKey{PieceKind::kBody, key.level, key.x, key.y}))
    return not_found(context.out, "no such tile");
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
    auto node = load_tile(dataset, snapshot, key);
    if (!node) return tl::unexpected(node.error());
    if (!*node || key.level >= dataset.manifest.levels.size()) {
      return fail(ErrorKind::kCorrupt, dataset.name + ": a tile that the manifest does not know");
    }
    const LevelInfo& level = dataset.manifest.levels[key.level];
    const Lattice& lattice = dataset.manifest.lattice;
    if (!terrain) return encode_vn(lattice, **node, level.tolerance_m);
    std::vector<VirtualNode> neighbours;
    if (normals) {
      auto loaded = load_neighbours(dataset, snapshot, key);
      if (!loaded) return tl::unexpected(loaded.error());
      neighbours = std::move(*loaded);
    }
    return encode_quantized_mesh(lattice, **node, {level.height_step_m, normals, neighbours});
  });
}

void Handler::parts(Context& context, const ServedDataset& served, const TileKey& key) {
  constexpr std::size_t kPieces = 9;
  const Dataset& dataset = *served.dataset;
  const auto opened = context.worker.snapshot(served.dataset);
  if (!opened) return internal_error(context.out, opened.error());
  const TileStore::Snapshot& snapshot = **opened;
  const auto keys = pieces_of(key);
  if (!snapshot.find(keys[kPieces - 1])) return not_found(context.out, "no such tile");
  context.content_type = "application/vnd.tind.parts";
  context.etag_base = dataset.version + "-parts";
  context.vary = "";  // the pieces are packed already
  context.set_version(dataset);
  if (context.not_modified()) return;

  ByteWriter head;
  head.raw(to_bytes("TVP1"));
  head.fixed(key.level);
  head.fixed(static_cast<std::uint8_t>(kPieces));
  head.fixed(std::uint16_t{0});
  head.fixed(key.x);
  head.fixed(key.y);
  std::array<ByteView, kPieces> values;
  std::uint64_t length = 0;
  for (std::size_t k = 0; k < kPieces; ++k) {
    const auto value = snapshot.find(keys[k]);
    if (!value) return internal_error(context.out, {ErrorKind::kCorrupt, dataset.name + ": a piece is missing"});
    head.fixed(static_cast<std::uint32_t>(value->size()));
    values[k] = *value;
    length += value->size();
  }
  auto owned = std::make_shared<const Bytes>(head.take());
  context.ok(Coding::kIdentity);
  context.out.content_length = length + owned->size();
  context.out.add(*owned);
  for (const ByteView value : values) context.out.add(value);
  context.out.keep(std::move(owned));
}

// One stored value: a zstd frame goes out as it is to whoever takes zstd.
void Handler::piece(Context& context, const ServedDataset& served, const PieceKey& key) {
  const Dataset& dataset = *served.dataset;
  const auto opened = context.worker.snapshot(served.dataset);
  if (!opened) return internal_error(context.out, opened.error());
  const TileStore::Snapshot& snapshot = **opened;
  const auto value = snapshot.find(key);
  if (!value) return not_found(context.out, "no such piece");
  context.content_type = "application/vnd.tind.piece";
  context.etag_base = dataset.version + "-piece";
  context.set_version(dataset);
  if (context.not_modified()) return;
  const bool packed = is_zstd_frame(*value);
  if (packed && context.wanted != Coding::kZstd) {
    auto record = unpack_value(*value);
    if (!record) return internal_error(context.out, record.error());
    return context.whole(share(apply_coding(std::move(*record), context.wanted)));
  }
  context.ok(packed ? Coding::kZstd : Coding::kIdentity);
  context.out.content_length = value->size();
  context.out.add(*value);
}

void Handler::codes(Context& context, const ServedDataset& served, const TileKey& key) {
  const Dataset& dataset = *served.dataset;
  const auto opened = context.worker.snapshot(served.dataset);
  if (!opened) return internal_error(context.out, opened.error());
  const TileStore::Snapshot& snapshot = **opened;
  if (!snapshot.find(PieceKey{PieceKind::kBody, key.level, key.x, key.y}))
    return not_found(context.out, "no such tile");
  context.content_type = "application/json";
  context.etag_base = dataset.version + "-codes";
  context.set_version(dataset);
  const std::string cache_key = fmt::format("{}|{}/{}/{}|codes", dataset.name, key.level, key.x, key.y);
  return coded(context, cache_key, [&]() -> Result<Bytes> {
    using nlohmann::ordered_json;
    const auto node = load_tile(dataset, snapshot, key);
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

void Handler::answer(Context& context) {
  const Site& site = context.worker.site();
  Response& out = context.out;
  const auto with_dataset = [&](const std::string& name, auto&& use) {
    const ServedDataset* served = site.find(name);
    served ? use(*served) : not_found(out, "no such dataset");
  };
  // Copied: the context is written to while it is visited.
  const Route route = context.target.route;
  std::visit(Overloaded{[&](const IndexRoute&) { document(context, site.index); },
                        [&](const DatasetsRoute&) { document(context, site.list); },
                        [&](const ScriptRoute&) { document(context, site.script); },
                        [&](const StyleRoute&) { document(context, site.style); },
                        [&](const HealthRoute&) { text_response(out, kOk, "ok", "Cache-Control: no-store\r\n"); },
                        [&](const ReadyRoute&) {
                          const bool draining = draining_;
                          text_response(out, draining ? kUnavailable : kOk, draining ? "stopping" : "ready",
                                        "Cache-Control: no-store\r\n");
                        },
                        [&](const CesiumRoute& r) { cesium(context, r.path); },
                        [&](const DirectoryRoute& r) {
                          with_dataset(r.name, [&](const ServedDataset&) {
                            // Relative, for the sake of proxies that serve us below another path.
                            text_response(out, kMovedPermanently, "moved",
                                          fmt::format("Location: {}/\r\n", percent_encode(r.name)));
                          });
                        },
                        [&](const DocumentRoute& r) {
                          with_dataset(r.name, [&](const ServedDataset& served) {
                            document(context, r.document == DatasetDocument::kGlobe  ? site.globe
                                              : r.document == DatasetDocument::kMeta ? served.meta
                                                                                     : served.layer);
                          });
                        },
                        [&](const TileRoute& r) {
                          with_dataset(r.name, [&](const ServedDataset& served) {
                            r.format == TileFormat::kParts
                                ? parts(context, served, r.key)
                                : tile(context, served, r.key, r.format == TileFormat::kTerrain);
                          });
                        },
                        [&](const PieceRoute& r) {
                          with_dataset(r.name, [&](const ServedDataset& served) { piece(context, served, r.key); });
                        },
                        [&](const CodesRoute& r) {
                          with_dataset(r.name, [&](const ServedDataset& served) { codes(context, served, r.key); });
                        }},
             route);
}

void Handler::handle(const Request& request, WorkerState& worker, Response& out) {
  const bool is_head = request.method == "HEAD";
  if (request.method == "OPTIONS") {
    out.reset();
    out.status = kNoContent;
    out.fields = fmt::format(
        "Allow: {0}\r\nAccess-Control-Allow-Origin: *\r\nAccess-Control-Allow-Methods: {0}\r\n"
        "Access-Control-Allow-Headers: *\r\nAccess-Control-Max-Age: 86400\r\n",
        kAllow);
    return;
  }
  if (request.method != "GET" && !is_head) {
    return text_response(out, kMethodNotAllowed, "only GET, HEAD and OPTIONS", fmt::format("Allow: {}\r\n", kAllow));
  }
  auto parsed = parse_target(request.target);
  if (const int* status = std::get_if<int>(&parsed)) {
    *status == kNotFound ? not_found(out, "no such address") : text_response(out, *status, "malformed address");
  } else {
    Context context{request, worker, out, std::move(std::get<Target>(parsed)), choose_coding(request.accept_encoding)};
    answer(context);
  }
  if (is_head) out.drop_body();
}

}  // namespace tind
