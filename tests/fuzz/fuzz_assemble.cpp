// SPDX-License-Identifier: GPL-3.0-or-later
// Input: level (u8), x (u32), y (u32), then nine records in local order, each with its length (uvarint) before it.
#include <algorithm>

#include "core/assembler.hpp"
#include "core/format/vn.hpp"
#include "storage/piece_blob.hpp"
#include "tests/fuzz/fuzz_target.hpp"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  tind::ByteReader in({data, size});
  tind::TileKey key;
  key.level = in.fixed<std::uint8_t>();
  key.x = in.fixed<std::uint32_t>();
  key.y = in.fixed<std::uint32_t>();
  tind::TilePieces pieces;
  for (std::size_t b = 0; b < 4; ++b) {
    const auto corner = tind::decode_corner(in.raw(in.count(1)));
    const auto edge = tind::decode_edge(in.raw(in.count(1)));
    if (!corner || !edge) return 0;
    pieces.corners[b] = *corner;
    pieces.edges[b] = *edge;
  }
  const auto body = tind::decode_body(in.raw(in.count(1)));
  if (!body) return 0;
  pieces.body = *body;

  tind::Lattice lattice;
  lattice.level = 12;
  lattice.height_exponent = 6;
  const auto node = tind::assemble(lattice, key, std::move(pieces));
  if (!node) return 0;
  const std::int64_t side = lattice.tile_side(key.level);
  for (const tind::LocalVertex& v : node->vertices) {
    require(v.x >= 0 && v.x <= side && v.y >= 0 && v.y <= side, "vertices lie in the tile");
  }
  for (const tind::Triangle& t : node->triangles) {
    for (const std::uint32_t i : t) require(i < node->vertices.size(), "triangles index vertices");
  }
  for (const tind::VirtualTriangle& vt : node->virtual_triangles) {
    require(vt.triangle < node->triangles.size(), "virtual triangles index triangles");
    require(vt.border < 4, "virtual triangles name a border");
  }
  for (std::size_t b = 0; b < 4; ++b) {
    require(node->side_entries[b].size() == node->n_side[b] + 2u, "an entry level for every border vertex");
  }
  require(tind::encode_vn(lattice, *node, 1.0).size() >= 80, "an assembled tile can be encoded");
  return 0;
}
