// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/handler.hpp"

#include <fmt/format.h>

#include <array>
#include <charconv>
#include <cstring>

#include "server/conditions.hpp"
#include "server/log.hpp"
#include "server/negotiation.hpp"
#include "server/static_files.hpp"
#include "storage/value_hash.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

constexpr int kOk = 200, kNoContent = 204, kPartialContent = 206, kNotModified = 304, kMovedPermanently = 308,
              kBadRequest = 400, kNotFound = 404, kMethodNotAllowed = 405, kPreconditionFailed = 412,
              kRangeNotSatisfiable = 416, kInternalError = 500, kNotImplemented = 501, kUnavailable = 503;
constexpr std::size_t kMegabyte = std::size_t{1} << 20;
constexpr std::string_view kAllow = "Allow: GET, HEAD, OPTIONS\r\n";
// An address that carries the dataset's version never changes its bytes; all others are asked again after a minute.
constexpr std::string_view kForever = "Cache-Control: public, max-age=31536000, immutable\r\n";
constexpr std::string_view kShortly = "Cache-Control: public, max-age=60\r\n";
constexpr std::string_view kNever = "Cache-Control: no-store\r\n";
constexpr std::string_view kRanges = "Accept-Ranges: bytes\r\n";
// What RFC 9110 and RFC 5789 know; any other word is no method to us.
constexpr std::array<std::string_view, 6> kOtherMethods = {"POST", "PUT", "DELETE", "PATCH", "TRACE", "CONNECT"};

// Representations in the cache's keys: two bits of coding below, these above; kPiece and those behind it by PieceKind.
enum class Kind : std::uint32_t { kTerrain, kTerrainWithNormals, kVn, kCodes, kDocument, kFile, kPiece };

template <class... Visitors>
struct Overloaded : Visitors... {
  using Visitors::operator()...;
};
template <class... Visitors>
Overloaded(Visitors...) -> Overloaded<Visitors...>;

std::uint64_t hash_text(std::string_view text) {
  return value_hash({reinterpret_cast<const std::uint8_t*>(text.data()), text.size()});
}
std::uint64_t hash_numbers(std::span<const std::uint64_t> numbers) {
  return value_hash({reinterpret_cast<const std::uint8_t*>(numbers.data()), numbers.size_bytes()});
}

CacheKey cache_key(std::uint64_t source, Kind kind, Coding coding, const TileKey& key = {}) {
  return {source, packed(key), static_cast<std::uint32_t>(kind) << 2 | static_cast<std::uint32_t>(coding)};
}
CacheKey cache_key(std::uint64_t source, const PieceKey& key, Coding coding) {
  const PieceKey at = key.canonical();
  const auto kind = static_cast<std::uint32_t>(Kind::kPiece) + static_cast<std::uint32_t>(at.kind);
  return cache_key(source, static_cast<Kind>(kind), coding, {at.level, at.i, at.j});
}

// An entity tag, made without memory: "HASH-kind", with the coding's letter.
class Tag {
 public:
  Tag(std::uint64_t hash, std::string_view kind, Coding coding) {
    constexpr std::string_view kHex = "0123456789abcdef";
    char* to = text_.data();
    *to++ = '"';
    for (int shift = 60; shift >= 0; shift -= 4) *to++ = kHex[hash >> shift & 15];
    *to++ = '-';
    std::memcpy(to, kind.data(), kind.size());
    to += kind.size();
    if (coding != Coding::kIdentity) *to++ = coding == Coding::kZstd ? 'z' : 'g';
    *to++ = '"';
    size_ = static_cast<std::size_t>(to - text_.data());
  }
  std::string_view view() const { return {text_.data(), size_}; }

 private:
  std::array<char, 32> text_;
  std::size_t size_;
};

}  // namespace

// What the answers to one request share.
struct Handler::Context {
  const Request& request;
  WorkerState& worker;
  Response& out;
  Target target;
  Coding wanted;
  std::string_view cache_control = kShortly;
  const ServedDataset* asked = nullptr;  ///< The dataset that the address names; a base of it may answer.

