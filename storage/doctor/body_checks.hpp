// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "core/virtual_node.hpp"
#include "storage/doctor/line_checks.hpp"

namespace tind {

/// Checks of an assembled tile against docs/format.md 5. Each gives the first thing that is wrong, or "". Pure, thread
/// safe, safe for any tile that assemble() lets through. `side`: lattice steps along the tile's side.

/// Interior vertices are in Morton order, each another point.
std::string find_interior_fault(const VirtualNode& node);
/// Triangles are counter-clockwise, their smallest index first, sorted, and cover the tile once: every inner edge is in
/// two triangles, one each way, every border edge in one, the areas sum to the tile's, and Euler's count holds.
std::string find_triangle_fault(const VirtualNode& node, std::int64_t side);
/// min_z and max_z are those of the vertices; errors are numbers, within `tolerance_m` and none without posts.
std::string find_stats_fault(const VirtualNode& node, double tolerance_m);
/// All virtual triangles are listed in ring order, and their runs count what the border lines have. `lines`: the finest
/// line of each border in ring direction, places counted from its start in that direction; nullopt where it is not
/// known. `is_part`: finer tiles may be in another file, so runs may count more.
std::string find_virtual_triangle_fault(const VirtualNode& node,
                                        const std::array<std::optional<std::vector<LinePoint>>, 4>& lines,
                                        bool is_part);

}  // namespace tind
