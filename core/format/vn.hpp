// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>

#include "core/format/bytes.hpp"
#include "core/lattice.hpp"
#include "core/virtual_node.hpp"

namespace tind {

/// Appends the x, y and z columns of docs/format.md 5 (shared by the body record and the VN tile). Gives out's size at
/// the end of each.
std::array<std::size_t, 3> write_vertices(ByteWriter& out, const std::vector<LocalVertex>& vertices);
/// Appends the triangle list of docs/format.md 5 (shared by the body record and the VN tile).
void write_triangles(ByteWriter& out, const std::vector<Triangle>& triangles);
/// Appends the virtual triangle list of docs/format.md 5.
void write_virtual_triangles(ByteWriter& out, const std::vector<VirtualTriangle>& vts);

/// The `.vn` bytes of docs/format.md 7. `tolerance_m`: E_L of the tile's level. Pure, thread safe.
Bytes encode_vn(const Lattice& lattice, const VirtualNode& node, double tolerance_m);

}  // namespace tind
