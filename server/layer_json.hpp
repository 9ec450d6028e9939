// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "server/tile_rows.hpp"
#include "storage/manifest.hpp"

namespace tind {

/// Tiles x_first..x_last, y_first..y_last, all stored. TMS rows.
struct TileRectangle {
  std::uint32_t x_first = 0, y_first = 0, x_last = 0, y_last = 0;
  friend bool operator==(const TileRectangle&, const TileRectangle&) = default;
};

/// The stored tiles of a level as disjoint rectangles: runs of a row joined whatever their coverage, then equal runs of
/// rows that follow each other. `rows` sorted as in the manifest. Sorted by y_first, then x_first.
std::vector<TileRectangle> available_rectangles(const std::vector<TileRun>& rows);

/// What layer.json says besides the manifest.
struct LayerOptions {
  std::string name;
  std::string version;  ///< Of all that the tiles' bytes depend on.
  TileRows tiles;       ///< Listed as available.
  std::string parent;   ///< Name of the dataset to be asked for other tiles (`parentUrl`); empty: none.
};

/// layer.json for quantized-mesh clients (TileJSON 2.1.0 with Cesium's members).
std::string make_layer_json(const Manifest& manifest, const LayerOptions& options);

}  // namespace tind
