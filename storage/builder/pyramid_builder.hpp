// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/height_field.hpp"
#include "core/level_spec.hpp"
#include "core/line_pyramid.hpp"
#include "core/piece_key.hpp"
#include "core/result.hpp"
#include "storage/builder/earlier_pyramid.hpp"
#include "storage/builder/progress.hpp"
#include "storage/manifest.hpp"
#include "storage/tile_store.hpp"

namespace tind {

/// What one level's vertices are there for: corners, border, inherited, of_lines and inserted sum to
/// LevelInfo::n_vertices.
struct LevelBreakdown {
  std::uint64_t corners = 0;
  std::uint64_t border = 0;       ///< Inside edges, seeds and crossings with break lines among them.
  std::uint64_t inherited = 0;    ///< Interior: the parents' vertices and seeds.
  std::uint64_t of_lines = 0;     ///< Interior: vertices of break lines that neither of the former brought.
  std::uint64_t inserted = 0;     ///< Interior: by greedy insertion.
  std::uint64_t outside = 0;      ///< Of all of these, those beyond the data.
  std::uint64_t line_pieces = 0;  ///< Pieces of break lines that tiles held to.
  std::uint64_t left_out = 0;     ///< Pieces of break lines that crossed another and were not held to.
  std::uint64_t built = 0;        ///< Tiles triangulated by this run; the others were taken over as they were.
  std::uint64_t repeated = 0;     ///< Of the tiles built, those told to have the earlier mesh by few posts.
  std::uint64_t copied = 0;       ///< Tiles that nothing that changed reaches: not even looked at.
  double seconds = 0;
};

/// What the pyramid is built from; not owned.
struct PyramidInput {
  const HeightField& field;
  const LevelTable& table;
  const LinePyramid& lines;
  int threads = 1;
  const std::atomic<bool>* cancel = nullptr;
  /// Build this part of several only; 0 <= index < count. count 1: all of it.
  int shard_index = 0, shard_count = 1;
  /// An earlier pyramid: bodies that were made of the same inputs are taken from it. Null: none.
  const EarlierPyramid* earlier = nullptr;
  /// Whether its grid of posts lies where the field's does, and their blocks with them.
  bool is_grid_as_it_was = false;
};

class PatchedPieces;

/// What became of it.
struct PyramidOutcome {
  std::vector<LevelInfo> levels;
  std::vector<LevelBreakdown> breakdown;
  int shard_cut_level = 0;   ///< Where shards are cut.
  std::string content_hash;  ///< Of all pieces.
  /// What is still to be stored, with the manifest; null: everything was appended to the writer.
  std::shared_ptr<PatchedPieces> patched;
  /// With PyramidInput::earlier: pieces that it does not have, or has with another value, in storage order.
  std::vector<PieceKey> changed;
};

/// Refines, encodes and appends all levels, coarse to fine. What the writer has from an interrupted run is not built
/// again. What an update copies is appended by PyramidOutcome::patched. `progress` is told of the time left. kIo when
/// the store cannot be written, kInterrupted when cancelled. The bytes do not depend on the number of threads, nor on
/// what was taken over.
Result<PyramidOutcome> build_levels(const PyramidInput& input, TileStoreWriter& writer, Progress& progress);

}  // namespace tind