  void set_version() {
    if (raw_query_value(target.query, "v") == asked->version) cache_control = kForever;
  }
  void not_found(std::string_view what) { problem_response(out, kNotFound, what, request.target, kShortly); }
  void internal_error(const Error& error) {
    log_error(error.message);
    problem_response(out, kInternalError, "this part of the dataset cannot be read", request.target);
  }
  // Answers 304 or 412 where the request's conditions want it.
  template <class AppendFields>
  bool is_answered_by(const Validators& validators, AppendFields&& append_validators) {
    const Condition condition = evaluate_conditions(request, validators);
    if (condition == Condition::kProceed) return false;
    if (condition == Condition::kFailed) {
      problem_response(out, kPreconditionFailed, "the resource is not what the request expects", request.target);
    } else {
      out.reset();
      out.status = kNotModified;
      append_validators(out.fields);
      out.fields += cache_control;
    }
    return true;
  }
  // Leaves what Range asks for of a 200 that is not coded.
  void apply_range(const Validators& validators) {
    out.fields += kRanges;
    if (!request[RequestField::kRange] || request.method != "GET") return;
    const std::uint64_t total = *out.content_length;
    const auto range = choose_range(request, validators, total);
    if (!range) return;
    if (range->length == 0) {
      const std::string content_range = fmt::format("Content-Range: bytes */{}\r\n", total);
      return problem_response(out, kRangeNotSatisfiable, "the range is outside the resource", request.target,
                              content_range);
    }
    out.status = kPartialContent;
    out.fields +=
        fmt::format("Content-Range: bytes {}-{}/{}\r\n", range->first, range->first + range->length - 1, total);
    out.content_length = range->length;
    out.cut(range->first, range->length);
  }
};

// What is known of an answer before its bytes are there.
struct Handler::Representation {
  const char* content_type;
  std::string_view etag;
  const char* vary;  ///< Empty: the answer depends on the address alone.
  const Dataset* dataset = nullptr;

  Validators validators() const {
    return {etag, dataset ? std::optional<std::int64_t>(dataset->modified_s) : std::nullopt};
  }
  void append_validators(std::string& fields) const {
    fields.append("ETag: ").append(etag).append("\r\nAccess-Control-Expose-Headers: ETag, Content-Range\r\n");
    if (dataset) fields.append("Last-Modified: ").append(dataset->last_modified).append("\r\n");
    if (vary[0] != '\0') fields.append("Vary: ").append(vary).append("\r\n");
  }
  void append_content(std::string& fields, Coding coding) const {
    fields.append("Content-Type: ").append(content_type).append("\r\nX-Content-Type-Options: nosniff\r\n");
    if (coding != Coding::kIdentity) fields.append("Content-Encoding: ").append(coding_name(coding)).append("\r\n");
  }
};

