// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/shard.hpp"

#include <limits>

namespace tind {
namespace {

constexpr std::size_t kCutTilesPerShard = 4;

}  // namespace

ShardTiles::ShardTiles(const TilePlan& plan, int index, int count) {
  const auto n_shards = static_cast<std::size_t>(count);
  while (cut_level_ < plan.bottom_level() && plan.tiles(cut_level_).size() < kCutTilesPerShard * n_shards) ++cut_level_;
  const std::vector<TileKey>& cut = plan.tiles(cut_level_);
  // How many bottom tiles lie below each, itself counted once: both lists are in Morton order.
  const std::vector<TileKey>& bottom = plan.tiles(plan.bottom_level());
  const int shift = 2 * (plan.bottom_level() - cut_level_);
  std::vector<std::uint64_t> weight_before(cut.size() + 1, 0);
  std::size_t next = 0;
  for (std::size_t k = 0; k < cut.size(); ++k) {
    const std::uint64_t code = morton_code(cut[k].x, cut[k].y);
    std::uint64_t weight = 1;
    for (; next < bottom.size() && morton_code(bottom[next].x, bottom[next].y) >> shift <= code; ++next) ++weight;
    weight_before[k + 1] = weight_before[k] + weight;
  }
  // A tile belongs to the shard that its middle weight falls into.
  const auto shard_of = [&](std::size_t k) {
    const std::uint64_t middle = (weight_before[k] + weight_before[k + 1]) / 2;
    return static_cast<std::size_t>(middle * n_shards / weight_before.back());
  };
  const auto own = static_cast<std::size_t>(index);
  bool found = false;
  for (std::size_t k = 0; k < cut.size(); ++k) {
    if (shard_of(k) != own) continue;
    const std::uint64_t code = morton_code(cut[k].x, cut[k].y);
    if (!found) first_ = code;
    end_ = code + 1;
    found = true;
  }
}

bool ShardTiles::has(const TileKey& key) const {
  if (key.level < cut_level_) return true;
  const std::uint64_t code = morton_code(key.x, key.y) >> (2 * (key.level - cut_level_));
  return code >= first_ && code < end_;
}

std::vector<TileKey> ShardTiles::filter(const std::vector<TileKey>& tiles) const {
  std::vector<TileKey> own;
  for (const TileKey& tile : tiles) {
    if (has(tile)) own.push_back(tile);
  }
  return own;
}

}  // namespace tind
