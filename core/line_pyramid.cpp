// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/line_pyramid.hpp"

#include <algorithm>
#include <tuple>
#include <utility>

#include "core/line_pyramid_builder.hpp"

namespace tind {

LinePyramid::LinePyramid(const Lattice& lattice, std::vector<BreakChain> chains, std::span<const LineDetail> detail)
    : LinePyramid(lattice, std::move(chains), detail, {}, {}) {}

LinePyramid::LinePyramid(const Lattice& lattice, std::vector<BreakChain> chains, std::span<const LineDetail> detail,
                         const ScratchAllocator& kept, const ScratchAllocator& working) {
  LinePyramidBuilder(*this, lattice, detail, kept, working).build(std::move(chains));
}

std::span<const LineCrossing> LinePyramid::crossings(bool vertical, std::int64_t at, std::int64_t start,
                                                     std::int64_t end) const {
  const auto before = [](const LineCrossing& c, const std::tuple<bool, std::int64_t, std::int64_t>& key) {
    return std::tie(c.vertical, c.at, c.t) < key;
  };
  const std::span<const LineCrossing> all = crossings_.values();
  const auto first = std::lower_bound(all.begin(), all.end(), std::tuple(vertical, at, start + 1), before);
  const auto last = std::lower_bound(first, all.end(), std::tuple(vertical, at, end), before);
  return {first, last};
}

std::vector<LineSegment> LinePyramid::segments(const TileKey& tile) const {
  std::vector<LineSegment> found;
  if (empty()) return found;
  const Level& level = levels_[tile.level];
  const std::uint64_t code = morton_code(tile.x, tile.y);
  const std::span<const Piece> pieces = level.pieces.values();
  const auto first =
      std::lower_bound(pieces.begin(), pieces.end(), code, [](const Piece& p, std::uint64_t c) { return p.tile < c; });
  const std::int64_t west = side_[tile.level] * tile.x;
  for (auto piece = first; piece != pieces.end() && piece->tile == code; ++piece) {
    LineSegment s{vertices_[piece->a], vertices_[piece->b]};
    if (s.a.x < west) s.a.x += width_;  // longitude +180
    if (s.b.x < west) s.b.x += width_;
    found.push_back(s);
  }
  return found;
}

std::vector<DrawnLine> LinePyramid::drawn(int level) const {
  std::vector<DrawnLine> lines;
  if (empty()) return lines;
  const Level& in = levels_[static_cast<std::size_t>(level)];
  for (std::size_t l = 0; l + 1 < in.line_first.size(); ++l) {
    DrawnLine line{{}, in.line_chain[l]};
    for (std::uint64_t k = in.line_first[l]; k < in.line_first[l + 1]; ++k) {
      line.vertices.push_back(vertices_[in.line_vertices[k]]);
    }
    lines.push_back(std::move(line));
  }
  return lines;
}

}  // namespace tind