namespace {

RouteKind kind_of(const Route& route) {
  return std::visit(
      Overloaded{
          [](const IndexRoute&) { return RouteKind::kIndex; },
          [](const DatasetsRoute&) { return RouteKind::kDatasets; },
          [](const ScriptRoute&) { return RouteKind::kAsset; }, [](const StyleRoute&) { return RouteKind::kAsset; },
          [](const HealthRoute&) { return RouteKind::kHealth; }, [](const ReadyRoute&) { return RouteKind::kReady; },
          [](const CesiumRoute&) { return RouteKind::kCesium; },
          [](const DirectoryRoute&) { return RouteKind::kRedirect; },
          [](const DocumentRoute& r) {
            return r.document == DatasetDocument::kGlobe  ? RouteKind::kGlobe
                   : r.document == DatasetDocument::kMeta ? RouteKind::kMeta
                                                          : RouteKind::kLayer;
          },
          [](const TileRoute& r) {
            return r.format == TileFormat::kTerrain ? RouteKind::kTerrain
                   : r.format == TileFormat::kVn    ? RouteKind::kVn
                                                    : RouteKind::kParts;
          },
          [](const PieceRoute&) { return RouteKind::kPiece; }, [](const CodesRoute&) { return RouteKind::kCodes; }},
      route);
}

// The page of `/datasets` that the query asks for, from 0; nullopt: there is no such page.
std::optional<std::size_t> list_page(std::string_view query, std::size_t n_pages) {
  const auto text = raw_query_value(query, "page");
  if (!text) return 0;
  std::size_t page = 0;
  const auto [end, error] = std::from_chars(text->data(), text->data() + text->size(), page);
  if (error != std::errc() || end != text->data() + text->size() || page < 1 || page > n_pages) return std::nullopt;
  return page - 1;
}

void send(Response& out, std::string_view cache_control, CachedResponse&& cached) {
  out.reset();
  out.fields.append(cached.fields()).append(cache_control);
  out.content_length = cached.body().size();
  out.add(cached.body());
  out.coding = cached.coding();
  out.keep(cached.take_owner());
}

}  // namespace

Handler::Handler(const Settings& settings)
    : cache_(static_cast<std::size_t>(settings.cache_mb) * kMegabyte),
      cross_origin_(settings.cors_origins),
      public_address_(settings) {}

// The representation, coded: made by `make` (-> Result<Bytes>) and kept in the cache.
template <class Make>
void Handler::coded(Context& context, const CacheKey& key, const Representation& representation, Make&& make) {
  const auto append_validators = [&](std::string& fields) { representation.append_validators(fields); };
  if (context.is_answered_by(representation.validators(), append_validators)) return;
  const auto lock = cache_.lock_making(key);
  CachedResponse cached = cache_.find(key);
  if (!cached) {
    Result<Bytes> bytes = make();
    if (!bytes) return context.internal_error(bytes.error());
    const Coded body = apply_coding(std::move(*bytes), context.wanted);
    std::string content_fields, validator_fields;
    representation.append_content(content_fields, body.coding);
    representation.append_validators(validator_fields);
    cached = cache_.put(key, {content_fields, validator_fields, representation.etag, body.coding, body.bytes});
  }
  send(context.out, context.cache_control, std::move(cached));
  if (context.out.coding == Coding::kIdentity) context.apply_range(representation.validators());
}

void Handler::document(Context& context, const Document& document) {
  const std::uint64_t hash = hash_text(document.etag_base);
  const Tag tag(hash, "d", context.wanted);
  coded(context, cache_key(hash, Kind::kDocument, context.wanted),
        {document.content_type, tag.view(), "Accept-Encoding"},
        [&]() -> Result<Bytes> { return Bytes(document.text.begin(), document.text.end()); });
}

// The same with absolute links where somebody has said what clients call us: `make_absolute` (text, base -> text).
template <class MakeAbsolute>
void Handler::linked_document(Context& context, const Document& document, MakeAbsolute&& make_absolute) {
  const std::string base = public_address_.base_for(context.request);
  const std::uint64_t hash = base.empty() ? hash_text(document.etag_base)
                                          : hash_numbers(std::array{hash_text(document.etag_base), hash_text(base)});
  const Tag tag(hash, "d", context.wanted);
  const char* vary = public_address_.depends_on_request()
                         ? "Accept-Encoding, Forwarded, X-Forwarded-Proto, X-Forwarded-Host, X-Forwarded-Prefix"
                         : "Accept-Encoding";
  coded(context, cache_key(hash, Kind::kDocument, context.wanted), {document.content_type, tag.view(), vary},
        [&]() -> Result<Bytes> {
          const std::string text = base.empty() ? document.text : make_absolute(document.text, base);
          return Bytes(text.begin(), text.end());
        });
}

