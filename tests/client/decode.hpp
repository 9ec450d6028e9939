// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "tests/client/byte_cursor.hpp"
#include "tests/client/tile.hpp"

namespace tind::client {

/// The client's own decoders, written from docs/format.md alone. All are pure, thread safe and safe for any bytes; a
/// refusal names the field.

/// An edge record (docs/format.md 4), stored direction, without the corners.
struct EdgeRecord {
  std::uint8_t start_entry = 0, end_entry = 0;
  std::vector<SideVertex> inner;
  friend bool operator==(const EdgeRecord&, const EdgeRecord&) = default;
};

/// The nine pieces of a tile in local order, decoded.
struct Pieces {
  std::array<std::int32_t, 4> corner_z{};
  std::array<EdgeRecord, 4> edges;  ///< Stored direction.
  Tile body;                        ///< Only what the body record holds: `vertices` are the interior ones.
};

/// A .vn tile that also says what its header claims about the pyramid.
struct VnTile {
  Tile tile;
  int lattice_level = 0;
  int height_exponent = 0;
  float tolerance_m = 0;
};

/// The record in a stored value: itself, or what its one zstd frame holds (docs/format.md 2).
Outcome<Blob> open_value(BlobView value);
Outcome<std::int32_t> read_corner(BlobView record);
Outcome<EdgeRecord> read_edge(BlobView record, std::int64_t side);
Outcome<Tile> read_body(BlobView record);
Outcome<VnTile> read_vn(BlobView bytes);

/// The nine stored values of a .parts bundle, in local order, not yet opened.
struct Bundle {
  TileId id;
  std::array<BlobView, 9> values;
};
Outcome<Bundle> read_bundle(BlobView bytes);
/// Opens and decodes all nine.
Outcome<Pieces> read_pieces(const Bundle& bundle, const LatticeFrame& frame);
/// Puts a tile together from its pieces.
Outcome<Tile> assemble_pieces(const TileId& id, const Pieces& pieces, const LatticeFrame& frame);

}  // namespace tind::client
