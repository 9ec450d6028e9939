// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <vector>

#include "core/border_line.hpp"
#include "core/lattice.hpp"
#include "core/piece_key.hpp"
#include "core/tile_key.hpp"
#include "storage/builder/plan.hpp"

namespace tind {

/// What a change of posts can reach in a pyramid whose plan is `plan`. Pure; thread safe.
class UpdateReach {
 public:
  UpdateReach(const TilePlan& plan, const Lattice& lattice) : plan_(plan), lattice_(lattice) {}

  bool is_stored(const TileKey& tile) const;
  /// The stretches that a bottom tile's closed square meets, if only in a point: all that see its posts. May repeat.
  std::vector<RootEdge> roots_at(const TileKey& bottom_tile) const;
  /// The stretches on the middle lines of a split tile.
  std::vector<RootEdge> roots_inside(const TileKey& tile) const;
  /// The stored tiles of any level that have a side on the stretch.
  std::vector<TileKey> tiles_along(const RootEdge& root) const;
  /// The stored edges of any level on the stretch.
  std::vector<PieceKey> edges_along(const RootEdge& root) const;
  /// The corners of any level where a bottom tile has its own. May not be stored.
  std::vector<PieceKey> corners_at(const TileKey& bottom_tile) const;

 private:
  bool is_planned(const RootEdge& root) const;
  /// Calls visit(level, line, along) for the edges of any level that the stretch is cut into.
  template <class Visit>
  void for_edges(const RootEdge& root, Visit visit) const;
  /// The stored tiles beside an edge.
  std::vector<TileKey> tiles_beside(bool vertical, int level, std::int64_t line, std::int64_t along) const;

  const TilePlan& plan_;
  const Lattice lattice_;
};

}  // namespace tind
