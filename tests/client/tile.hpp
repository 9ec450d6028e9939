// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "tests/client/tile_id.hpp"

namespace tind::client {

/// A vertex of a tile: lattice steps from the SW corner, height units.
struct Vertex {
  std::int64_t x = 0;
  std::int64_t y = 0;
  std::int32_t z = 0;
  friend bool operator==(const Vertex&, const Vertex&) = default;
};

/// A vertex on a tile side: steps from the side's W or S end, height units, entry level.
struct SideVertex {
  std::int64_t t = 0;
  std::int32_t z = 0;
  std::uint8_t entry = 0;
  friend bool operator==(const SideVertex&, const SideVertex&) = default;
};

/// A virtual triangle; members as in docs/format.md 5. `first_run`: where its n_edges * G runs start in Tile::runs.
struct VtRecord {
  std::uint32_t triangle = 0;
  std::uint8_t n_edges = 1;
  std::uint8_t border = 0;
  std::uint32_t interval = 0;
  std::uint32_t first_run = 0;
  friend bool operator==(const VtRecord&, const VtRecord&) = default;
};

using Corners = std::array<std::uint32_t, 3>;

/// A whole tile, from a .vn or put together from a .parts. The decoder guarantees that indices are in range and |x|,
/// |y| < 2^46; everything else is for the checks to find out.
struct Tile {
  TileId id;
  std::uint8_t coverage = 0;
  std::int32_t min_z = 0, max_z = 0;
  std::uint64_t n_posts = 0;
  float max_error_m = 0, rmse_m = 0;
  std::array<std::uint32_t, 4> n_side{};
  std::vector<Vertex> vertices;                      ///< Local order.
  std::array<std::vector<std::uint8_t>, 4> entries;  ///< Per border, ring direction, both corners.
  std::vector<Corners> triangles;
  std::uint8_t n_gaps = 0;
  std::vector<VtRecord> vts;
  std::vector<std::uint32_t> runs;

  std::uint32_t ring_size() const { return 4 + n_side[0] + n_side[1] + n_side[2] + n_side[3]; }
  /// Local index of corner C_b.
  std::uint32_t corner_index(int b) const {
    std::uint32_t index = 0;
    for (int k = 0; k < b; ++k) index += 1 + n_side[static_cast<std::size_t>(k)];
    return index;
  }
  /// Local index of the k-th vertex of border b in ring direction; 0 is C_b, n_side[b] + 1 the next corner.
  std::uint32_t ring_index(int b, std::uint32_t k) const { return (corner_index(b) + k) % ring_size(); }
  std::size_t runs_size(const VtRecord& vt) const { return std::size_t{vt.n_edges} * n_gaps; }

  friend bool operator==(const Tile&, const Tile&) = default;
};

/// Border b of a tile in RING direction, both corners included; t still counts from the W or S end.
std::vector<SideVertex> ring_side(const Tile& tile, int b);
/// The same in stored direction (W->E or S->N).
std::vector<SideVertex> stored_side(const Tile& tile, int b);

}  // namespace tind::client
