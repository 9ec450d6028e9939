// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/virtual_node.hpp"

namespace tind {

/// Runs r_1..r_G of one border interval of a tile of `level` (paper's crack-tessellation code, docs/format.md 6).
/// `entries`: entry levels of ALL vertices that the border line has strictly inside the interval, at any level.
std::vector<std::uint32_t> encode_runs(std::span<const std::uint8_t> entries, int level, int n_gaps);

/// What a tile's border looks like to a coarser neighbour: `runs[k]` vertices strictly inside the k-th piece between
/// vertices that level `coarse_level` has too.
struct CoarseRuns {
  std::vector<std::uint32_t> runs;
  bool starts_inside = false;  ///< The border's first corner is not a vertex of the coarse level.
  bool ends_inside = false;
};

/// Cuts one border of a tile for a coarser level. `entries`: of the border's vertices in ring direction, both corners
/// included (VirtualNode::side_entries). Precondition: at least two entries.
CoarseRuns coarse_runs(std::span<const std::uint8_t> entries, int coarse_level);

/// Finds the virtual triangles of a tile in ring order (docs/format.md 5), without runs.
/// `triangles`: counter-clockwise, local order indices; ring size from `n_side`.
std::vector<VirtualTriangle> find_virtual_triangles(const std::vector<Triangle>& triangles,
                                                    const std::array<std::uint32_t, 4>& n_side);

/// Re-triangulates one virtual triangle. `ring_chain_before`/`after`: see docs/format.md 6.
/// With one border edge (a, b) in ring direction, apex p and the finer vertices f_1..f_m between a and b: a fan
/// (a, f_1, p), (f_1, f_2, p), .., (f_m, b, p). Indices are the caller's. Appends to `out`.
void fan(std::span<const std::uint32_t> border_chain, std::uint32_t apex, std::vector<Triangle>& out);

/// The zig-zag of a corner triangle with two border edges: `corner`, then `after` (R: along the ring) and `before`
/// (Q: against the ring), both without the corner and ending in the triangle's own vertices. Appends to `out`.
void zig_zag(std::uint32_t corner, std::span<const std::uint32_t> after, std::span<const std::uint32_t> before,
             std::vector<Triangle>& out);

}  // namespace tind
