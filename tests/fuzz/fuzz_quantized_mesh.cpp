// SPDX-License-Identifier: GPL-3.0-or-later
// Input: a lattice level (u8), then points (u32 x, u32 y, i16 z, u8 kind) that are inserted one by one into a square;
// kinds 1..4 put the point on a side, kind 255 breaks a triangle of the finished mesh instead.
#include <algorithm>

#include "core/format/mesh_rounding.hpp"
#include "core/format/quantized_mesh.hpp"
#include "tests/fuzz/fuzz_target.hpp"

namespace {

constexpr std::size_t kMaxPoints = 80;
constexpr std::int64_t kSteps = 32767;
__extension__ using Wide = __int128;

template <class A, class B, class C>
Wide doubled_area(const A& a, const B& b, const C& c) {
  return Wide{b[0] - a[0]} * (c[1] - a[1]) - Wide{b[1] - a[1]} * (c[0] - a[0]);
}
std::array<std::int64_t, 2> plan(const tind::LocalVertex& v) { return {v.x, v.y}; }
std::array<std::int64_t, 2> plan(const std::array<std::uint16_t, 2>& v) { return {v[0], v[1]}; }

struct Square {
  std::int64_t side;
  std::vector<tind::LocalVertex> points;
  std::vector<tind::Triangle> triangles;

  void insert(const tind::LocalVertex& p) {
    if (points.size() == kMaxPoints) return;
    for (const auto& q : points) {
      if (q.x == p.x && q.y == p.y) return;
    }
    const auto v = static_cast<std::uint32_t>(points.size());
    points.push_back(p);
    std::vector<tind::Triangle> next;
    for (const auto& t : triangles) {
      std::array<Wide, 3> turn;
      for (std::size_t k = 0; k < 3; ++k)
        turn[k] = doubled_area(plan(points[t[k]]), plan(points[t[(k + 1) % 3]]), plan(p));
      if (*std::min_element(turn.begin(), turn.end()) < 0) {
        next.push_back(t);
        continue;
      }
      for (std::size_t k = 0; k < 3; ++k) {
        if (turn[k] > 0) next.push_back({t[k], t[(k + 1) % 3], v});
      }
    }
    triangles = std::move(next);
  }
  std::int64_t along_ring(const tind::LocalVertex& p) const {
    return p.y == 0      ? p.x
           : p.x == side ? side + p.y
           : p.y == side ? 3 * side - p.x
           : p.x == 0    ? 4 * side - p.y
                         : 5 * side;
  }
  tind::VirtualNode node() const {
    std::vector<std::uint32_t> order(points.size()), place(points.size());
    for (std::uint32_t i = 0; i < order.size(); ++i) order[i] = i;
    std::stable_sort(order.begin(), order.end(),
                     [&](auto a, auto b) { return along_ring(points[a]) < along_ring(points[b]); });
    tind::VirtualNode node;
    for (std::uint32_t i = 0; i < order.size(); ++i) {
      place[order[i]] = i;
      node.vertices.push_back(points[order[i]]);
      const auto r = along_ring(points[order[i]]);
      if (r < 4 * side && r % side != 0) ++node.n_side[static_cast<std::size_t>(r / side)];
    }
    for (const auto& t : triangles) node.triangles.push_back({place[t[0]], place[t[1]], place[t[2]]});
    return node;
  }
};

}  // namespace

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  tind::ByteReader in({data, size});
  tind::Lattice lattice;
  lattice.level = in.fixed<std::uint8_t>() % (tind::kMaxLevel + 1);
  lattice.height_exponent = 4;
  const std::int64_t side = lattice.tile_side(0);
  Square square{side, {{0, 0, 0}, {side, 0, 9}, {side, side, -7}, {0, side, 5}}, {{0, 1, 2}, {0, 2, 3}}};
  std::vector<std::array<std::uint32_t, 2>> breaks;
  while (in.remaining() >= 11) {
    const std::uint32_t a = in.fixed<std::uint32_t>(), b = in.fixed<std::uint32_t>();
    const std::int32_t z = in.fixed<std::int16_t>();
    const int kind = in.fixed<std::uint8_t>();
    if (kind == 255) {
      breaks.push_back({a, b});
      continue;
    }
    const std::int64_t x = 1 + a % (side - 1), y = 1 + b % (side - 1);
    square.insert({kind == 1 ? 0 : kind == 2 ? side : x, kind == 3 ? 0 : kind == 4 ? side : y, z});
  }
  tind::VirtualNode node = square.node();
  tind::QuantizedMeshOptions options;
  options.normals = true;
  options.border_step_m = 0.25;
  if (!breaks.empty()) {
    for (const auto& at : breaks) node.triangles[at[0] % node.triangles.size()][at[1] % 3] = at[1] / 3;
    const auto refused = tind::encode_quantized_mesh(lattice, node, options);
    require(refused.has_value() || !refused.error().message.empty(), "a failure says why");
    return 0;
  }
  const auto mesh = tind::round_to_grid(node, side, kSteps);
  require(mesh.has_value(), "every triangulation can be rounded");
  Wide sum = 0;
  for (const auto& t : mesh->triangles) {
    const Wide area =
        doubled_area(plan(mesh->positions[t[0]]), plan(mesh->positions[t[1]]), plan(mesh->positions[t[2]]));
    require(area > 0, "no triangle is flat or turned over");
    sum += area;
  }
  require(sum == Wide{2} * kSteps * kSteps, "the triangles cover the square");
  require(tind::encode_quantized_mesh(lattice, node, options).has_value(), "what can be rounded can be encoded");
  return 0;
}
