// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/route.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <span>

namespace tind {
namespace {

constexpr int kBadRequest = 400;
constexpr int kNotFound = 404;
constexpr std::size_t kMaxParts = 32;  // deeper than any file of CesiumJS

// Appends `text` to `out`, decoded; false when it is malformed.
bool percent_decode(std::string_view text, std::string& out) {
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] != '%') {
      out.push_back(text[i]);
      continue;
    }
    unsigned value = 0;
    if (i + 2 >= text.size()) return false;
    const char* const last = text.data() + i + 3;
    const auto [end, error] = std::from_chars(text.data() + i + 1, last, value, 16);
    if (error != std::errc() || end != last) return false;
    out.push_back(static_cast<char>(value));
    i += 2;
  }
  return true;
}

// Decimal without sign or leading zeros, so that a resource has one address.
std::optional<std::uint32_t> parse_number(std::string_view text) {
  if (text.empty() || (text.size() > 1 && text[0] == '0')) return std::nullopt;
  std::uint32_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

struct Address {
  std::uint8_t level;
  std::uint32_t i, j;
};

std::optional<Address> parse_address(std::string_view level, std::string_view i, std::string_view j) {
  const auto l = parse_number(level), a = parse_number(i), b = parse_number(j);
  if (!l || !a || !b || *l > kMaxLevel) return std::nullopt;
  return Address{static_cast<std::uint8_t>(*l), *a, *b};
}

using Answer = std::variant<Target, int>;

Answer piece_route(std::string_view name, PieceKind kind, const std::optional<Address>& at) {
  if (!at) return kNotFound;
  const PieceKey key{kind, at->level, at->i, at->j};
  if (!key.valid()) return kNotFound;
  return Target{PieceRoute{name, key}, {}};
}

Answer tile_route(std::string_view name, std::string_view level, std::string_view x, std::string_view file) {
  const auto dot = file.find('.');
  if (dot == file.npos) return kNotFound;
  const auto at = parse_address(level, x, file.substr(0, dot));
  const std::string_view suffix = file.substr(dot);
  const auto format = suffix == ".terrain" ? std::optional(TileFormat::kTerrain)
                      : suffix == ".vn"    ? std::optional(TileFormat::kVn)
                      : suffix == ".parts" ? std::optional(TileFormat::kParts)
                                           : std::nullopt;
  if (!at || !format) return kNotFound;
  const TileKey key{at->level, at->i, at->j};
  if (!key.valid()) return kNotFound;
  return Target{TileRoute{name, key, *format}, {}};
}

// `parts` are decoded; their path is put together in `scratch`, after what is there.
Answer cesium_route(std::span<const std::string_view> parts, std::string& scratch) {
  const std::size_t begin = scratch.size();
  for (const std::string_view part : parts.subspan(1)) {
    const bool plain = !part.empty() && part[0] != '.' && part.find_first_of(std::string_view("/\\\0", 3)) == part.npos;
    if (!plain) return kNotFound;
    if (scratch.size() > begin) scratch += '/';
    scratch += part;
  }
  if (scratch.size() == begin) return kNotFound;
  return Target{CesiumRoute{std::string_view(scratch).substr(begin)}, {}};
}

Answer route_of(std::span<const std::string_view> parts, std::string& scratch) {
  const std::string_view name = parts[0];
  const std::size_t n = parts.size();
  if (n == 1) {
    if (name.empty()) return Target{IndexRoute{}, {}};
    if (name == "datasets") return Target{DatasetsRoute{}, {}};
    if (name == "health") return Target{HealthRoute{}, {}};
    if (name == "ready") return Target{ReadyRoute{}, {}};
    return Target{DirectoryRoute{name}, {}};
  }
  if (name == "cesium") return cesium_route(parts, scratch);
  if (name == "tind") {
    if (n == 2 && parts[1] == "globe.js") return Target{ScriptRoute{}, {}};
    if (n == 2 && parts[1] == "style.css") return Target{StyleRoute{}, {}};
    return kNotFound;
  }
  if (n == 2) {
    if (parts[1].empty()) return Target{DocumentRoute{name, DatasetDocument::kGlobe}, {}};
    if (parts[1] == "meta.json") return Target{DocumentRoute{name, DatasetDocument::kMeta}, {}};
    if (parts[1] == "layer.json") return Target{DocumentRoute{name, DatasetDocument::kLayer}, {}};
    return kNotFound;
  }
  if (n == 4) return tile_route(name, parts[1], parts[2], parts[3]);
  if (n == 5) {
    const auto at = parse_address(parts[2], parts[3], parts[4]);
    if (parts[1] == "corner") return piece_route(name, PieceKind::kCorner, at);
    if (parts[1] == "body") return piece_route(name, PieceKind::kBody, at);
    if (parts[1] != "codes" || !at) return kNotFound;
    const TileKey key{at->level, at->i, at->j};
    if (!key.valid()) return kNotFound;
    return Target{CodesRoute{name, key}, {}};
  }
  if (n == 6 && parts[1] == "edge" && (parts[3] == "h" || parts[3] == "v")) {
    return piece_route(name, parts[3] == "h" ? PieceKind::kEdgeH : PieceKind::kEdgeV,
                       parse_address(parts[2], parts[4], parts[5]));
  }
  return kNotFound;
}

}  // namespace

