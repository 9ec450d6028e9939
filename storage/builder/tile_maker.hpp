// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "core/border_line.hpp"
#include "core/piece_key.hpp"
#include "core/triangulator.hpp"
#include "storage/builder/border_lines.hpp"
#include "storage/builder/plan.hpp"
#include "storage/builder/pyramid_builder.hpp"
#include "storage/builder/tile_digest.hpp"
#include "storage/inputs_blob.hpp"

namespace tind {

/// What is told of a tile without its mesh.
struct TileFigures {
  TileInputs made_of;
  TileStats stats;
  std::uint64_t n_interior = 0, n_triangles = 0;
  bool built = false;     ///< False: taken over.
  bool repeated = false;  ///< Told to be the earlier mesh by few posts.
  bool copied = false;    ///< Taken over without a look at what it is made of.
};

/// A tile's body and inputs record, ready to be written.
struct MadeTile {
  Bytes value;   ///< The stored body.
  Bytes inputs;  ///< The stored TileInputs.
  TileFigures figures;
};

/// What is told of a corner or an edge.
struct BorderFigures {
  std::size_t n_inner = 0;    ///< Vertices inside an edge.
  std::size_t n_outside = 0;  ///< Of all vertices, those beyond the data.
};

/// What is there of a tile already: views into a store.
struct StoredTile {
  ByteView body, inputs;
  /// Of an earlier pyramid, where the tile's posts have changed: the finest descendants that have all of those. Empty:
  /// not known, or too many.
  std::vector<TileKey> changed;
};

/// What refinement of the field works to.
RefinementSpec refinement_spec(const PyramidInput& input, const TilePlan& plan);

/// Makes the pieces of a pyramid, each out of what it depends on. Reads what it is given, which must outlive it. Const
/// access is thread safe as long as nothing is added to the border lines.
class TileMaker {
 public:
  TileMaker(const PyramidInput& input, const TilePlan& plan, const RefinementSpec& spec, const PostDigests& posts,
            const BorderLines& borders)
      : input_(input),
        field_(input.field),
        bottom_level_(input.table.bottom_level()),
        plan_(plan),
        spec_(spec),
        posts_(posts),
        borders_(borders) {}

  /// Cells of a level's tiles (TileTask::n_cell_levels): where a mesh can be told to be the earlier one; tiles with few
  /// levels below are built as fast.
  int n_cell_levels(int level) const;

  /// Refines a stretch of border line. `parent_interior`: interior vertices of the tile whose middle line it lies on;
  /// none at level 0.
  std::vector<LineVertex> refine(const RootEdge& root, std::span<const LocalVertex> parent_interior) const;

  /// Makes a tile; its border lines are there. `inherited`: the interior vertices of its parent. `earlier`: the same
  /// tile of an earlier pyramid, to be taken over, or told to be the same mesh.
  Result<MadeTile> make(const TileKey& key, std::span<const LocalVertex> inherited,
                        const std::optional<StoredTile>& earlier) const;
  /// A tile from what is stored of it, whose body was checked elsewhere. kCorrupt.
  static Result<MadeTile> take_over(const StoredTile& stored);
  static Result<TileFigures> figures_of(const StoredTile& stored);

  struct BorderPiece {
    Bytes value;
    BorderFigures figures;
  };
  /// Makes a corner or an edge; its border line is there.
  BorderPiece make_border_piece(const PieceKey& key) const;
  /// The figures of a stored corner or edge. kCorrupt.
  Result<BorderFigures> figures_of(const PieceKey& key, ByteView value) const;

 private:
  BorderFigures figures_of_edge(const PieceKey& key, const EdgeChain& edge) const;
  BorderFigures figures_of_corner(const PieceKey& key) const;
  TileTask make_task(const TileKey& key, std::span<const LocalVertex> inherited) const;
  std::vector<std::int64_t> pins_of(const RootEdge& root, std::span<const LocalVertex> interior) const;
  void add_runs(const TileKey& key, TileBody& body) const;
  int threads_of(const TileKey& key) const;
  std::optional<TileSurface> repeat(const TileTask& task, const StoredTile& earlier) const;

  const PyramidInput& input_;
  const HeightField& field_;
  const int bottom_level_;
  const TilePlan& plan_;
  const RefinementSpec& spec_;
  const PostDigests& posts_;
  const BorderLines& borders_;
};

}  // namespace tind
