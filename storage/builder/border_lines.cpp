// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/border_lines.hpp"

namespace tind {

void BorderLines::add(const RootEdge& root, std::vector<LineVertex> vertices) {
  const std::int64_t side = lattice_.tile_side(root.level);
  lines_.emplace(Key{root.vertical, root.level, root.at / side, root.start / side}, std::move(vertices));
}

std::span<const LineVertex> BorderLines::side(bool vertical, int level, std::int64_t line, std::int64_t along) const {
  if (vertical) line %= TileKey::count_x(level);  // longitude +180 is -180
  const std::int64_t length = lattice_.tile_side(level);
  int root_level = level;
  while (root_level > 0 && line % 2 == 0) {
    line /= 2;
    --root_level;
  }
  const auto& vertices = lines_.at(Key{vertical, root_level, line, along >> (level - root_level)});
  return line_between(vertices, along * length, (along + 1) * length);
}

std::span<const LineVertex> BorderLines::border(const TileKey& tile, int b) const {
  switch (b) {
    case 0:
      return side(false, tile.level, tile.y, tile.x);
    case 1:
      return side(true, tile.level, std::int64_t{tile.x} + 1, tile.y);
    case 2:
      return side(false, tile.level, std::int64_t{tile.y} + 1, tile.x);
    default:
      return side(true, tile.level, tile.x, tile.y);
  }
}

}  // namespace tind
