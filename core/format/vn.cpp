// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/format/vn.hpp"

namespace tind {

std::array<std::size_t, 3> write_vertices(ByteWriter& out, const std::vector<LocalVertex>& vertices) {
  const auto column = [&](auto member) {
    std::int64_t previous = 0;
    out.svarints(vertices, [&](const LocalVertex& v, auto put) {
      const std::int64_t value = v.*member;
      put(value - previous);
      previous = value;
    });
    return out.size();
  };
  return {column(&LocalVertex::x), column(&LocalVertex::y), column(&LocalVertex::z)};
}

void write_triangles(ByteWriter& out, const std::vector<Triangle>& triangles) {
  std::int64_t previous = 0;
  out.svarints<3>(triangles, [&](const Triangle& t, auto put) {
    for (const std::uint32_t index : t) {
      put(static_cast<std::int64_t>(index) - previous);
      previous = index;
    }
  });
}

void write_virtual_triangles(ByteWriter& out, const std::vector<VirtualTriangle>& vts) {
  for (const VirtualTriangle& vt : vts) {
    out.uvarint(vt.triangle);
    out.fixed(static_cast<std::uint8_t>(vt.n_edges | (vt.border << 2)));
    out.uvarint(vt.interval);
    for (const std::uint32_t run : vt.runs) out.uvarint(run);
  }
}

Bytes encode_vn(const Lattice& lattice, const VirtualNode& node, double tolerance_m) {
  ByteWriter out;
  // About what a vertex and its two triangles take.
  out.reserve(128 + 16 * node.vertices.size());
  for (const char c : {'T', 'V', 'N', '1'}) out.fixed(c);
  out.fixed(node.key.level);
  out.fixed(static_cast<std::uint8_t>(lattice.level));
  out.fixed(static_cast<std::uint8_t>(lattice.height_exponent));
  out.fixed(static_cast<std::uint8_t>(node.stats.coverage));
  out.fixed(node.key.x);
  out.fixed(node.key.y);
  out.fixed(static_cast<float>(tolerance_m));
  out.fixed(node.stats.max_error_m);
  out.fixed(node.stats.rmse_m);
  out.fixed(node.stats.min_z);
  out.fixed(node.stats.max_z);
  std::uint32_t n_ring = 4;
  for (const std::uint32_t n : node.n_side) {
    out.fixed(n);
    n_ring += n;
  }
  out.fixed(static_cast<std::uint32_t>(node.vertices.size() - n_ring));
  out.fixed(static_cast<std::uint32_t>(node.triangles.size()));
  out.fixed(static_cast<std::uint32_t>(node.virtual_triangles.size()));
  out.fixed(node.n_gaps);
  for (int i = 0; i < 3; ++i) out.fixed(std::uint8_t{0});
  out.fixed(node.stats.n_posts);
  for (const auto& entries : node.side_entries) out.raw(entries);
  write_vertices(out, node.vertices);
  write_triangles(out, node.triangles);
  write_virtual_triangles(out, node.virtual_triangles);
  return out.take();
}

}  // namespace tind
