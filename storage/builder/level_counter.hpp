// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>

#include "core/piece_key.hpp"
#include "storage/builder/pyramid_builder.hpp"
#include "storage/builder/tile_maker.hpp"
#include "storage/level_tally.hpp"
#include "storage/manifest.hpp"

namespace tind {

/// Counts the pieces of one level, in storage order, for the manifest and for the report. One thread.
class LevelCounter {
 public:
  LevelCounter(const PyramidInput& input, const RefinementSpec& spec, int level);

  /// A corner or an edge, whose value has so many bytes.
  void add_border_piece(const PieceKey& key, const BorderFigures& figures, std::size_t n_bytes);
  /// A body, whose value has so many bytes.
  void add_tile(const TileKey& key, const TileFigures& figures, std::size_t n_bytes);
  /// All that was added.
  LevelInfo finish() { return tally_.finish(); }
  const LevelBreakdown& parts() const { return parts_; }

 private:
  LevelTally tally_;
  LevelBreakdown parts_;
};

/// A line for the user where the level breaks its promise.
void note_errors(const LevelInfo& level, Progress& progress);

}  // namespace tind
