// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "tests/client/byte_cursor.hpp"
#include "tests/client/tile.hpp"

namespace tind::client {

/// A quantized-mesh 1.0 tile (github.com/CesiumGS/quantized-mesh, SPECIFICATION.md), decoded. Positions and heights
/// 0..32767.
struct TerrainMesh {
  std::array<double, 3> center{}, sphere_center{}, occlusion_point{};
  double sphere_radius = 0;
  float min_height_m = 0, max_height_m = 0;
  std::vector<std::uint16_t> u, v, h;
  std::vector<Corners> triangles;
  std::array<std::vector<std::uint32_t>, 4> edges;   ///< West, south, east, north, as in the file.
  std::vector<std::array<std::uint8_t, 2>> normals;  ///< Extension 1; empty when absent.

  /// Height in metres as a client computes it, in double precision.
  double height_m(std::size_t k) const {
    const double low = static_cast<double>(min_height_m), high = static_cast<double>(max_height_m);
    return low + h[k] / 32767.0 * (high - low);
  }
};

/// Decodes; safe for any bytes, refuses with the field's name. Indices are in range and values 0..32767 in what it
/// gives.
Outcome<TerrainMesh> read_terrain(BlobView bytes);

/// What a mesh must be on its own: one line per fault. Triangles positive in u, v and covering the square exactly
/// without a T-junction, edge lists complete and sorted, header sane.
std::vector<std::string> find_mesh_faults(const TerrainMesh& mesh);

/// Unit normal from extension 1's two bytes.
std::array<double, 3> decode_normal(std::array<std::uint8_t, 2> bytes);

}  // namespace tind::client
