// SPDX-License-Identifier: GPL-3.0-or-later
// What a level of a line pyramid keeps.
#include <algorithm>
#include <limits>
#include <numeric>
#include <unordered_map>
#include <utility>

#include "core/line_pyramid_builder.hpp"
#include "core/tile_key.hpp"

namespace tind {

void LinePyramidBuilder::store(int level, std::vector<Segment> segments) {
  std::sort(segments.begin(), segments.end(), [](const Segment& a, const Segment& b) { return a.from < b.from; });
  LinePyramid::Level& out = out_.levels_[static_cast<std::size_t>(level)];
  store_lines(out, segments);
  store_pieces(level, out, segments);
}

// The polylines: a line in one or, where segments were dropped, in several.
void LinePyramidBuilder::store_lines(LinePyramid::Level& out, const std::vector<Segment>& segments) const {
  // Calls begin(segment) where a polyline begins and go_on(segment) for each of its segments.
  const auto for_polylines = [&](auto&& begin, auto&& go_on) {
    const Segment* before = nullptr;
    for (const Segment& s : segments) {
      if (s.dropped()) continue;
      if (before == nullptr || before->to != s.from) begin(s);
      go_on(s);
      before = &s;
    }
  };
  std::size_t n_lines = 0, n_drawn = 0;
  for_polylines([&](const Segment&) { ++n_lines; }, [&](const Segment&) { ++n_drawn; });
  out.n_dropped = segments.size() - n_drawn;
  out.line_vertices = ScratchArray<Id>(n_lines + n_drawn, kept_);
  out.line_first = ScratchArray<std::uint64_t>(n_lines + 1, kept_);
  out.line_chain = ScratchArray<std::uint32_t>(n_lines, kept_);
  std::size_t at_line = 0, at = 0;
  for_polylines(
      [&](const Segment& s) {
        out.line_chain[at_line] = chains_[lines_[line_of(s.from)].chain].given;
        out.line_first[at_line++] = at;
        out.line_vertices[at++] = id(s.from);
      },
      [&](const Segment& s) { out.line_vertices[at++] = id(s.to); });
  out.line_first[at_line] = at;
}

// By tile, of each the heaviest lines first, as they lie along them.
void LinePyramidBuilder::store_pieces(int level, LinePyramid::Level& out, const std::vector<Segment>& segments) const {
  constexpr std::uint32_t kNoTile = std::numeric_limits<std::uint32_t>::max();
  const std::int64_t side = out_.side_[static_cast<std::size_t>(level)];
  struct OfTile {
    std::uint64_t code = 0;
    std::uint64_t n = 0;  // pieces; then the place of the next one
  };
  std::vector<OfTile> tiles;
  std::unordered_map<std::uint64_t, std::uint32_t> tile_of_code;
  std::vector<std::uint32_t> tile_of(segments.size(), kNoTile);
  std::size_t n_pieces = 0;
  for (std::size_t k = 0; k < segments.size(); ++k) {
    if (segments[k].dropped()) continue;
    const Id a = id(segments[k].from), b = id(segments[k].to);
    if (on_one_border(a, b, level)) continue;  // the border line itself is drawn there
    std::int64_t x2 = point(a).x + unwrapped_x(a, b);
    if (x2 < 0) x2 += 2 * out_.width_;
    const auto x = static_cast<std::uint32_t>(x2 / (2 * side)) % TileKey::count_x(level);
    const auto y = static_cast<std::uint32_t>((point(a).y + point(b).y) / (2 * side));
    const std::uint64_t code = morton_code(x, y);
    const auto [found, is_new] = tile_of_code.try_emplace(code, static_cast<std::uint32_t>(tiles.size()));
    if (is_new) tiles.push_back({code, 0});
    tile_of[k] = found->second;
    ++tiles[found->second].n;
    ++n_pieces;
  }
  std::vector<std::uint32_t> in_order(tiles.size());
  std::iota(in_order.begin(), in_order.end(), 0u);
  std::sort(in_order.begin(), in_order.end(),
            [&](std::uint32_t a, std::uint32_t b) { return tiles[a].code < tiles[b].code; });
  std::uint64_t begin = 0;
  for (const std::uint32_t t : in_order) begin += std::exchange(tiles[t].n, begin);

  std::vector<std::uint32_t> heaviest_first(lines_.size());
  std::iota(heaviest_first.begin(), heaviest_first.end(), 0u);
  std::stable_sort(heaviest_first.begin(), heaviest_first.end(),
                   [&](std::uint32_t a, std::uint32_t b) { return weight(lines_[a]) > weight(lines_[b]); });
  out.pieces = ScratchArray<LinePyramid::Piece>(n_pieces, kept_);
  for (const std::uint32_t l : heaviest_first) {
    auto s = std::lower_bound(segments.begin(), segments.end(), lines_[l].first,
                              [](const Segment& segment, Place at) { return segment.from < at; });
    for (; s != segments.end() && s->from < line_end(l); ++s) {
      const std::uint32_t tile = tile_of[static_cast<std::size_t>(s - segments.begin())];
      if (tile == kNoTile) continue;
      out.pieces[tiles[tile].n++] = {tiles[tile].code, id(s->from), id(s->to)};
    }
  }
}

}  // namespace tind
