// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <span>
#include <vector>

#include "core/lattice.hpp"
#include "core/virtual_node.hpp"

namespace tind {

/// Unit normals (ECEF) per vertex of `node`: the area-weighted mean over all triangles that touch the vertex, in `node`
/// and in `neighbours`. Pass all stored tiles of the same level that touch the tile (up to eight, wrapping in x), each
/// once; then every tile that has a border vertex computes the same normal for it, bit for bit, because a triangle's
/// share depends on its own lattice points alone and the shares are added in an order that no side decides. At a pole
/// the normal is the axis. Indices of all triangles must be in range. Pure, thread safe.
std::vector<std::array<double, 3>> vertex_normals(const Lattice& lattice, const VirtualNode& node,
                                                  std::span<const VirtualNode> neighbours);

/// Octahedral encoding in two bytes (quantized-mesh extension 1, as CesiumJS's AttributeCompression.octEncode).
/// `normal` must be of unit length.
std::array<std::uint8_t, 2> oct_encode(const std::array<double, 3>& normal);

}  // namespace tind
