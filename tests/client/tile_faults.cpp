// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/tile_faults.hpp"

#include <fmt/format.h>

#include <algorithm>

namespace tind::client {
namespace {

/// A damaged tile may break a rule everywhere: a few lines tell enough.
constexpr std::size_t kEnough = 3;

std::string vertex_text(const Tile& tile, std::uint32_t k) {
  const Vertex& v = tile.vertices[k];
  return fmt::format("vertex {} at ({}, {}) height {}", k, v.x, v.y, v.z);
}

/// Names where a ring position lies.
std::string ring_text(const Tile& tile, std::uint32_t position) {
  for (int b = 3; b >= 0; --b) {
    if (position >= tile.corner_index(b)) {
      return fmt::format("interval {} of the {} border", position - tile.corner_index(b),
                         kBorderNames[static_cast<std::size_t>(b)]);
    }
  }
  return "the ring";
}

/// Undirected edge and, in the lowest bit, its direction.
std::uint64_t edge_code(std::uint32_t from, std::uint32_t to) {
  const std::uint64_t low = std::min(from, to), high = std::max(from, to);
  return (low << 33) | (high << 1) | (from > to ? 1u : 0u);
}

}  // namespace

std::vector<std::string> find_outline_faults(const Tile& tile, const LatticeFrame& frame) {
  std::vector<std::string> faults;
  const std::int64_t s = frame.side(tile.id.level);
  const std::int64_t corner[4][2] = {{0, 0}, {s, 0}, {s, s}, {0, s}};
  static constexpr int kDirection[4][2] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}};
  for (int b = 0; b < 4 && faults.size() < kEnough; ++b) {
    const Vertex& c = tile.vertices[tile.corner_index(b)];
    if (c.x != corner[b][0] || c.y != corner[b][1]) {
      faults.push_back(
          fmt::format("corner C{} lies at ({}, {}), not at ({}, {})", b, c.x, c.y, corner[b][0], corner[b][1]));
    }
    for (std::uint32_t k = 1; k <= tile.n_side[static_cast<std::size_t>(b)] && faults.size() < kEnough; ++k) {
      const std::uint32_t index = tile.ring_index(b, k);
      const Vertex& v = tile.vertices[index];
      const Vertex& before = tile.vertices[index - 1];
      const bool on_line = b == 0 ? v.y == 0 : b == 1 ? v.x == s : b == 2 ? v.y == s : v.x == 0;
      const std::int64_t ahead = (v.x - before.x) * kDirection[b][0] + (v.y - before.y) * kDirection[b][1];
      const std::int64_t along = b == 0 || b == 2 ? v.x : v.y;
      if (!on_line || ahead <= 0 || along <= 0 || along >= s) {
        faults.push_back(fmt::format("{} does not follow on the {} border (side {})", vertex_text(tile, index),
                                     kBorderNames[static_cast<std::size_t>(b)], s));
      }
    }
  }
  return faults;
}

std::vector<std::string> find_interior_faults(const Tile& tile, const LatticeFrame& frame) {
  std::vector<std::string> faults;
  const std::int64_t s = frame.side(tile.id.level);
  for (std::uint32_t k = tile.ring_size(); k < tile.vertices.size() && faults.size() < kEnough; ++k) {
    const Vertex& v = tile.vertices[k];
    if (v.x <= 0 || v.y <= 0 || v.x >= s || v.y >= s) {
      faults.push_back(vertex_text(tile, k) + " is not strictly inside the tile");
      continue;
    }
    if (k == tile.ring_size()) continue;
    const Vertex& u = tile.vertices[k - 1];
    if (u.x < 0 || u.y < 0) continue;
    if (u.x == v.x && u.y == v.y) {
      faults.push_back(vertex_text(tile, k) + " is the same point as the one before");
    } else if (!before_in_morton_order(static_cast<std::uint64_t>(u.x), static_cast<std::uint64_t>(u.y),
                                       static_cast<std::uint64_t>(v.x), static_cast<std::uint64_t>(v.y))) {
      faults.push_back(vertex_text(tile, k) + " is out of Morton order");
    }
  }
  return faults;
}

