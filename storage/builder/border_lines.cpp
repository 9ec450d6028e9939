// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/border_lines.hpp"

#include <algorithm>

namespace tind {

RootEdge root_of(const Lattice& lattice, bool vertical, int level, std::int64_t line, std::int64_t along) {
  if (vertical) line %= TileKey::count_x(level);  // longitude +180 is -180
  int root_level = level;
  while (root_level > 0 && line % 2 == 0) {
    line /= 2;
    --root_level;
  }
  const std::int64_t side = lattice.tile_side(root_level);
  return {vertical, root_level, line * side, (along >> (level - root_level)) * side};
}

TileKey parent_of(const Lattice& lattice, const RootEdge& root) {
  const std::int64_t side = lattice.tile_side(root.level - 1);
  const std::int64_t x = root.vertical ? root.at : root.start, y = root.vertical ? root.start : root.at;
  return {static_cast<std::uint8_t>(root.level - 1), static_cast<std::uint32_t>(x / side),
          static_cast<std::uint32_t>(y / side)};
}

void BorderLines::add(const RootEdge& root, std::vector<LineVertex> vertices) {
  lines_.insert_or_assign(key_of(root), std::move(vertices));
}

std::span<const LineVertex> BorderLines::side(bool vertical, int level, std::int64_t line, std::int64_t along) const {
  const std::int64_t length = lattice_.tile_side(level);
  const auto& vertices = lines_.at(key_of(root_of(lattice_, vertical, level, line, along)));
  return line_between(vertices, along * length, (along + 1) * length);
}

std::array<RootEdge, 4> BorderLines::roots_of(const Lattice& lattice, const TileKey& tile) {
  return {root_of(lattice, false, tile.level, tile.y, tile.x),
          root_of(lattice, true, tile.level, std::int64_t{tile.x} + 1, tile.y),
          root_of(lattice, false, tile.level, std::int64_t{tile.y} + 1, tile.x),
          root_of(lattice, true, tile.level, tile.x, tile.y)};
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

void set_border(const Lattice& lattice, std::span<const LineVertex> part, int b, TileTask& task) {
  const std::int64_t side = lattice.tile_side(task.key.level), origin = part.front().t;
  auto& border = task.borders[static_cast<std::size_t>(b)];
  for (const LineVertex& v : part) {
    if (v.entry > task.key.level) continue;
    const std::int64_t t = v.t - origin;
    border.push_back(b == 0   ? LocalVertex{t, 0, v.z}
                     : b == 1 ? LocalVertex{side, t, v.z}
                     : b == 2 ? LocalVertex{t, side, v.z}
                              : LocalVertex{0, t, v.z});
  }
  if (b >= 2) std::reverse(border.begin(), border.end());
  border.pop_back();  // the next corner belongs to the next border
  auto& envelope = task.envelopes[static_cast<std::size_t>(b)];
  envelope = envelope_of(part, task.key.level, lattice);
  for (EnvelopeKnot& knot : envelope) knot.t -= static_cast<double>(origin);
}

}  // namespace tind
