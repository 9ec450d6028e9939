// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/terrain_decode.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace tind::client {
namespace {

constexpr int kMaxValue = 32767;
constexpr std::size_t kEnough = 3;
constexpr std::uint32_t kMaxShortVertices = 65536;

/// u, v or height: a zig-zag delta chain of u16.
bool take_chain(ByteCursor& in, std::uint32_t n, std::vector<std::uint16_t>& out) {
  out.resize(n);
  int value = 0;
  for (auto& v : out) {
    const int code = in.take<std::uint16_t>();
    value += (code >> 1) ^ -(code & 1);
    if (value < 0 || value > kMaxValue) return false;
    v = static_cast<std::uint16_t>(value);
  }
  return !in.bad();
}

std::uint32_t take_index(ByteCursor& in, bool wide) {
  return wide ? in.take<std::uint32_t>() : in.take<std::uint16_t>();
}

std::string edge_name(std::size_t e) {
  static constexpr std::array<const char*, 4> kNames = {"west", "south", "east", "north"};
  return kNames[e];
}

void find_edge_faults(const TerrainMesh& mesh, std::vector<std::string>& faults) {
  for (std::size_t e = 0; e < 4; ++e) {
    const auto& across = e % 2 == 0 ? mesh.u : mesh.v;
    const auto& along = e % 2 == 0 ? mesh.v : mesh.u;
    const int line = e < 2 ? 0 : kMaxValue;
    const auto& list = mesh.edges[e];
    if (list.size() < 2) {
      faults.push_back(fmt::format("the {} edge list has {} vertices", edge_name(e), list.size()));
      continue;
    }
    for (std::size_t k = 0; k < list.size(); ++k) {
      if (across[list[k]] != line) {
        faults.push_back(
            fmt::format("the {} edge list names vertex {}, which is not on that edge", edge_name(e), list[k]));
        break;
      }
      if (k > 0 && along[list[k]] <= along[list[k - 1]]) {
        faults.push_back(fmt::format("the {} edge list is not ascending at its entry {}", edge_name(e), k));
        break;
      }
    }
    const auto on_line = std::count(across.begin(), across.end(), line);
    if (static_cast<std::size_t>(on_line) != list.size()) {
      faults.push_back(
          fmt::format("the {} edge list has {} vertices, {} lie on that edge", edge_name(e), list.size(), on_line));
    }
  }
}

void find_header_faults(const TerrainMesh& mesh, std::vector<std::string>& faults) {
  bool finite = std::isfinite(mesh.sphere_radius) && mesh.sphere_radius > 0 && std::isfinite(mesh.min_height_m) &&
                std::isfinite(mesh.max_height_m);
  for (std::size_t k = 0; k < 3; ++k) {
    finite = finite && std::isfinite(mesh.center[k]) && std::isfinite(mesh.sphere_center[k]) &&
             std::isfinite(mesh.occlusion_point[k]);
  }
  if (!finite) faults.push_back("the header holds numbers that are not finite, or an empty sphere");
  if (!(mesh.min_height_m <= mesh.max_height_m)) {
    faults.push_back(fmt::format("the header's heights {}..{} are out of order", mesh.min_height_m, mesh.max_height_m));
  }
}

}  // namespace

