// SPDX-License-Identifier: GPL-3.0-or-later
// Borders between tiles of one level, from level to level, and the run codes that sum them up.
#include <fmt/format.h>

#include <algorithm>
#include <map>

#include "tests/client/checks.hpp"
#include "tests/client/parallel.hpp"

namespace tind::client {
namespace {

const char* border_name(int b) { return kBorderNames[static_cast<std::size_t>(b)]; }

std::string describe(const SideVertex& v) { return fmt::format("step {} height {} entry level {}", v.t, v.z, v.entry); }

/// The first place where two sides differ.
std::string first_difference(const std::vector<SideVertex>& a, const std::vector<SideVertex>& b) {
  for (std::size_t k = 0; k < std::min(a.size(), b.size()); ++k) {
    if (a[k] != b[k]) return fmt::format("vertex {}: {} against {}", k, describe(a[k]), describe(b[k]));
  }
  return fmt::format("{} vertices against {}", a.size(), b.size());
}

/// Entry levels of one corner on the two edges of a line that meet there.
void check_joint(Check& check, const Node& node, const Node& next, int b) {
  const auto here = stored_side(*node.tile, b), there = stored_side(*next.tile, b);
  if (here.back().entry != there.front().entry) {
    check.fail(
        fmt::format("{} borders of {} and {}: the corner between them has entry level {} on one, {} on the other",
                    border_name(b), node.id.text(), next.id.text(), here.back().entry, there.front().entry));
  }
}

/// A border line at one deeper level, as far as its edges are stored: vertices once each, and the covered ranges.
struct FinerLine {
  std::vector<SideVertex> vertices;
  std::vector<std::pair<std::int64_t, std::int64_t>> covered;

