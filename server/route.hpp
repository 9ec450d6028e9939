// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <variant>

#include "core/piece_key.hpp"
#include "core/tile_key.hpp"

namespace tind {

enum class TileFormat { kTerrain, kVn, kParts };
enum class DatasetDocument { kGlobe, kMeta, kLayer };

struct IndexRoute {};
struct DatasetsRoute {};
struct HealthRoute {};
struct ReadyRoute {};
struct ScriptRoute {};  ///< /tind/globe.js
struct StyleRoute {};   ///< /tind/style.css
struct CesiumRoute {
  std::string_view path;  ///< Below the CesiumJS directory; no empty, "." or ".." part, no part that begins with a dot.
};
struct DirectoryRoute {
  std::string_view name;  ///< /{name} without its slash: to be redirected.
};
struct DocumentRoute {
  std::string_view name;
  DatasetDocument document;
};
struct TileRoute {
  std::string_view name;
  TileKey key;
  TileFormat format;
};
struct PieceRoute {
  std::string_view name;
  PieceKey key;  ///< Valid, not always canonical.
};
struct CodesRoute {
  std::string_view name;
  TileKey key;
};

/// What a request asks for (docs/http.md).
using Route = std::variant<IndexRoute, DatasetsRoute, HealthRoute, ReadyRoute, ScriptRoute, StyleRoute, CesiumRoute,
                           DirectoryRoute, DocumentRoute, TileRoute, PieceRoute, CodesRoute>;

struct Target {
  Route route;
  std::string_view query;  ///< What follows '?', as sent.
};

/// Names that no dataset may have, because routes have them.
bool is_reserved_name(std::string_view name);

/// Parses a request target: origin-form, or absolute-form, whose host is ignored. Returns the status to answer with
/// when it is none: 400 malformed, 404 no such route or a key out of range. Views in the result are of `target` or of
/// `scratch`, which holds what had to be percent-decoded. Takes no memory but for that. Safe for any bytes.
std::variant<Target, int> parse_target(std::string_view target, std::string& scratch);

/// The value of `name` in a query string, percent-decoded; nullopt when absent or malformed.
std::optional<std::string> query_value(std::string_view query, std::string_view name);

/// The same as it stands there, not decoded.
std::optional<std::string_view> raw_query_value(std::string_view query, std::string_view name);

/// Percent-encodes all but unreserved characters (RFC 3986), for one path segment.
std::string percent_encode(std::string_view text);

}  // namespace tind
