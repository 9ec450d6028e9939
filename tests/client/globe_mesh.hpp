// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "tests/client/tile.hpp"

namespace tind::client {

/// All triangles of a cut of the globe in lattice integers, X modulo the width. Exact; finds out whether they form one
/// surface.
class GlobeMesh {
 public:
  explicit GlobeMesh(const LatticeFrame& frame);

  /// Forgets everything, keeps the memory.
  void clear();
  /// Adds the triangles of one tile; vertices are relative to its SW corner.
  void add(const TileId& id, std::span<const Vertex> vertices, std::span<const Corners> triangles);
  /// Looks at the whole: one line per fault, at most a few. Heights, areas, and each directed edge once with its
  /// reverse once except along the two pole rows.
  std::vector<std::string> find_faults() const;
  std::uint64_t n_triangles() const { return n_triangles_; }

 private:
  struct Point {
    std::int64_t x, y;
    std::int32_t z;
  };
  std::uint32_t point_number(std::int64_t x, std::int64_t y, std::int32_t z, const TileId& id);
  void add_edge(std::uint32_t from, std::uint32_t to, std::int64_t dx);
  void grow_points();
  void grow_edges();
  void add_fault(std::string fault);
  std::string place(const Point& p) const;

  LatticeFrame frame_;
  std::vector<Point> points_;
  std::vector<std::uint32_t> point_slots_;  ///< Open addressing: number + 1, 0 empty.
  std::vector<std::uint64_t> edge_slots_;   ///< Open addressing: code of the undirected edge, 0 empty.
  std::vector<std::uint8_t>
      edge_uses_;  ///< Times used: bits 0-1 from the lower number on, bits 2-3 back; 3 means 3 or more.
  std::uint64_t n_edges_ = 0;
  std::uint64_t n_triangles_ = 0;
  Int128 twice_area_ = 0;
  std::vector<std::uint32_t> local_;  ///< Scratch: point numbers of the tile being added.
  std::vector<std::string> faults_;
};

}  // namespace tind::client