Outcome<TerrainMesh> read_terrain(BlobView bytes) {
  ByteCursor in(bytes);
  TerrainMesh mesh;
  for (auto& c : mesh.center) c = in.take<double>();
  mesh.min_height_m = in.take<float>();
  mesh.max_height_m = in.take<float>();
  for (auto& c : mesh.sphere_center) c = in.take<double>();
  mesh.sphere_radius = in.take<double>();
  for (auto& c : mesh.occlusion_point) c = in.take<double>();
  const auto n = in.take<std::uint32_t>();
  if (!in.expect(n, 6)) return refuse(".terrain: ends inside the header or the vertices");
  if (!take_chain(in, n, mesh.u) || !take_chain(in, n, mesh.v) || !take_chain(in, n, mesh.h)) {
    return refuse(".terrain: a vertex value is outside 0..32767");
  }
  const bool wide = n > kMaxShortVertices;
  if (wide && in.at() % 4 != 0) in.take_bytes(4 - in.at() % 4);
  const auto n_triangles = in.take<std::uint32_t>();
  if (!in.expect(n_triangles, wide ? 12 : 6)) return refuse(".terrain: ends inside the triangles");
  mesh.triangles.resize(n_triangles);
  std::uint32_t highest = 0;
  for (auto& t : mesh.triangles) {
    for (auto& corner : t) {
      const std::uint32_t code = take_index(in, wide);
      if (code > highest || highest - code >= n) return refuse(".terrain: a triangle index is out of range");
      corner = highest - code;
      if (code == 0) ++highest;
    }
  }
  for (std::size_t e = 0; e < 4; ++e) {
    const auto count = in.take<std::uint32_t>();
    if (!in.expect(count, wide ? 4 : 2)) return refuse(".terrain: ends inside the " + edge_name(e) + " edge list");
    for (std::uint32_t k = 0; k < count; ++k) {
      const std::uint32_t index = take_index(in, wide);
      if (index >= n) return refuse(".terrain: the " + edge_name(e) + " edge list is out of range");
      mesh.edges[e].push_back(index);
    }
  }
  while (in.left() > 0) {
    const auto id = in.take<std::uint8_t>();
    const auto length = in.take<std::uint32_t>();
    const BlobView data = in.take_bytes(length);
    if (in.bad()) return refuse(".terrain: ends inside an extension");
    if (id != 1) continue;
    if (length != std::uint64_t{2} * n) return refuse(".terrain: extension 1 does not hold two bytes a vertex");
    for (std::uint32_t k = 0; k < n; ++k) mesh.normals.push_back({data[2 * k], data[2 * k + 1]});
  }
  if (in.bad()) return refuse(".terrain: ends early");
  return mesh;
}

std::vector<std::string> find_mesh_faults(const TerrainMesh& mesh) {
  std::vector<std::string> faults;
  find_header_faults(mesh, faults);
  std::int64_t twice_sum = 0;
  std::vector<std::uint64_t> edges;
  std::size_t n_flat = 0;
  for (std::size_t k = 0; k < mesh.triangles.size(); ++k) {
    const Corners& t = mesh.triangles[k];
    const auto area = static_cast<std::int64_t>(
        twice_area(mesh.u[t[0]], mesh.v[t[0]], mesh.u[t[1]], mesh.v[t[1]], mesh.u[t[2]], mesh.v[t[2]]));
    twice_sum += area;
    if (area <= 0 && n_flat++ < kEnough) {
      faults.push_back(fmt::format("triangle {} at u {}, v {} {}", k, mesh.u[t[0]], mesh.v[t[0]],
                                   area == 0 ? "has no area" : "is turned over"));
    }
    for (std::size_t e = 0; e < 3; ++e) {
      const std::uint64_t from = t[e], to = t[(e + 1) % 3];
      edges.push_back((std::min(from, to) << 33) | (std::max(from, to) << 1) | (from > to ? 1u : 0u));
    }
  }
  if (twice_sum != std::int64_t{2} * kMaxValue * kMaxValue) {
    faults.push_back(fmt::format("triangles do not cover the tile: off by {} half grid squares",
                                 twice_sum - std::int64_t{2} * kMaxValue * kMaxValue));
  }
  std::sort(edges.begin(), edges.end());
  std::size_t n_loose = 0;
  for (std::size_t k = 0; k < edges.size();) {
    std::size_t end = k;
    while (end < edges.size() && edges[end] >> 1 == edges[k] >> 1) ++end;
    const auto a = edges[k] >> 33, b = (edges[k] >> 1) & 0xffffffffu;
    const bool on_side = (mesh.u[a] == mesh.u[b] && (mesh.u[a] == 0 || mesh.u[a] == kMaxValue)) ||
                         (mesh.v[a] == mesh.v[b] && (mesh.v[a] == 0 || mesh.v[a] == kMaxValue));
    const bool good = on_side ? end - k == 1 : end - k == 2 && edges[k] != edges[k + 1];
    if (!good && n_loose++ < kEnough) {
      faults.push_back(
          fmt::format("edge ({}, {}) at u {}, v {} belongs to {} triangle(s)", a, b, mesh.u[a], mesh.v[a], end - k));
    }
    k = end;
  }
  find_edge_faults(mesh, faults);
  return faults;
}

std::array<double, 3> decode_normal(std::array<std::uint8_t, 2> bytes) {
  double x = bytes[0] / 255.0 * 2 - 1, y = bytes[1] / 255.0 * 2 - 1;
  const double z = 1 - std::abs(x) - std::abs(y);
  if (z < 0) {
    const double old_x = x;
    x = (1 - std::abs(y)) * (x < 0 ? -1 : 1);
    y = (1 - std::abs(old_x)) * (y < 0 ? -1 : 1);
  }
  const double length = std::sqrt(x * x + y * y + z * z);
  return {x / length, y / length, z / length};
}

}  // namespace tind::client
