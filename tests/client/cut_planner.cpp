// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/cut_planner.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <random>

namespace tind::client {
namespace {

using Random = std::mt19937_64;

std::int32_t pick(Random& random, const std::vector<std::int32_t>& from) { return from[random() % from.size()]; }

/// Uniform in [0, 1), the same on every machine.
double unit(Random& random) { return static_cast<double>(random() >> 11) * 0x1p-53; }

/// Divides all ancestors of a node.
void reach(const Pyramid& pyramid, std::int32_t index, std::vector<std::uint8_t>& split) {
  for (std::int32_t k = pyramid.node(index).parent; k >= 0; k = pyramid.node(k).parent)
    split[static_cast<std::size_t>(k)] = 1;
}

/// Divides everything below a node.
void divide_all(const Pyramid& pyramid, std::int32_t index, std::vector<std::uint8_t>& split) {
  const Node& node = pyramid.node(index);
  if (!node.splittable()) return;
  split[static_cast<std::size_t>(index)] = 1;
  for (const std::int32_t child : node.children) divide_all(pyramid, child, split);
}

/// Deepest nodes whose border lies on the line that is the oldest: alone there, their neighbour is as coarse as can be.
std::vector<std::int32_t> most_exposed(const Pyramid& pyramid) {
  std::vector<std::int32_t> exposed;
  int widest = -1;
  for (std::size_t k = 0; k < pyramid.nodes().size(); ++k) {
    const Node& node = pyramid.nodes()[k];
    int gap = 0;
    for (int b = 0; b < 4; ++b) {
      // No neighbour stands beyond a pole.
      const bool pole = (b == 0 && node.id.y == 0) || (b == 2 && node.id.y + 1 == TileId::count_y(node.id.level));
      if (!pole) gap = std::max(gap, node.id.level - first_level_of_line(node.id, b));
    }
    if (gap < widest) continue;
    if (gap > widest) exposed.clear();
    widest = gap;
    exposed.push_back(static_cast<std::int32_t>(k));
  }
  return exposed;
}

/// Nodes that can be divided.
std::vector<std::int32_t> splittable_nodes(const Pyramid& pyramid) {
  std::vector<std::int32_t> nodes;
  for (std::size_t k = 0; k < pyramid.nodes().size(); ++k) {
    if (pyramid.nodes()[k].splittable()) nodes.push_back(static_cast<std::int32_t>(k));
  }
  return nodes;
}

void divide_at_random(const Pyramid& pyramid, Random& random, const std::vector<std::int32_t>& splittable,
                      std::vector<std::uint8_t>& split) {
  static constexpr double kChances[] = {0.35, 0.6, 0.75, 0.85, 0.93, 0.98};
  const double chance_data = kChances[random() % 6];
  const double chance_filler = chance_data * unit(random);
  // Coarse islands stay undivided whatever is around them, deep ones are divided to the bottom.
  std::vector<std::uint8_t> stays(pyramid.nodes().size(), 0);
  for (std::uint64_t n = random() % 6; n > 0; --n) stays[static_cast<std::size_t>(pick(random, splittable))] = 1;
  for (std::uint64_t n = random() % 4; n > 0; --n) {
    const std::int32_t deep = pick(random, splittable);
    reach(pyramid, deep, split);
    divide_all(pyramid, deep, split);
  }
  for (std::uint64_t n = 1 + random() % 8; n > 0; --n) {
    reach(pyramid, static_cast<std::int32_t>(pyramid.nodes().size() - 1 - random() % pyramid.nodes().size()), split);
  }
  for (std::size_t k = 0; k < split.size(); ++k) {
    const Node& node = pyramid.nodes()[k];
    if (!node.splittable()) continue;
    if (unit(random) < (node.coverage > 0 ? chance_data : chance_filler)) split[k] = 1;
    if (stays[k] != 0 && node.id.level > 0) split[k] = 0;
  }
}

}  // namespace

Cut plan_cut(const Pyramid& pyramid, std::uint64_t seed, int index) {
  Cut cut;
  cut.split.assign(pyramid.nodes().size(), 0);
  Random random(seed * 0x9e3779b97f4a7c15ull + static_cast<std::uint64_t>(index));
  const auto splittable = splittable_nodes(pyramid);
  if (splittable.empty() || index == 1) {
    cut.kind = "nothing divided";
  } else if (index == 0) {
    cut.kind = "everything divided";
    for (const std::int32_t root : {pyramid.find({0, 0, 0}), pyramid.find({0, 1, 0})})
      divide_all(pyramid, root, cut.split);
  } else if (index < 6) {
    const std::int32_t alone = pick(random, most_exposed(pyramid));
    cut.kind = fmt::format("{} alone", pyramid.node(alone).id.text());
    reach(pyramid, alone, cut.split);
  } else if (index < 12) {
    // All that is below one node of a middling level, nothing beside it.
    std::int32_t top = pick(random, splittable);
    for (auto up = random() % 4; up > 0 && pyramid.node(top).parent >= 0; --up) top = pyramid.node(top).parent;
    cut.kind = fmt::format("only {} divided, to the bottom", pyramid.node(top).id.text());
    reach(pyramid, top, cut.split);
    divide_all(pyramid, top, cut.split);
  } else {
    cut.kind = "random";
    divide_at_random(pyramid, random, splittable, cut.split);
  }
  // Keep only divisions that are reached, and list the leaves.
  for (std::size_t k = 0; k < cut.split.size(); ++k) {
    const std::int32_t parent = pyramid.nodes()[k].parent;
    const bool reached =
        parent < 0 ? pyramid.nodes()[k].id.level == 0 : cut.split[static_cast<std::size_t>(parent)] != 0;
    if (!reached || !pyramid.nodes()[k].splittable()) {
      if (reached) cut.leaves.push_back(static_cast<std::int32_t>(k));
      cut.split[k] = 0;
    } else if (cut.split[k] == 0) {
      cut.leaves.push_back(static_cast<std::int32_t>(k));
    }
  }
  return cut;
}

}  // namespace tind::client
