// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "core/format/bytes.hpp"
#include "core/result.hpp"
#include "server/dataset.hpp"

namespace tind {

/// What is made of a tile for clients, as against what is stored.
enum class EncodedFormat : std::uint8_t { kTerrain, kTerrainWithNormals, kVn, kCodes };

/// The tile in a format, not coded (docs/http.md, docs/format.md 7). kCorrupt: a piece is missing or broken, or the
/// manifest does not know the tile. Precondition: the tile is stored.
Result<Bytes> encode_tile(const Dataset& dataset, const TileStore::Snapshot& snapshot, const TileKey& key,
                          EncodedFormat format);

/// Changes whenever encode_tile could give other bytes for the same pieces: with the daemon's version and with what the
/// manifest says of lattice and level.
std::uint64_t encoding_fingerprint(const Dataset& dataset, const TileKey& key);

}  // namespace tind
