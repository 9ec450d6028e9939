// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/plan.hpp"

#include <algorithm>
#include <cmath>
#include <map>

namespace tind {
namespace {

bool morton_order(const TileKey& a, const TileKey& b) { return morton_code(a.x, a.y) < morton_code(b.x, b.y); }

// Columns of tiles in one row of them: ranges that grow together when there are many.
class TileRanges {
 public:
  using Range = std::pair<std::int64_t, std::int64_t>;  // first and last, unwrapped

  void add(const Range& range) {
    if (!ranges_.empty() && ranges_.back() == range) return;
    ranges_.push_back(range);
    if (ranges_.size() >= limit_) {
      merge();
      limit_ = std::max(kLeast, 2 * ranges_.size());
    }
  }
  // Ascending and apart.
  const std::vector<Range>& merged() {
    merge();
    return ranges_;
  }

 private:
  static constexpr std::size_t kLeast = 64;

  void merge() {
    std::sort(ranges_.begin(), ranges_.end());
    std::size_t n = 0;
    for (const Range& range : ranges_) {
      if (n > 0 && range.first <= ranges_[n - 1].second + 1) {
        ranges_[n - 1].second = std::max(ranges_[n - 1].second, range.second);
      } else {
        ranges_[n++] = range;
      }
    }
    ranges_.resize(n);
  }

  std::vector<Range> ranges_;
  std::size_t limit_ = kLeast;
};

// Bottom tiles that a post other than the base touches: the tile of the post and those that its four cells reach into.
std::vector<TileKey> touched_tiles(const HeightField& field, int level) {
  const double side = static_cast<double>(field.lattice.tile_side(level));
  const std::int64_t n_x = TileKey::count_x(level), n_y = TileKey::count_y(level);
  const auto tile_at = [side](double v) { return static_cast<std::int64_t>(std::floor(v / side)); };
  std::map<std::int64_t, TileRanges> by_row;
  // Posts [row, row + n_rows) x [col, col + n_cols), none of them base.
  const auto touch = [&](const PostBlocks::Extent& e) {
    const auto y_first = std::max<std::int64_t>(0, tile_at(field.post_y(e.row) - field.dy));
    const auto y_last = std::min<std::int64_t>(n_y - 1, tile_at(field.post_y(e.row + e.n_rows - 1) + field.dy));
    const TileRanges::Range range = {tile_at(field.post_x(e.col) - field.dx),
                                     tile_at(field.post_x(e.col + e.n_cols - 1) + field.dx)};
    for (std::int64_t y = y_first; y <= y_last; ++y) by_row[y].add(range);
  };
  field.visit_posts(
      {0, 0, field.n_rows, field.n_cols},
      [&](int blocks_level, std::int64_t i, std::int64_t j, bool) {
        const PostSummary block = field.blocks->summary(blocks_level, i, j);
        if (block.is_all(PostOrigin::kBase)) return true;
        if (block.has(PostOrigin::kBase)) return false;
        touch(field.blocks->extent(blocks_level, i, j));
        return true;
      },
      [&](std::int64_t r, std::int64_t begin, std::int64_t end) {
        for (std::int64_t c = begin; c < end; ++c) {
          if (field.origin_at(r, c) == PostOrigin::kBase) continue;
          const std::int64_t first = c;
          while (c + 1 < end && field.origin_at(r, c + 1) != PostOrigin::kBase) ++c;
          touch({r, first, 1, c - first + 1});
        }
      });
  std::vector<TileKey> tiles;
  for (auto& [y, ranges] : by_row) {
    for (const auto& [first, last] : ranges.merged()) {
      for (std::int64_t x = first; x <= last; ++x) {
        tiles.push_back({static_cast<std::uint8_t>(level), static_cast<std::uint32_t>(((x % n_x) + n_x) % n_x),
                         static_cast<std::uint32_t>(y)});
      }
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
