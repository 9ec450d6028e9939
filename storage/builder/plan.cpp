// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/plan.hpp"

#include <algorithm>
#include <cmath>
#include <map>

namespace tind {
namespace {

bool morton_order(const TileKey& a, const TileKey& b) { return morton_code(a.x, a.y) < morton_code(b.x, b.y); }

// Bottom tiles that a post other than the base touches: the tile of the post and those that its four cells reach into.
std::vector<TileKey> touched_tiles(const HeightField& field, int level) {
  const double side = static_cast<double>(field.lattice.tile_side(level));
  const std::int64_t n_x = TileKey::count_x(level), n_y = TileKey::count_y(level);
  // Per tile row: ranges of touched columns, unwrapped. Neighbouring post rows repeat each other, so few are kept.
  std::map<std::int64_t, std::vector<std::pair<std::int64_t, std::int64_t>>> ranges;
  for (std::int64_t r = 0; r < field.n_rows; ++r) {
    const auto y_first = std::max<std::int64_t>(0, std::llround(std::floor((field.post_y(r) - field.dy) / side)));
    const auto y_last = std::min<std::int64_t>(n_y - 1, std::llround(std::floor((field.post_y(r) + field.dy) / side)));
    const PostOrigin* row = field.origins + r * field.n_cols;
    for (std::int64_t c = 0; c < field.n_cols; ++c) {
      if (row[c] == PostOrigin::kBase) continue;
      const std::int64_t c_first = c;
      while (c + 1 < field.n_cols && row[c + 1] != PostOrigin::kBase) ++c;
      const std::pair<std::int64_t, std::int64_t> range = {
          std::llround(std::floor((field.post_x(c_first) - field.dx) / side)),
          std::llround(std::floor((field.post_x(c) + field.dx) / side))};
      for (std::int64_t y = y_first; y <= y_last; ++y) {
        auto& list = ranges[y];
        if (std::find(list.rbegin(), list.rend(), range) == list.rend()) list.push_back(range);
      }
    }
  }
  std::vector<TileKey> tiles;
  for (auto& [y, list] : ranges) {
    std::sort(list.begin(), list.end());
    std::int64_t next = list.front().first;
    for (const auto& [first, last] : list) {
      for (std::int64_t x = std::max(first, next); x <= last; ++x) {
        tiles.push_back({static_cast<std::uint8_t>(level), static_cast<std::uint32_t>(((x % n_x) + n_x) % n_x),
                         static_cast<std::uint32_t>(y)});
      }
      next = std::max(next, last + 1);
    }
  }
  std::sort(tiles.begin(), tiles.end(), morton_order);
  tiles.erase(std::unique(tiles.begin(), tiles.end()), tiles.end());
  return tiles;
}

}  // namespace

TilePlan::TilePlan(const HeightField& field, int bottom_level) {
  stored_.resize(static_cast<std::size_t>(bottom_level) + 1);
  split_.resize(stored_.size());
  std::vector<TileKey> touched = touched_tiles(field, bottom_level);
  for (int level = bottom_level; level > 0; --level) {
    std::vector<TileKey> parents;
    for (const TileKey& key : touched) {
      if (parents.empty() || parents.back() != key.parent()) parents.push_back(key.parent());
    }
    auto& stored = stored_[static_cast<std::size_t>(level)];
    for (const TileKey& parent : parents) {
      for (int c = 0; c < 4; ++c) stored.push_back(parent.child(c));
    }
    split_[static_cast<std::size_t>(level) - 1] = parents;
    touched = std::move(parents);
  }
  for (std::uint32_t x = 0; x < TileKey::count_x(0); ++x) stored_[0].push_back({0, x, 0});
}

bool TilePlan::is_split(const TileKey& key) const {
  const auto& list = split_[key.level];
  return std::binary_search(list.begin(), list.end(), key, morton_order);
}

bool TilePlan::is_edge_split(int level, bool vertical, std::int64_t line, std::int64_t along) const {
  const std::int64_t n_x = TileKey::count_x(level), n_y = TileKey::count_y(level);
  const auto split_at = [&](std::int64_t x, std::int64_t y) {
    if (y < 0 || y >= n_y) return false;
    return is_split(
        {static_cast<std::uint8_t>(level), static_cast<std::uint32_t>((x + n_x) % n_x), static_cast<std::uint32_t>(y)});
  };
  return vertical ? split_at(line - 1, along) || split_at(line, along)
                  : split_at(along, line - 1) || split_at(along, line);
}

std::vector<PieceKey> TilePlan::pieces(int level) const {
  std::vector<PieceKey> keys;
  for (const TileKey& tile : tiles(level)) {
    for (const PieceKey& key : pieces_of(tile)) keys.push_back(key);
  }
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  return keys;
}

std::vector<RootEdge> TilePlan::root_edges(int level, const Lattice& lattice) const {
  const std::int64_t side = lattice.tile_side(level);
  std::vector<RootEdge> roots;
  if (level == 0) {
    for (std::int64_t x = 0; x < TileKey::count_x(0); ++x) {
      roots.push_back({true, 0, x * side, 0});
      roots.push_back({false, 0, 0, x * side});
      roots.push_back({false, 0, lattice.height(), x * side});
    }
    return roots;
  }
  // Lines that begin at this level are the middle lines of the split tiles one level up.
  for (const TileKey& parent : split_tiles(level - 1)) {
    const std::int64_t west = 2 * side * parent.x, south = 2 * side * parent.y;
    for (const std::int64_t half : {std::int64_t{0}, side}) {
      roots.push_back({true, level, west + side, south + half});
      roots.push_back({false, level, south + side, west + half});
    }
  }
  return roots;
}

}  // namespace tind
