// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <cmath>
#include <span>

#include "core/format/bytes.hpp"
#include "core/lattice.hpp"
#include "core/result.hpp"
#include "core/virtual_node.hpp"

namespace tind {

/// Positions and heights of a tile are whole steps 0..32767 of its side and its height range.
inline constexpr double kQuantizedSteps = 32767;

/// Where quantized-mesh puts a coordinate of a vertex, 0 <= at <= side in local lattice steps: at the nearest multiple
/// of side / kQuantizedSteps, but what is inside the tile stays a step away from its sides.
inline double served_position(double at, double side) {
  if (at <= 0 || at >= side) return at;
  const double step = side / kQuantizedSteps, nearest = std::floor(at / step + 0.5);
  return std::clamp(nearest, 1.0, kQuantizedSteps - 1) * step;
}
/// Whether that is further away than half a step.
inline bool is_served_far(double at, double side) {
  return at > 0 && at < side && std::min(at, side - at) < side / kQuantizedSteps / 2;
}

/// Smallest step of border heights in metres. With it every multiple up to 32 km is a 32-bit float, as the header of a
/// tile needs; a level's own step is used where it is larger.
inline constexpr double kSmallestBorderStepM = 0x1p-9;

struct QuantizedMeshOptions {
  /// Step of border heights in metres: LevelInfo::height_step_m of the tile's level, the same for all its tiles.
  double border_step_m = 1.0;
  /// Write extension 1 (octvertexnormals).
  bool normals = false;
  /// With `normals`: all stored tiles of the level that touch this one, each once (see vertex_normals).
  std::span<const VirtualNode> neighbours;
};

/// A tile as quantized-mesh 1.0 (github.com/CesiumGS/quantized-mesh, SPECIFICATION.md).
///
/// Heights: border vertices are rounded to multiples of the border step S (rounded up to a power of two), the others to
/// the tile's own step s. The range maximum - minimum is 32767 s with s = S / 2^j, the smallest that holds the tile;
/// where 32-bit floats cannot hold so fine a minimum and maximum (nearly flat tiles high up), it is m S / 2^j with m a
/// divisor of 32767, which stays within twice the true range and keeps border heights whole steps all the same. So a
/// decoder that computes min + q / 32767 * (max - min) in double precision gets border heights exactly, and (1 - t) min
/// + t max to 4e-16 of the larger of |min|, |max|: borders decode alike from both sides. A flat tile has minimum ==
/// maximum. Positions: round_to_grid to 0..32767.
///
/// Fails with kCorrupt when the triangles are no triangulation or indices are out of range, with kUnsupported when the
/// range exceeds 32767 S or a height 32 km. Pure, thread safe.
Result<Bytes> encode_quantized_mesh(const Lattice& lattice, const VirtualNode& node,
                                    const QuantizedMeshOptions& options);

}  // namespace tind
