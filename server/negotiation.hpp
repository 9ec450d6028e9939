// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <optional>
#include <string_view>

namespace tind {

/// Content codings that the daemon speaks.
enum class Coding { kIdentity, kGzip, kZstd };

/// The coding a client likes best by its Accept-Encoding field (RFC 9110, 12.5.3): highest q, on a tie zstd, gzip,
/// identity. Identity when the field is absent, malformed or leaves nothing.
Coding choose_coding(std::optional<std::string_view> accept_encoding);

/// How entity tags are compared (RFC 9110, 8.8.3.2).
enum class EtagComparison { kWeak, kStrong };

/// True iff a list of entity tags (If-None-Match, If-Match) names `etag`, a strong one with its quotes, or is "*". By
/// strong comparison a weak tag in the list matches nothing (RFC 9110, 13.1.1 and 13.1.2).
bool etag_matches(std::string_view list, std::string_view etag, EtagComparison comparison = EtagComparison::kWeak);

/// True iff a quantized-mesh client asks for octvertexnormals: CesiumJS in Accept (`;extensions=a-b`), cesium-native in
/// the query (`extensions=a-b`; pass its value).
bool wants_normals(std::optional<std::string_view> accept, std::optional<std::string_view> query_extensions);

}  // namespace tind
