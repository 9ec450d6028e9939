// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/doctor/body_checks.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <span>

#include "core/tessellation.hpp"

namespace tind {
namespace {

__extension__ using Int128 = __int128;

std::size_t ring_size(const VirtualNode& node) {
  std::size_t n = 4;
  for (const std::uint32_t n_inner : node.n_side) n += n_inner;
  return n;
}

// Where corner C_b stands in the ring.
std::size_t corner_index(const VirtualNode& node, std::size_t b) {
  std::size_t at = b;
  for (std::size_t k = 0; k < b; ++k) at += node.n_side[k];
  return at;
}

// Undirected edge of two vertices, and in the lowest bit its direction. Indices are below 2^32, so bit 63 may go.
std::uint64_t edge_code(std::uint64_t from, std::uint64_t to) {
  return std::min(from, to) << 32 | std::max(from, to) << 1 | (from > to ? 1 : 0);
}

}  // namespace

std::string find_interior_fault(const VirtualNode& node) {
  for (std::size_t k = ring_size(node) + 1; k < node.vertices.size(); ++k) {
    const LocalVertex &a = node.vertices[k - 1], &b = node.vertices[k];
    if (!morton_less(static_cast<std::uint64_t>(a.x), static_cast<std::uint64_t>(a.y), static_cast<std::uint64_t>(b.x),
                     static_cast<std::uint64_t>(b.y))) {
      return fmt::format("interior vertices: vertex {} at ({}, {}) is not behind the one before it in Morton order", k,
                         b.x, b.y);
    }
  }
  return "";
}

std::string find_triangle_fault(const VirtualNode& node, std::int64_t side) {
  const std::size_t n_ring = ring_size(node), n = node.vertices.size();
  const std::size_t expected = 2 * (n - n_ring) + n_ring - 2;
  if (n > std::size_t{1} << 31) return "triangles: more vertices than can be";
  if (node.triangles.size() != expected) {
    return fmt::format("triangles: {}, but {} vertices of which {} on the border make {}", node.triangles.size(), n,
                       n_ring, expected);
  }
  std::vector<std::uint64_t> edges;
  edges.reserve(3 * expected);
  Int128 doubled_area = 0;
  for (std::size_t k = 0; k < expected; ++k) {
    const Triangle& t = node.triangles[k];
    if (t[0] >= t[1] || t[0] >= t[2])
      return fmt::format("triangles: triangle {} starts not with its smallest index", k);
    if (k > 0 && !(node.triangles[k - 1] < t)) return fmt::format("triangles: triangle {} is out of order", k);
    const LocalVertex &a = node.vertices[t[0]], &b = node.vertices[t[1]], &c = node.vertices[t[2]];
    const Int128 area = Int128{b.x - a.x} * (c.y - a.y) - Int128{c.x - a.x} * (b.y - a.y);
    if (area <= 0) {
      return fmt::format("triangles: triangle {} ({}, {}, {}) is {}", k, t[0], t[1], t[2],
                         area == 0 ? "without area" : "clockwise");
    }
    doubled_area += area;
    for (std::size_t e = 0; e < 3; ++e) edges.push_back(edge_code(t[e], t[(e + 1) % 3]));
  }
  if (doubled_area != Int128{2} * side * side) return "triangles: their areas do not sum to the tile's";
  std::sort(edges.begin(), edges.end());
  std::size_t n_border = 0;
  for (std::size_t k = 0; k < edges.size();) {
    const std::uint64_t low = edges[k] >> 32, high = (edges[k] & 0xffffffff) >> 1;
    if (k + 1 < edges.size() && edges[k + 1] == edges[k] + 1 && edges[k] % 2 == 0 &&
        (k + 2 == edges.size() || edges[k + 2] / 2 != edges[k] / 2)) {
      k += 2;
      continue;
    }
    const bool backwards = edges[k] % 2 == 1;
    const std::uint64_t from = backwards ? high : low, to = backwards ? low : high;
    const bool is_alone = k + 1 == edges.size() || edges[k + 1] / 2 != edges[k] / 2;
    if (!is_alone || from >= n_ring || to != (from + 1) % n_ring) {
      return fmt::format("triangles: edge ({}, {}) is neither in two triangles, one each way, nor on the border", from,
                         to);
    }
    ++n_border;
    ++k;
  }
  if (n_border != n_ring) return fmt::format("triangles: {} of {} border edges have one", n_border, n_ring);
  return "";
}

std::string find_stats_fault(const VirtualNode& node, double tolerance_m) {
  const TileStats& stats = node.stats;
  const auto [low, high] = std::minmax_element(node.vertices.begin(), node.vertices.end(),
                                               [](const LocalVertex& a, const LocalVertex& b) { return a.z < b.z; });
  if (stats.min_z != low->z || stats.max_z != high->z) {
    return fmt::format("min_z, max_z: {}, {}, but its vertices are {} to {} high", stats.min_z, stats.max_z, low->z,
                       high->z);
  }
  const double max_error = stats.max_error_m, rmse = stats.rmse_m;
  if (!(max_error >= 0) || !(max_error <= tolerance_m)) {
    return fmt::format("max_error: {} m, not within the tolerance {} m", max_error, tolerance_m);
  }
  // A mean is no more than the largest, but both were rounded to 32 bits.
  if (!(rmse >= 0) || !(rmse <= max_error * (1 + 1e-6))) {
    return fmt::format("rmse: {} m, not within the maximum error {} m", rmse, max_error);
  }
  if (stats.coverage == TileCoverage::kFiller && stats.n_posts != 0) {
    return fmt::format("coverage: filler, but {} source posts were measured", stats.n_posts);
  }
  if (stats.n_posts == 0 && (max_error != 0 || rmse != 0)) return "n_posts: none, but there are errors";
  return "";
}

std::string find_virtual_triangle_fault(const VirtualNode& node,
                                        const std::array<std::optional<std::vector<LinePoint>>, 4>& lines,
                                        bool is_part) {
  const std::vector<VirtualTriangle> expected = find_virtual_triangles(node.triangles, node.n_side);
  if (node.virtual_triangles.size() != expected.size()) {
    return fmt::format("virtual triangles: {} are listed, {} triangles have a border edge",
                       node.virtual_triangles.size(), expected.size());
  }
  // Per border: the runs of each interval.
  std::array<std::vector<std::vector<std::uint32_t>>, 4> runs;
  for (std::size_t b = 0; b < 4; ++b) {
    if (!lines[b]) continue;
    const auto along = [&](std::size_t k) {
      const LocalVertex& v = node.vertices[k % ring_size(node)];
      const LocalVertex& c = node.vertices[corner_index(node, b)];
      return std::abs(v.x - c.x) + std::abs(v.y - c.y);
    };
    std::size_t next = 0;
    for (std::size_t k = 0; k <= node.n_side[b]; ++k) {
      const std::int64_t first = along(corner_index(node, b) + k), behind = along(corner_index(node, b) + k + 1);
      std::vector<std::uint8_t> inside;
      for (; next < lines[b]->size() && (*lines[b])[next].t < behind; ++next) {
        if ((*lines[b])[next].t > first) inside.push_back((*lines[b])[next].entry);
      }
      runs[b].push_back(encode_runs(inside, node.key.level, node.n_gaps));
    }
  }
  constexpr const char* kBorders[] = {"south", "east", "north", "west"};
  for (std::size_t k = 0; k < expected.size(); ++k) {
    const VirtualTriangle &vt = node.virtual_triangles[k], &right = expected[k];
    if (vt.triangle != right.triangle || vt.n_edges != right.n_edges || vt.border != right.border ||
        vt.interval != right.interval) {
      return fmt::format(
          "virtual triangles: number {} is triangle {} with {} edge(s), border {}, interval {}; listed is triangle {} "
          "with {}, border {}, interval {}",
          k, right.triangle, right.n_edges, right.border, right.interval, vt.triangle, vt.n_edges, vt.border,
          vt.interval);
    }
    for (std::size_t e = 0; e < vt.n_edges; ++e) {
      const bool is_before = vt.n_edges == 2 && e == 0;
      const std::size_t b = is_before ? (vt.border + 3u) % 4 : vt.border;
      if (!lines[b]) continue;
      const auto& counted = is_before ? runs[b].back() : runs[b][vt.interval];
      const auto listed = std::span(vt.runs).subspan(e * node.n_gaps, node.n_gaps);
      for (std::size_t g = 0; g < node.n_gaps; ++g) {
        if (listed[g] == counted[g] || (is_part && listed[g] > counted[g])) continue;
        return fmt::format(
            "virtual triangles: number {}: run r_{} on the {} border is {}, the line has {} vertices there", k, g + 1,
            kBorders[b], listed[g], counted[g]);
      }
    }
  }
  return "";
}

}  // namespace tind