void Handler::cesium(Context& context, std::string_view path) {
  const std::string& root = context.worker.site().cesium_root;
  if (root.empty()) return context.not_found("CesiumJS is not installed; start tind with --cesium DIR");
  const auto file = find_static_file(root, std::string(path));
  if (!file) return context.not_found("no such file in CesiumJS");
  if (!file->compressible) context.wanted = Coding::kIdentity;
  const std::uint64_t hash = hash_numbers(std::array{hash_text(file->path), hash_text(file->stamp)});
  const Tag tag(hash, "f", context.wanted);
  coded(context, cache_key(hash, Kind::kFile, context.wanted),
        {file->content_type, tag.view(), file->compressible ? "Accept-Encoding" : ""},
        [&] { return read_static_file(*file); });
}

void Handler::terrain(Context& context, const ServedDataset& served, const TileKey& key) {
  bool normals = context.worker.normals_for(context.request[RequestField::kAccept]);
  if (!normals && !context.target.query.empty()) {
    const auto extensions = query_value(context.target.query, "extensions");
    normals = extensions && wants_normals(std::nullopt, std::string_view(*extensions));
  }
  encoded(context, served, key, normals ? EncodedFormat::kTerrainWithNormals : EncodedFormat::kTerrain);
}

// .terrain, .vn and codes: made of the pieces once, then out of the cache.
void Handler::encoded(Context& context, const ServedDataset& served, const TileKey& key, EncodedFormat format) {
  struct Properties {
    const char* content_type;
    std::string_view tag;
    const char* vary;
  };
  constexpr std::array<Properties, 4> kProperties = {{
      {"application/vnd.quantized-mesh", "q", "Accept, Accept-Encoding"},
      {"application/vnd.quantized-mesh", "qn", "Accept, Accept-Encoding"},
      {"application/vnd.tind.vn", "vn", "Accept-Encoding"},
      {"application/json", "c", "Accept-Encoding"},
  }};
  const Dataset& dataset = *served.dataset;
  context.set_version();
  const CacheKey cached_as = cache_key(dataset.id, static_cast<Kind>(format), context.wanted, key);
  if (CachedResponse cached = cache_.find(cached_as)) {
    const Validators validators{cached.etag(), dataset.modified_s};
    if (context.is_answered_by(validators, [&](std::string& fields) { fields += cached.validator_fields(); })) return;
    send(context.out, context.cache_control, std::move(cached));
    if (context.out.coding == Coding::kIdentity) context.apply_range(validators);  // `out` holds the tag now
    return;
  }
  const auto resolved = context.worker.resolve(served.dataset, key);
  if (!resolved) return context.internal_error(resolved.error());
  if (!*resolved) return context.not_found("no such tile");
  // The bytes are a function of the pieces, with normals also of the neighbours', and of the encoder.
  std::array<std::uint64_t, 10> hashes = {encoding_fingerprint(dataset, key), (*resolved)->hash};
  if (format == EncodedFormat::kTerrainWithNormals) {
    std::size_t n = 2;
    for (const TileKey& other : neighbours_of(key)) {
      const auto neighbour = context.worker.resolve(served.dataset, other);
      if (!neighbour) return context.internal_error(neighbour.error());
      hashes[n++] = *neighbour ? (*neighbour)->hash : 1;
    }
  }
  const Properties& properties = kProperties[static_cast<std::size_t>(format)];
  const Tag tag(hash_numbers(hashes), properties.tag, context.wanted);
  coded(context, cached_as, {properties.content_type, tag.view(), properties.vary, &dataset}, [&]() -> Result<Bytes> {
    const auto snapshot = context.worker.snapshot(served.dataset);
    if (!snapshot) return tl::unexpected(snapshot.error());
    return encode_tile(dataset, **snapshot, key, format);
  });
}

