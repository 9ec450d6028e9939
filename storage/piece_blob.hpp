// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "core/format/bytes.hpp"
#include "core/result.hpp"
#include "core/virtual_node.hpp"

namespace tind {

/// Records of docs/format.md 3-5 (not yet packed into values). encode_* cannot fail; decode_* are safe for untrusted
/// bytes, check every count before taking memory and fail with kCorrupt. All are pure and thread safe.
Bytes encode_corner(const Corner& corner);
Bytes encode_edge(const EdgeChain& edge);
Bytes encode_body(const TileBody& body);
/// The stored VALUE of a body: its record packed by sections. What pack_value(encode_body(body)) gives is a value of
/// the same record, some per cent longer.
Bytes pack_body(const TileBody& body);
Result<Corner> decode_corner(ByteView record);
Result<EdgeChain> decode_edge(ByteView record);
Result<TileBody> decode_body(ByteView record);

/// What stands before the arrays of a body.
struct BodySummary {
  TileStats stats;
  std::uint64_t n_interior = 0, n_triangles = 0;
  friend bool operator==(const BodySummary&, const BodySummary&) = default;
};
/// Only that, from a body's stored VALUE: unpacks a block of it at most. Damage behind it goes unseen.
Result<BodySummary> decode_body_summary(ByteView value);

/// Only the interior vertices of a body, from its stored VALUE (a record or a zstd frame): unpacks and checks no more
/// than is needed for them. What decode_body accepts gives the same vertices here; damage behind them goes unseen.
Result<std::vector<LocalVertex>> decode_interior(ByteView value);

}  // namespace tind
