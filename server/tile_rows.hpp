// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <vector>

#include "core/tile_key.hpp"
#include "storage/manifest.hpp"

namespace tind {

/// The stored tiles of each level (index = level) as runs, sorted by y, then x_first; runs of one row do not overlap.
using TileRows = std::vector<std::vector<TileRun>>;

/// Of a manifest: all its tiles.
TileRows rows_of(const Manifest& manifest);

/// True iff one of the runs has the tile.
bool has_tile(const TileRows& rows, const TileKey& key);

/// The tiles that a dataset answers for itself when `base` (sorted as above) stands behind it: those wholly inside its
/// data, and those partly inside that the base has not. Tiles without data of its own are only there to make splits
/// complete; over a base they would hide what it knows. With every tile its ancestors are in the result or the base.
TileRows own_rows(const Manifest& manifest, const TileRows& base);

/// Tiles of either. Coverages are those of `first` where both have a tile.
TileRows join_rows(const TileRows& first, const TileRows& second);

}  // namespace tind
