// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <vector>

#include "core/height_field.hpp"
#include "core/level_spec.hpp"
#include "core/line_pyramid.hpp"
#include "core/tile_key.hpp"

namespace tind {

/// What one level takes: built in a sample region, or forecast for all tiles.
struct LevelCost {
  double tiles = 0;
  double vertices = 0;  ///< Each once (in a region: border vertices half, corners a quarter).
  double bytes = 0;     ///< Stored, with their share of the file's pages.
  double seconds = 0;   ///< Refining and encoding, processor seconds.
};

/// A region built to be measured: a tile a few levels above the bottom and what is below it.
struct RegionSample {
  std::vector<LevelCost> levels;  ///< Index: levels below the region's top; the last is the bottom level.
};

/// Builds the region `top` as a build would: its border lines and its own triangulation and, on each finer level, two
/// of those children of each tile built before that have data (which ones alternates with `turn`); what is left out is
/// taken to be like what is done. `field` must hold the posts around the region and the heights pinned by `lines`. Pure
/// but for the clock; thread safe.
RegionSample build_region(const HeightField& field, const LevelTable& table, const LinePyramid& lines,
                          const TileKey& top, int turn);

/// Processor seconds of the calling thread.
double thread_seconds();

}  // namespace tind