std::vector<std::string> find_triangle_faults(const Tile& tile, const LatticeFrame& frame) {
  std::vector<std::string> faults;
  const auto add = [&](std::string fault) {
    if (faults.size() < kEnough) faults.push_back(std::move(fault));
  };
  Int128 twice_sum = 0;
  std::vector<std::uint64_t> edges;
  edges.reserve(tile.triangles.size() * 3);
  std::vector<bool> used(tile.vertices.size(), false);
  for (std::size_t k = 0; k < tile.triangles.size(); ++k) {
    const Corners& t = tile.triangles[k];
    const Vertex &a = tile.vertices[t[0]], &b = tile.vertices[t[1]], &c = tile.vertices[t[2]];
    const Int128 area = twice_area(a.x, a.y, b.x, b.y, c.x, c.y);
    twice_sum += area;
    if (area <= 0) {
      add(fmt::format("triangle {} ({}, {}, {}) at ({}, {}) has {} plan area", k, t[0], t[1], t[2], a.x, a.y,
                      area == 0 ? "no" : "a negative"));
    }
    if (t[0] >= t[1] || t[0] >= t[2]) add(fmt::format("triangle {} does not start with its smallest index", k));
    if (k > 0 && !(tile.triangles[k - 1] < t)) add(fmt::format("triangle {} is out of order", k));
    for (int e = 0; e < 3; ++e) {
      edges.push_back(edge_code(t[static_cast<std::size_t>(e)], t[static_cast<std::size_t>((e + 1) % 3)]));
      used[t[static_cast<std::size_t>(e)]] = true;
    }
  }
  const Int128 side = frame.side(tile.id.level);
  if (twice_sum != 2 * side * side) {
    add(fmt::format("plan areas do not sum to the tile's: off by {} half lattice squares",
                    static_cast<double>(twice_sum - 2 * side * side)));
  }
  const auto unused = std::find(used.begin(), used.end(), false);
  if (unused != used.end()) {
    add(vertex_text(tile, static_cast<std::uint32_t>(unused - used.begin())) + " is in no triangle");
  }
  // Inner edges come in pairs, one each way; what is single must be the ring.
  std::sort(edges.begin(), edges.end());
  const std::uint32_t ring = tile.ring_size();
  std::uint64_t ring_edges = 0;
  for (std::size_t k = 0; k < edges.size();) {
    std::size_t end = k;
    while (end < edges.size() && edges[end] >> 1 == edges[k] >> 1) ++end;
    const auto low = static_cast<std::uint32_t>(edges[k] >> 33);
    const auto high = static_cast<std::uint32_t>((edges[k] >> 1) & 0xffffffffu);
    const bool backwards = (edges[k] & 1) != 0;
    const auto from = backwards ? high : low, to = backwards ? low : high;
    const bool pair = end - k == 2 && edges[k] != edges[k + 1];
    const bool border = end - k == 1 && from < ring && to < ring && to == (from + 1) % ring;
    if (border) ++ring_edges;
    if (!pair && !border) {
      add(fmt::format("edge ({}, {}) belongs to {} triangle(s) instead of one each way", low, high, end - k));
    }
    k = end;
  }
  if (ring_edges != ring) add(fmt::format("{} of {} border edges belong to a triangle", ring_edges, ring));
  return faults;
}

std::vector<std::string> find_vt_faults(const Tile& tile) {
  std::vector<std::string> faults;
  const std::uint32_t ring = tile.ring_size();
  constexpr std::uint32_t kNone = 0xffffffffu;
  std::vector<std::uint32_t> owner(ring, kNone);
  std::vector<std::uint8_t> n_border_edges(tile.triangles.size(), 0);
  for (std::uint32_t k = 0; k < tile.triangles.size(); ++k) {
    const Corners& t = tile.triangles[k];
    for (std::size_t e = 0; e < 3; ++e) {
      const std::uint32_t from = t[e], to = t[(e + 1) % 3];
      if (from >= ring || to != (from + 1) % ring) continue;
      owner[from] = k;
      ++n_border_edges[k];
    }
  }
  std::vector<bool> listed(tile.triangles.size(), false);
  std::size_t next = 0;
  for (std::uint32_t position = 0; position < ring && faults.size() < kEnough; ++position) {
    const std::uint32_t triangle = owner[position];
    if (triangle == kNone || listed[triangle]) continue;
    listed[triangle] = true;
    VtRecord expected;
    expected.triangle = triangle;
    expected.n_edges = n_border_edges[triangle];
    const std::uint32_t other_end = (position + 1) % ring;
    // With two border edges the corner lies between them: at the end of this edge, or, for C0 only, at its start.
    const std::uint32_t at =
        expected.n_edges == 2 && !(position == 0 && owner[ring - 1] == triangle) ? other_end : position;
    for (int b = 0; b < 4; ++b) {
      if (at >= tile.corner_index(b)) {
        expected.border = static_cast<std::uint8_t>(b);
        expected.interval = at - tile.corner_index(b);
      }
    }
    if (next == tile.vts.size()) {
      faults.push_back("the virtual triangle at " + ring_text(tile, position) + " is not in the list");
      break;
    }
    const VtRecord& vt = tile.vts[next];
    if (vt.triangle != expected.triangle || vt.n_edges != expected.n_edges || vt.border != expected.border ||
        vt.interval != expected.interval) {
      faults.push_back(
          fmt::format("virtual triangle {}: says triangle {}, {} border edge(s), border {}, interval {}; is triangle "
                      "{}, {}, {}, {}",
                      next, vt.triangle, vt.n_edges, vt.border, vt.interval, expected.triangle, expected.n_edges,
                      expected.border, expected.interval));
    }
    ++next;
  }
  if (faults.empty() && next != tile.vts.size()) {
    faults.push_back(
        fmt::format("{} virtual triangles are listed, {} triangles have a border edge", tile.vts.size(), next));
  }
  for (std::size_t k = 0; k < tile.vts.size() && faults.size() < kEnough; ++k) {
    const VtRecord& vt = tile.vts[k];
    for (std::size_t r = 1; r < tile.runs_size(vt); ++r) {
      if (r % tile.n_gaps != 0 && tile.runs[vt.first_run + r] < tile.runs[vt.first_run + r - 1]) {
        faults.push_back(
            fmt::format("virtual triangle {}: run r_{} is below r_{}", k, r % tile.n_gaps + 1, r % tile.n_gaps));
      }
    }
  }
  return faults;
}

std::vector<std::string> find_range_faults(const Tile& tile) {
  const auto by_z = [](const Vertex& a, const Vertex& b) { return a.z < b.z; };
  const auto [low, high] = std::minmax_element(tile.vertices.begin(), tile.vertices.end(), by_z);
  if (low->z == tile.min_z && high->z == tile.max_z) return {};
  return {fmt::format("says heights are {}..{}, its vertices have {}..{}", tile.min_z, tile.max_z, low->z, high->z)};
}

}  // namespace tind::client