bool is_reserved_name(std::string_view name) {
  constexpr std::array<std::string_view, 5> kNames = {"datasets", "health", "ready", "cesium", "tind"};
  return std::find(kNames.begin(), kNames.end(), name) != kNames.end();
}

std::variant<Target, int> parse_target(std::string_view target, std::string& scratch) {
  for (const std::string_view scheme : {"http://", "https://"}) {
    if (!target.starts_with(scheme)) continue;
    const auto path = target.find_first_of("/?", scheme.size());
    target = path == target.npos ? std::string_view("/") : target.substr(path);
    break;
  }
  if (target.empty() || target[0] != '/') return kBadRequest;
  const bool graphic = std::all_of(target.begin(), target.end(), [](char c) { return c > ' ' && c < 0x7f; });
  if (!graphic || target.find('#') != target.npos) return kBadRequest;
  const auto question = target.find('?');
  const std::string_view path = target.substr(1, question == target.npos ? question : question - 1);
  scratch.clear();
  // Room for every part twice, as it is and in a path: views of it must not move.
  if (path.find('%') != path.npos || path.starts_with("cesium/")) scratch.reserve(2 * path.size());
  std::array<std::string_view, kMaxParts> parts;
  std::size_t n_parts = 0;
  for (std::size_t at = 0; at <= path.size();) {
    const std::size_t end = std::min(path.find('/', at), path.size());
    if (n_parts == kMaxParts) return kNotFound;
    std::string_view& part = parts[n_parts++];
    part = path.substr(at, end - at);
    if (part.find('%') != part.npos) {
      const std::size_t begin = scratch.size();
      if (!percent_decode(part, scratch)) return kBadRequest;
      part = std::string_view(scratch).substr(begin);
    }
    at = end + 1;
  }
  Answer answer = route_of({parts.data(), n_parts}, scratch);
  if (Target* found = std::get_if<Target>(&answer); found && question != target.npos) {
    found->query = target.substr(question + 1);
  }
  return answer;
}

std::optional<std::string_view> raw_query_value(std::string_view query, std::string_view name) {
  for (std::size_t at = 0; at <= query.size();) {
    const std::size_t end = std::min(query.find('&', at), query.size());
    const std::string_view pair = query.substr(at, end - at);
    const std::size_t equals = std::min(pair.find('='), pair.size());
    if (pair.substr(0, equals) == name) return pair.substr(std::min(equals + 1, pair.size()));
    at = end + 1;
  }
  return std::nullopt;
}

std::optional<std::string> query_value(std::string_view query, std::string_view name) {
  const auto raw = raw_query_value(query, name);
  std::string value;
  if (!raw || !percent_decode(*raw, value)) return std::nullopt;
  return value;
}

std::string percent_encode(std::string_view text) {
  constexpr std::string_view kHex = "0123456789ABCDEF";
  std::string out;
  for (const char c : text) {
    const bool unreserved = (c >= '0' && c <= '9') || (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') || c == '-' ||
                            c == '.' || c == '_' || c == '~';
    if (unreserved) {
      out.push_back(c);
    } else {
      const auto byte = static_cast<unsigned char>(c);
      out += {'%', kHex[byte >> 4], kHex[byte & 15]};
    }
  }
  return out;
}

}  // namespace tind
