// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <vector>

#include "core/border_line.hpp"
#include "core/height_field.hpp"
#include "core/level_spec.hpp"
#include "core/tile_key.hpp"

namespace tind {

/// Storage order of tiles: by level, then by Morton code.
struct TileOrder {
  bool operator()(const TileKey& a, const TileKey& b) const {
    return a.level != b.level ? a.level < b.level : morton_code(a.x, a.y) < morton_code(b.x, b.y);
  }
};

/// Which tiles a pyramid has. Tiles of one level are in Morton order. A tile is split iff data or falloff touch it and
/// it is not on the bottom level; the four children of a split tile are all stored, both roots always are.
class TilePlan {
 public:
  /// Marks the bottom tiles that posts other than the base touch, and their ancestors.
  TilePlan(const HeightField& field, int bottom_level);

  int bottom_level() const { return static_cast<int>(stored_.size()) - 1; }
  const std::vector<TileKey>& tiles(int level) const { return stored_[static_cast<std::size_t>(level)]; }
  /// Tiles of `level` that have stored children.
  const std::vector<TileKey>& split_tiles(int level) const { return split_[static_cast<std::size_t>(level)]; }
  bool is_split(const TileKey& key) const;
  /// Whether a tile beside the edge has stored children. `line`, `along`: index of the line and of the edge on it, in
  /// tile sides of `level`; the line of longitude 180 may be named from either end.
  bool is_edge_split(int level, bool vertical, std::int64_t line, std::int64_t along) const;

  /// The stretches of border lines that are first used at `level`.
  std::vector<RootEdge> root_edges(int level, const Lattice& lattice) const;

 private:
  std::vector<std::vector<TileKey>> stored_;
  std::vector<std::vector<TileKey>> split_;
};

}  // namespace tind
