// SPDX-License-Identifier: GPL-3.0-or-later
// The client's .vn decoder, and all that it does with a tile afterwards: whatever decodes must be safe to look at.
#include "tests/client/decode.hpp"
#include "tests/client/globe_mesh.hpp"
#include "tests/client/tessellate.hpp"
#include "tests/client/tile_faults.hpp"
#include "tests/fuzz/fuzz_target.hpp"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace tind::client;
  const auto vn = read_vn({data, size});
  if (!vn) return 0;
  const Tile& tile = vn->tile;
  require(tile.vertices.size() >= tile.ring_size(), "a tile has all vertices of its ring");
  if (vn->lattice_level > kDeepestLevel || tile.id.level > vn->lattice_level) return 0;
  const LatticeFrame frame{vn->lattice_level, 0};
  find_outline_faults(tile, frame);
  find_interior_faults(tile, frame);
  find_triangle_faults(tile, frame);
  find_vt_faults(tile);
  find_range_faults(tile);
  // Its own sides with one more vertex, as a finer neighbour would have.
  std::array<std::optional<SideInserts>, 4> sides;
  for (int b = 0; b < 4; ++b) {
    auto line = stored_side(tile, b);
    line.insert(line.begin() + 1, {line.front().t + 1, line.front().z, 255});
    auto inserts = decode_by_entry_levels(tile, b, line);
    if (inserts) sides[static_cast<std::size_t>(b)] = std::move(*inserts);
  }
  GlobeMesh mesh(frame);
  mesh.add(tile.id, tile.vertices, tile.triangles);
  if (const auto tessellated = tessellate(tile, sides))
    mesh.add(tile.id, tessellated->vertices, tessellated->triangles);
  mesh.find_faults();
  return 0;
}
