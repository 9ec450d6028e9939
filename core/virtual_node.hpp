// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/tile_key.hpp"

namespace tind {

/// The corner point of up to four tiles of one level. `z` in height units.
struct Corner {
  std::int32_t z = 0;
  friend bool operator==(const Corner&, const Corner&) = default;
};

/// A vertex inside an edge. `t`: lattice steps from the edge's start, 0 < t < tile side. `entry`: the level at which it
/// entered its border line.
struct EdgeVertex {
  std::int64_t t = 0;
  std::int32_t z = 0;
  std::uint8_t entry = 0;
  friend bool operator==(const EdgeVertex&, const EdgeVertex&) = default;
};

/// One side of a tile, shared by the two tiles beside it: W->E or S->N, without the two corners (only their entry
/// levels on this border line are here). `inner` is strictly ascending in t.
struct EdgeChain {
  std::uint8_t start_entry = 0;
  std::uint8_t end_entry = 0;
  std::vector<EdgeVertex> inner;
  friend bool operator==(const EdgeChain&, const EdgeChain&) = default;
};

/// A vertex in a tile: lattice steps east and north of the tile's SW corner, in [0, tile side]; z in height units.
struct LocalVertex {
  std::int64_t x = 0;
  std::int64_t y = 0;
  std::int32_t z = 0;
  friend bool operator==(const LocalVertex&, const LocalVertex&) = default;
};

/// How much of a tile the source covers. Persistent values.
enum class TileCoverage : std::uint8_t {
  kFiller = 0,   ///< No source post: falloff or base height only.
  kPartial = 1,  ///< Source posts and also filled voids, falloff or base height.
  kReal = 2,     ///< Every post in the tile comes from the source.
};

/// A triangle with one or two edges on the tile's border, and the crack-tessellation code of the paper.
/// `border` 0..3 (south, east, north, west) and `interval` name the border edge in ring direction: interval k of border
/// b runs from the k-th to the (k+1)-th vertex of that border, its start corner counting as 0. With n_edges == 2 the
/// triangle holds the corner C_border: its edges are the last interval of border (b+3)%4 and interval 0 of `border`.
/// `runs`: r_1..r_G for each border edge in ring order (size n_edges * G); r_g counts the vertices strictly inside the
/// interval that entered the border line at a level in (L, L+g].
struct VirtualTriangle {
  std::uint32_t triangle = 0;
  std::uint8_t n_edges = 1;
  std::uint8_t border = 0;
  std::uint32_t interval = 0;
  std::vector<std::uint32_t> runs;
  friend bool operator==(const VirtualTriangle&, const VirtualTriangle&) = default;
};

using Triangle = std::array<std::uint32_t, 3>;

/// What is measured and counted per tile. Heights in height units over all vertices, borders included.
struct TileStats {
  TileCoverage coverage = TileCoverage::kFiller;
  std::int32_t min_z = 0;
  std::int32_t max_z = 0;
  std::uint64_t n_posts = 0;  ///< Source posts in [west, east) x [south, north) that were measured.
  float max_error_m = 0;      ///< max |TIN - h| over those posts, rounded up.
  float rmse_m = 0;           ///< Root mean square of TIN - h over those posts.
  friend bool operator==(const TileStats&, const TileStats&) = default;
};

/// Errors of a tile's mesh at the posts of one of its cells: 2^n x 2^n squares, n <= kMostCellLevels, row-major from
/// the south-west.
struct CellErrors {
  std::uint64_t n_posts = 0;
  double sum_m2 = 0;  ///< Of their squares.
  float largest_m = 0;
  friend bool operator==(const CellErrors&, const CellErrors&) = default;
};
inline constexpr int kMostCellLevels = 8;

/// What belongs to one tile alone. Triangles index the local order: ring (C0, B0, C1, B1, C2, B2, C3, B3), then
/// `interior` in Morton order. `n_side[b]`: inner vertices of border b, equal to the sizes of the edge chains.
/// `n_gaps` G: how many finer levels the runs of the virtual triangles cover.
struct TileBody {
  TileStats stats;
  std::array<std::uint32_t, 4> n_side{};
  std::vector<LocalVertex> interior;
  std::vector<Triangle> triangles;
  std::uint8_t n_gaps = 0;
  std::vector<VirtualTriangle> virtual_triangles;  ///< In ring order of their first border edge.
  friend bool operator==(const TileBody&, const TileBody&) = default;

  /// Number of vertices of the ring: four corners and the inner border vertices.
  std::uint32_t ring_size() const { return 4 + n_side[0] + n_side[1] + n_side[2] + n_side[3]; }
};

/// A tile put together from its nine pieces ("virtual node" of the paper).
struct VirtualNode {
  TileKey key;
  TileStats stats;
  std::array<std::uint32_t, 4> n_side{};
  /// Local order: ring counter-clockwise from C0 = SW, then interior.
  std::vector<LocalVertex> vertices;
  /// Entry levels along border b in RING direction, both corners included: n_side[b] + 2 values.
  std::array<std::vector<std::uint8_t>, 4> side_entries;
  std::vector<Triangle> triangles;  ///< Counter-clockwise seen from above.
  std::uint8_t n_gaps = 0;
  std::vector<VirtualTriangle> virtual_triangles;
};

}  // namespace tind
