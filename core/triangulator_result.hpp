// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/mesh.hpp"
#include "core/triangulator.hpp"

namespace tind {

/// Brings a finished mesh into the order of docs/format.md 5. Storage is kept from tile to tile.
class TileExtractor {
 public:
  /// Interior vertices in Morton order, triangles in local order, lowest and highest vertex. The first `n_ring`
  /// vertices of the mesh are the ring, in local order.
  void extract(const Mesh& mesh, std::int32_t n_ring, TileSurface& surface);

  /// The vertices of the mesh that was extracted last, in local order.
  std::span<const Mesh::Vertex> vertices() const { return vertices_; }

 private:
  std::vector<LocalVertex> interior_;
  std::vector<Triangle> turned_;
  std::vector<std::uint32_t> order_, index_, first_;  // of the interior; per vertex: local order, next triangle
  std::vector<Mesh::Vertex> vertices_;                // in local order, so that near ones lie together
};

/// Indices of points in Morton order of (x, y); of equal ones the first comes first. 0 <= x, y.
void morton_order(const std::vector<LocalVertex>& points, std::vector<std::uint32_t>& order);

}  // namespace tind