// The nine values out of the memory map, behind a head with their lengths.
void Handler::parts(Context& context, const ServedDataset& served, const TileKey& key) {
  const auto resolved = context.worker.resolve(served.dataset, key);
  if (!resolved) return context.internal_error(resolved.error());
  if (!*resolved) return context.not_found("no such tile");
  const ResolvedTile& tile = **resolved;
  context.set_version();
  const Tag tag(tile.hash, "p", Coding::kIdentity);
  const Representation representation{"application/vnd.tind.parts", tag.view(), "", served.dataset.get()};
  if (context.is_answered_by(representation.validators(),
                             [&](std::string& fields) { representation.append_validators(fields); })) {
    return;
  }
  Response& out = context.out;
  out.reset();
  // The values lie apart in a map that may be out of the processor's caches: their beginnings are fetched at once.
  for (const std::uint8_t* const address : tile.addresses) __builtin_prefetch(address);
  representation.append_content(out.fields, Coding::kIdentity);
  representation.append_validators(out.fields);
  out.fields += context.cache_control;
  const auto put = [&](auto value) {
    out.lead.append(reinterpret_cast<const char*>(&value),
                    sizeof value);  // little-endian, as core/format/bytes.hpp wants
  };
  out.lead += "TVP1";
  put(key.level);
  put(static_cast<std::uint8_t>(ResolvedTile::kValues));
  put(std::uint16_t{0});
  put(key.x);
  put(key.y);
  std::uint64_t length = 0;
  for (std::size_t k = 0; k < ResolvedTile::kValues; ++k) {
    put(tile.n_bytes[k]);
    out.add(tile.value(k));
    length += tile.n_bytes[k];
  }
  out.content_length = out.lead.size() + length;
  context.apply_range(representation.validators());
}

// One stored value: out of the memory map as it is, but a zstd frame to whoever takes no zstd: unpacked, and coded,
// once.
void Handler::piece(Context& context, const ServedDataset& served, const PieceKey& key) {
  const auto snapshot = context.worker.snapshot(served.dataset);
  if (!snapshot) return context.internal_error(snapshot.error());
  const auto value = (*snapshot)->find(key);
  if (!value) return context.not_found("no such piece");
  context.set_version();
  const Tag tag(value_hash(*value), "r", context.wanted);
  const Representation representation{"application/vnd.tind.piece", tag.view(), "Accept-Encoding",
                                      served.dataset.get()};
  const Coding stored = is_zstd_frame(*value) ? Coding::kZstd : Coding::kIdentity;
  if (stored == Coding::kZstd && context.wanted != Coding::kZstd) {
    return coded(context, cache_key(served.dataset->id, key, context.wanted), representation,
                 [&] { return unpack_value(*value); });
  }
  if (context.is_answered_by(representation.validators(),
                             [&](std::string& fields) { representation.append_validators(fields); })) {
    return;
  }
  Response& out = context.out;
  out.reset();
  out.add(*value);
  out.content_length = value->size();
  out.coding = stored;
  representation.append_content(out.fields, stored);
  representation.append_validators(out.fields);
  out.fields += context.cache_control;
  if (stored == Coding::kIdentity) context.apply_range(representation.validators());
}