  bool covers(std::int64_t from, std::int64_t to) const {
    return std::any_of(covered.begin(), covered.end(),
                       [&](const auto& range) { return range.first <= from && to <= range.second; });
  }
  void append(const std::vector<SideVertex>& side, std::int64_t offset) {
    for (SideVertex v : side) {
      v.t += offset;
      if (vertices.empty() || v.t > vertices.back().t) vertices.push_back(v);
    }
    const std::int64_t from = side.front().t + offset, to = side.back().t + offset;
    if (!covered.empty() && covered.back().second == from) {
      covered.back().second = to;
    } else {
      covered.emplace_back(from, to);
    }
  }
};

/// Gathers border b of `from` at level + `gap` from the descendants on this side (`inner`) or beyond (`outer`); -1:
/// none.
void gather(const Pyramid& pyramid, const Node& from, int b, std::int32_t inner, std::int32_t outer, int gap,
            FinerLine& line) {
  static constexpr int kAlong[4][2] = {{0, 1}, {1, 3}, {2, 3}, {0, 2}};
  if (inner < 0 && outer < 0) return;
  if (gap == 0) {
    const bool own = inner >= 0 && pyramid.node(inner).tile != nullptr;
    const Node& node = pyramid.node(own ? inner : outer < 0 ? inner : outer);
    if (node.tile == nullptr) return;
    const LatticeFrame& frame = pyramid.frame();
    const std::int64_t offset = b == 1 || b == 3 ? frame.origin_y(node.id) - frame.origin_y(from.id)
                                                 : frame.origin_x(node.id) - frame.origin_x(from.id);
    line.append(stored_side(*node.tile, own || outer < 0 ? b : (b + 2) % 4), offset);
    return;
  }
  for (int half = 0; half < 2; ++half) {
    const auto child = [&](std::int32_t index, int border) {
      return index < 0 ? -1 : pyramid.node(index).children[static_cast<std::size_t>(kAlong[border][half])];
    };
    gather(pyramid, from, b, child(inner, b), child(outer, (b + 2) % 4), gap - 1, line);
  }
}

struct RunFinding {
  std::uint64_t compared = 0;
  std::vector<std::string> faults;
};

/// Runs of one tile against the finer lines on all four borders.
RunFinding compare_runs(const Pyramid& pyramid, std::int32_t index) {
  const Node& node = pyramid.node(index);
  const Tile& tile = *node.tile;
  const int level = node.id.level;
  RunFinding finding;
  std::array<std::vector<SideVertex>, 4> sides;
  for (int b = 0; b < 4; ++b) sides[static_cast<std::size_t>(b)] = ring_side(tile, b);
  for (int gap = 1; level + gap <= pyramid.bottom_level(); ++gap) {
    std::array<FinerLine, 4> lines;
    for (int b = 0; b < 4; ++b) {
      gather(pyramid, node, b, index, node.neighbours[static_cast<std::size_t>(b)], gap,
             lines[static_cast<std::size_t>(b)]);
    }
    const auto compare = [&](const VtRecord& vt, int edge, int b, std::uint32_t interval) {
      const auto border = static_cast<std::size_t>(b);
      const auto [from, to] = std::minmax(sides[border][interval].t, sides[border][interval + 1].t);
      const FinerLine& line = lines[border];
      if (!line.covers(from, to)) return;
      const auto first = std::upper_bound(line.vertices.begin(), line.vertices.end(), from,
                                          [](std::int64_t t, const SideVertex& v) { return t < v.t; });
      std::uint32_t inside = 0;
      for (auto v = first; v != line.vertices.end() && v->t < to; ++v) {
        inside += v->entry > level && v->entry <= level + gap ? 1 : 0;
      }
      ++finding.compared;
      if (gap > tile.n_gaps) {
        if (inside > 0) {
          finding.faults.push_back(
              fmt::format("tile {}: runs end at gap {}, but interval {} of the {} border has {} vertices at gap {}",
                          node.id.text(), tile.n_gaps, interval, border_name(b), inside, gap));
        }
        return;
      }
      const std::size_t at =
          vt.first_run + static_cast<std::size_t>(edge) * tile.n_gaps + static_cast<std::size_t>(gap) - 1;
      if (tile.runs[at] != inside) {
        finding.faults.push_back(fmt::format(
            "tile {}: r_{} of interval {} of the {} border is {}, the line at level {} has {} vertices there",
            node.id.text(), gap, interval, border_name(b), tile.runs[at], level + gap, inside));
      }
    };
    for (const VtRecord& vt : tile.vts) {
      if (vt.n_edges == 1) {
        compare(vt, 0, vt.border, vt.interval);
      } else {
        const int before = (vt.border + 3) % 4;
        compare(vt, 0, before, tile.n_side[static_cast<std::size_t>(before)]);
        compare(vt, 1, vt.border, 0);
      }
    }
  }
  return finding;
}

}  // namespace

void check_shared_borders(Run& run) {
  Check& edges = run.check("shared-edges");
  Check& corners = run.check("shared-corners");
  const Pyramid& pyramid = run.pyramid;
  const LatticeFrame& frame = pyramid.frame();
  struct CornerHeight {
    std::int32_t z;
    TileId from;
  };
  std::map<std::array<std::int64_t, 3>, CornerHeight> heights;
  for (const Node& node : pyramid.nodes()) {
    if (node.tile == nullptr) continue;
    const auto neighbour = [&](int b) -> const Node* {
      const std::int32_t index = node.neighbours[static_cast<std::size_t>(b)];
      return index < 0 || pyramid.node(index).tile == nullptr ? nullptr : &pyramid.node(index);
    };
    for (const int b : {0, 3}) {
      const Node* beyond = neighbour(b);
      if (beyond == nullptr) continue;
      edges.looked_at();
      const auto here = stored_side(*node.tile, b), there = stored_side(*beyond->tile, (b + 2) % 4);
      if (here != there) {
        edges.fail(fmt::format("{} border of {} is not the {} border of {}: {}", border_name(b), node.id.text(),
                               border_name((b + 2) % 4), beyond->id.text(), first_difference(here, there)));
      }
    }
    if (const Node* east = neighbour(1)) {
      for (const int b : {0, 2}) check_joint(edges, node, *east, b);
    }
    if (const Node* north = neighbour(2)) {
      for (const int b : {1, 3}) check_joint(edges, node, *north, b);
    }
    // One height per corner and level, and per pole; a corner keeps it at every deeper level.
    for (int c = 0; c < 4; ++c) {
      const std::int64_t s = frame.side(node.id.level);
      const std::int64_t x = (frame.origin_x(node.id) + (c == 1 || c == 2 ? s : 0)) % frame.width();
      const std::int64_t y = frame.origin_y(node.id) + (c >= 2 ? s : 0);
      const bool pole = y == 0 || y == frame.height();
      const std::int32_t z = node.tile->vertices[node.tile->corner_index(c)].z;
      const auto [known, is_new] = heights.try_emplace({0, pole ? 0 : x, y}, CornerHeight{z, node.id});
      corners.looked_at();
      if (!is_new && known->second.z != z) {
        corners.fail(fmt::format("corner C{} of {}{} has height {}, in {} it has {}", c, node.id.text(),
                                 pole ? " (a pole)" : "", z, known->second.from.text(), known->second.z));
      }
    }
    for (const int b : {0, 2}) {
      const bool pole = b == 0 ? node.id.y == 0 : node.id.y + 1 == TileId::count_y(node.id.level);
      if (!pole) continue;
      const auto side = stored_side(*node.tile, b);
      if (std::any_of(side.begin(), side.end(), [&](const SideVertex& v) { return v.z != side.front().z; })) {
        corners.fail(
            fmt::format("the pole has several heights along the {} border of {}", border_name(b), node.id.text()));
      }
    }
  }
}

void check_nested_borders(Run& run) {
  Check& check = run.check("nested-borders");
  const Pyramid& pyramid = run.pyramid;
  const LatticeFrame& frame = pyramid.frame();
  for (const Node& node : pyramid.nodes()) {
    if (node.tile == nullptr) continue;
    const int level = node.id.level;
    for (int b = 0; b < 4; ++b) {
      check.looked_at();
      const auto side = stored_side(*node.tile, b);
      const int first = first_level_of_line(node.id, b);
      for (const SideVertex& v : side) {
        if (v.entry >= first && v.entry <= level) continue;
        check.fail(fmt::format("{} border of {}: {} is outside the line's levels {}..{}", border_name(b),
                               node.id.text(), describe(v), first, level));
        break;
      }
      if (!node.splittable()) continue;
      static constexpr int kAlong[4][2] = {{0, 1}, {1, 3}, {2, 3}, {0, 2}};
      std::vector<SideVertex> known;
      bool entered_between = true;
      for (const int c : kAlong[b]) {
        const Node& child = pyramid.node(node.children[static_cast<std::size_t>(c)]);
        const std::int64_t offset = b == 1 || b == 3 ? frame.origin_y(child.id) - frame.origin_y(node.id)
                                                     : frame.origin_x(child.id) - frame.origin_x(node.id);
        for (SideVertex v : stored_side(*child.tile, b)) {
          v.t += offset;
          entered_between = entered_between && v.entry <= level + 1;
          if (v.entry <= level && (known.empty() || known.back() != v)) known.push_back(v);
        }
      }
      if (known != side) {
        check.fail(fmt::format("{} border of {} is not what its children keep of it: {}", border_name(b),
                               node.id.text(), first_difference(side, known)));
      }
      if (!entered_between) {
        check.fail(fmt::format("{} border of {}: a child's vertex entered below level {}", border_name(b),
                               node.id.text(), level + 1));
      }
    }
  }
}

void check_runs(Run& run) {
  Check& check = run.check("runs");
  const Pyramid& pyramid = run.pyramid;
  for_each_parallel(pyramid.nodes().size(), run.options.threads, [&](std::size_t k) {
    if (pyramid.nodes()[k].tile == nullptr) return;
    const RunFinding finding = compare_runs(pyramid, static_cast<std::int32_t>(k));
    check.looked_at(finding.compared);
    for (const auto& fault : finding.faults) check.fail(fault);
  });
  if (pyramid.bottom_level() == 0) check.skip("there is one level only");
}

}  // namespace tind::client
