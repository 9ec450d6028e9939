// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/assembler.hpp"

#include <string>

namespace tind {
namespace {

tl::unexpected<Error> misfit(const TileKey& key, const char* what) {
  return fail(ErrorKind::kCorrupt, "tile " + std::to_string(key.level) + "/" + std::to_string(key.x) + "/" +
                                       std::to_string(key.y) + ": " + what);
}

}  // namespace

Result<VirtualNode> assemble(const Lattice& lattice, const TileKey& key, TilePieces pieces) {
  if (!key.valid() || key.level > lattice.level) return misfit(key, "no such tile");
  const std::int64_t side = lattice.tile_side(key.level);
  TileBody& body = pieces.body;
  VirtualNode node;
  node.key = key;
  node.stats = body.stats;
  node.n_side = body.n_side;
  node.n_gaps = body.n_gaps;

  std::size_t n_ring = 4;
  for (int b = 0; b < 4; ++b) {
    const EdgeChain& edge = pieces.edges[static_cast<std::size_t>(b)];
    if (edge.inner.size() != body.n_side[static_cast<std::size_t>(b)]) {
      return misfit(key, "the body counts other border vertices than the edge has");
    }
    std::int64_t before = 0;
    for (const EdgeVertex& v : edge.inner) {
      if (v.t <= before || v.t >= side) return misfit(key, "edge vertices do not ascend inside their side");
      before = v.t;
    }
    n_ring += edge.inner.size();
  }
  const std::size_t n_vertices = n_ring + body.interior.size();
  node.vertices.reserve(n_vertices);

  const std::array<LocalVertex, 4> corner_at = {
      LocalVertex{0, 0, pieces.corners[0].z}, LocalVertex{side, 0, pieces.corners[1].z},
      LocalVertex{side, side, pieces.corners[2].z}, LocalVertex{0, side, pieces.corners[3].z}};
  for (std::size_t b = 0; b < 4; ++b) {
    const EdgeChain& edge = pieces.edges[b];
    const bool reversed = b >= 2;  // stored W->E and S->N, the ring runs E->W in the north and N->S in the west
    std::vector<std::uint8_t>& entries = node.side_entries[b];
    entries.reserve(edge.inner.size() + 2);
    node.vertices.push_back(corner_at[b]);
    entries.push_back(reversed ? edge.end_entry : edge.start_entry);
    for (std::size_t k = 0; k < edge.inner.size(); ++k) {
      const EdgeVertex& v = edge.inner[reversed ? edge.inner.size() - 1 - k : k];
      node.vertices.push_back(b == 0   ? LocalVertex{v.t, 0, v.z}
                              : b == 1 ? LocalVertex{side, v.t, v.z}
                              : b == 2 ? LocalVertex{v.t, side, v.z}
                                       : LocalVertex{0, v.t, v.z});
      entries.push_back(v.entry);
    }
    entries.push_back(reversed ? edge.start_entry : edge.end_entry);
  }
  for (const LocalVertex& v : body.interior) {
    if (v.x <= 0 || v.y <= 0 || v.x >= side || v.y >= side)
      return misfit(key, "an interior vertex lies outside the tile");
    node.vertices.push_back(v);
  }
  for (const Triangle& t : body.triangles) {
    for (const std::uint32_t index : t) {
      if (index >= n_vertices) return misfit(key, "a triangle names a vertex that does not exist");
    }
  }
  for (const VirtualTriangle& vt : body.virtual_triangles) {
    if (vt.triangle >= body.triangles.size() || vt.interval > body.n_side[vt.border & 3]) {
      return misfit(key, "a virtual triangle names a triangle or interval that does not exist");
    }
  }
  node.triangles = std::move(body.triangles);
  node.virtual_triangles = std::move(body.virtual_triangles);
  return node;
}

}  // namespace tind
