// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/update_reach.hpp"

#include <array>
#include <cstdint>

#include "storage/builder/border_lines.hpp"

namespace tind {

bool UpdateReach::is_stored(const TileKey& tile) const { return tile.level == 0 || plan_.is_split(tile.parent()); }

bool UpdateReach::is_planned(const RootEdge& root) const {
  return root.level == 0 || plan_.is_split(parent_of(lattice_, root));
}

std::vector<RootEdge> UpdateReach::roots_at(const TileKey& bottom_tile) const {
  std::vector<RootEdge> roots;
  const auto add = [&](bool vertical, int level, std::int64_t line, std::int64_t along) {
    const RootEdge root = root_of(lattice_, vertical, level, line, along);
    if (is_planned(root)) roots.push_back(root);
  };
  const std::int64_t own = lattice_.tile_side(bottom_tile.level);
  for (const int corner : {0, 1, 2, 3}) {
    const std::int64_t x = own * (bottom_tile.x + (corner & 1)), y = own * (bottom_tile.y + (corner >> 1));
    for (int level = 0; level <= bottom_tile.level; ++level) {
      const std::int64_t side = lattice_.tile_side(level), n_x = TileKey::count_x(level);
      // The edges that begin, end or pass there.
      for (const std::int64_t back : {0, 1}) {
        if (x % side == 0) {
          const std::int64_t along = (y - back) / side;
          if (y - back >= 0 && along < TileKey::count_y(level)) add(true, level, x / side, along);
        }
        if (y % side == 0) add(false, level, y / side, (x - back + lattice_.width()) / side % n_x);
      }
    }
  }
  return roots;
}

std::vector<RootEdge> UpdateReach::roots_inside(const TileKey& tile) const {
  const std::int64_t half = lattice_.tile_side(tile.level + 1);
  const std::int64_t west = 2 * half * tile.x, south = 2 * half * tile.y;
  std::vector<RootEdge> roots;
  for (const std::int64_t from : {std::int64_t{0}, half}) {
    roots.push_back({true, tile.level + 1, west + half, south + from});
    roots.push_back({false, tile.level + 1, south + half, west + from});
  }
  return roots;
}

template <class Visit>
void UpdateReach::for_edges(const RootEdge& root, Visit visit) const {
  for (int level = root.level; level <= plan_.bottom_level(); ++level) {
    const std::int64_t side = lattice_.tile_side(level), n = std::int64_t{1} << (level - root.level);
    for (std::int64_t k = 0; k < n; ++k) visit(level, root.at / side, root.start / side + k);
  }
}

std::vector<TileKey> UpdateReach::tiles_beside(bool vertical, int level, std::int64_t line, std::int64_t along) const {
  const std::int64_t n_x = TileKey::count_x(level), n_y = TileKey::count_y(level);
  std::vector<TileKey> tiles;
  for (const std::int64_t back : {0, 1}) {
    const std::int64_t x = vertical ? (line - back + n_x) % n_x : along, y = vertical ? along : line - back;
    if (y < 0 || y >= n_y) continue;
    const TileKey tile{static_cast<std::uint8_t>(level), static_cast<std::uint32_t>(x), static_cast<std::uint32_t>(y)};
    if (is_stored(tile)) tiles.push_back(tile);
  }
  return tiles;
}

std::vector<TileKey> UpdateReach::tiles_along(const RootEdge& root) const {
  std::vector<TileKey> tiles;
  for_edges(root, [&](int level, std::int64_t line, std::int64_t along) {
    for (const TileKey& tile : tiles_beside(root.vertical, level, line, along)) tiles.push_back(tile);
  });
  return tiles;
}

std::vector<PieceKey> UpdateReach::edges_along(const RootEdge& root) const {
  std::vector<PieceKey> edges;
  for_edges(root, [&](int level, std::int64_t line, std::int64_t along) {
    if (tiles_beside(root.vertical, level, line, along).empty()) return;
    const auto l = static_cast<std::uint8_t>(level);
    const auto across = static_cast<std::uint32_t>(line), at = static_cast<std::uint32_t>(along);
    const PieceKey edge =
        root.vertical ? PieceKey{PieceKind::kEdgeV, l, across, at} : PieceKey{PieceKind::kEdgeH, l, at, across};
    edges.push_back(edge.canonical());
  });
  return edges;
}

std::vector<PieceKey> UpdateReach::corners_at(const TileKey& bottom_tile) const {
  std::vector<PieceKey> corners;
  const std::int64_t own = lattice_.tile_side(bottom_tile.level);
  for (const int corner : {0, 1, 2, 3}) {
    const std::int64_t x = own * (bottom_tile.x + (corner & 1)), y = own * (bottom_tile.y + (corner >> 1));
    for (int level = 0; level <= bottom_tile.level; ++level) {
      const std::int64_t side = lattice_.tile_side(level);
      if (x % side != 0 || y % side != 0) continue;
      const PieceKey key{PieceKind::kCorner, static_cast<std::uint8_t>(level), static_cast<std::uint32_t>(x / side),
                         static_cast<std::uint32_t>(y / side)};
      corners.push_back(key.canonical());
    }
  }
  return corners;
}

}  // namespace tind
