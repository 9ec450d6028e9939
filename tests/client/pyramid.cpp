// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/pyramid.hpp"

#include <algorithm>
#include <cmath>
#include <random>
#include <unordered_set>

namespace tind::client {
namespace {

struct Stored {
  TileId id;
  int coverage = 0;
};

/// Random tiles with all that the sibling-complete closure needs.
void keep_sample(std::vector<Stored>& tiles, double fraction, std::uint64_t seed) {
  const auto wanted = static_cast<std::size_t>(std::ceil(fraction * static_cast<double>(tiles.size())));
  std::vector<std::size_t> order(tiles.size());
  for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
  std::mt19937_64 random(seed);
  for (std::size_t k = order.size(); k > 1; --k) std::swap(order[k - 1], order[random() % k]);
  std::unordered_set<std::uint64_t> kept = {TileId{0, 0, 0}.number(), TileId{0, 1, 0}.number()};
  for (const std::size_t k : order) {
    if (kept.size() >= wanted) break;
    for (TileId id = tiles[k].id; id.level > 0; id = id.parent()) {
      for (int c = 0; c < 4; ++c) kept.insert(id.parent().child(c).number());
    }
  }
  std::erase_if(tiles, [&](const Stored& t) { return !kept.contains(t.id.number()); });
}

}  // namespace

Pyramid::Pyramid(const ManifestView& manifest, double fraction, std::uint64_t seed)
    : frame_(manifest.frame), bottom_level_(manifest.bottom_level), is_sample_(fraction < 1) {
  std::vector<Stored> tiles;
  for (const auto& level : manifest.levels) {
    for (const auto& run : level.rows) {
      for (std::uint32_t x = run.x_first; x <= run.x_last; ++x) {
        tiles.push_back({{level.level, x, run.y}, run.coverage});
      }
    }
  }
  std::sort(tiles.begin(), tiles.end(), [](const Stored& a, const Stored& b) {
    if (a.id.level != b.id.level) return a.id.level < b.id.level;
    return before_in_morton_order(a.id.x, a.id.y, b.id.x, b.id.y);
  });
  tiles.erase(std::unique(tiles.begin(), tiles.end(), [](const Stored& a, const Stored& b) { return a.id == b.id; }),
              tiles.end());
  if (is_sample_) keep_sample(tiles, fraction, seed);

  nodes_.resize(tiles.size());
  for (std::size_t k = 0; k < tiles.size(); ++k) {
    nodes_[k].id = tiles[k].id;
    nodes_[k].coverage = tiles[k].coverage;
    index_[tiles[k].id.number()] = static_cast<std::int32_t>(k);
  }
  for (auto& n : nodes_) {
    const TileId id = n.id;
    if (id.level > 0) n.parent = find(id.parent());
    if (id.level < kDeepestLevel) {
      std::array<std::int32_t, 4> children{};
      for (int c = 0; c < 4; ++c) children[static_cast<std::size_t>(c)] = find(id.child(c));
      if (std::none_of(children.begin(), children.end(), [](std::int32_t c) { return c < 0; })) n.children = children;
    }
    const std::uint32_t count_x = TileId::count_x(id.level);
    if (id.y > 0) n.neighbours[0] = find({id.level, id.x, id.y - 1});
    n.neighbours[1] = find({id.level, (id.x + 1) % count_x, id.y});
    if (id.y + 1 < TileId::count_y(id.level)) n.neighbours[2] = find({id.level, id.x, id.y + 1});
    n.neighbours[3] = find({id.level, (id.x + count_x - 1) % count_x, id.y});
  }
}

std::int32_t Pyramid::find(const TileId& id) const {
  const auto it = index_.find(id.number());
  return it == index_.end() ? -1 : it->second;
}

void Pyramid::unlink_unread() {
  for (auto& n : nodes_) {
    if (!n.splittable()) continue;
    const bool unread =
        std::any_of(n.children.begin(), n.children.end(), [&](std::int32_t c) { return node(c).tile == nullptr; });
    if (unread) n.children.fill(-1);
  }
}

}  // namespace tind::client
