// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/border_lines.hpp"

#include <algorithm>

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