void Handler::answer(Context& context) {
  const Site& site = context.worker.site();
  Response& out = context.out;
  const auto with_dataset = [&](std::string_view name, auto&& use) {
    const auto served = context.worker.dataset(name);
    if (!served) {  // told of when it was tried first
      return problem_response(out, kInternalError, "this dataset cannot be opened", context.request.target, kNever);
    }
    if (!*served && context.worker.is_awaited()) {
      out.reset();
      out.is_later = true;
      return;
    }
    if (!*served) return context.not_found("no such dataset");
    context.asked = *served;
    use(**served);
  };
  const auto with_tile = [&](std::string_view name, const TileKey& key, auto&& use) {
    with_dataset(name, [&](const ServedDataset& served) {
      const ServedDataset& owner = served.owner_of(key);
      use(owner);
      if (&owner != &served && out.status < kBadRequest) {
        out.fields += fmt::format("Tind-Dataset: {}\r\n", percent_encode(owner.dataset->name));
      }
    });
  };
  std::visit(
      Overloaded{
          [&](const IndexRoute&) { document(context, site.index); },
          [&](const DatasetsRoute&) {
            const auto page = list_page(context.target.query, site.lists.size());
            page ? linked_document(context, site.lists[*page], absolute_list) : context.not_found("no such page");
          },
          [&](const ScriptRoute&) { document(context, site.script); },
          [&](const StyleRoute&) { document(context, site.style); },
          [&](const HealthRoute&) { text_response(out, kOk, "ok", kNever); },
          [&](const ReadyRoute&) {
            if (!draining_) return text_response(out, kOk, "ready", kNever);
            problem_response(out, kUnavailable, "stopping", context.request.target, kNever);
          },
          [&](const CesiumRoute& r) { cesium(context, r.path); },
          [&](const DirectoryRoute& r) {
            with_dataset(r.name, [&](const ServedDataset&) {
              // Relative, for the sake of proxies that serve us below another path.
              text_response(out, kMovedPermanently, "moved", fmt::format("Location: {}/\r\n", percent_encode(r.name)));
            });
          },
          [&](const DocumentRoute& r) {
            with_dataset(r.name, [&](const ServedDataset& served) {
              if (r.document == DatasetDocument::kLayer) {
                return linked_document(context, served.layer, [&](const std::string& text, const std::string& base) {
                  return absolute_layer(text, base, percent_encode(r.name));
                });
              }
              document(context, r.document == DatasetDocument::kGlobe ? site.globe : served.meta);
            });
          },
          [&](const TileRoute& r) {
            with_tile(r.name, r.key, [&](const ServedDataset& served) {
              if (r.format == TileFormat::kTerrain) return terrain(context, served, r.key);
              if (r.format == TileFormat::kParts) return parts(context, served, r.key);
              encoded(context, served, r.key, EncodedFormat::kVn);
            });
          },
          [&](const PieceRoute& r) {
            with_dataset(r.name, [&](const ServedDataset& served) { piece(context, served, r.key); });
          },
          [&](const CodesRoute& r) {
            with_tile(r.name, r.key,
                      [&](const ServedDataset& served) { encoded(context, served, r.key, EncodedFormat::kCodes); });
          }},
      context.target.route);
}

void Handler::handle(const Request& request, WorkerState& worker, Response& out) {
  const bool is_head = request.method == "HEAD";
  if (request.method == "OPTIONS") {
    out.reset();
    out.status = kNoContent;
    out.fields.append(kAllow).append(
        "Access-Control-Allow-Methods: GET, HEAD, OPTIONS\r\nAccess-Control-Allow-Headers: *\r\n"
        "Access-Control-Max-Age: 86400\r\n");
  } else if (request.method != "GET" && !is_head) {
    const bool known = std::find(kOtherMethods.begin(), kOtherMethods.end(), request.method) != kOtherMethods.end();
    problem_response(out, known ? kMethodNotAllowed : kNotImplemented, "only GET, HEAD and OPTIONS", request.target,
                     known ? kAllow : std::string_view());
  } else {
    auto parsed = parse_target(request.target, worker.target_scratch);
    if (const int* status = std::get_if<int>(&parsed)) {
      const bool absent = *status == kNotFound;
      problem_response(out, *status, absent ? "no such address" : "malformed address", request.target,
                       absent ? kShortly : std::string_view());
    } else {
      Context context{request, worker, out, std::get<Target>(parsed),
                      worker.coding_for(request[RequestField::kAcceptEncoding])};
      answer(context);
      out.route = kind_of(context.target.route);
    }
  }
  cross_origin_.append_fields(request[RequestField::kOrigin], out.fields);
  if (is_head) out.drop_body();
}

void Handler::refuse(int status, std::string_view why, Response& out) {
  problem_response(out, status, why);
  cross_origin_.append_fields(std::nullopt, out.fields);
}

}  // namespace tind
