// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/format/vertex_normals.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_map>

namespace tind {
namespace {

using Vector = std::array<double, 3>;
// A triangle by its three global lattice points, the smallest first: who looks at it does not matter.
using TriangleId = std::array<std::int64_t, 9>;

struct PlanPoint {
  std::int64_t x, y;
  friend bool operator==(const PlanPoint&, const PlanPoint&) = default;
};
struct PlanPointHash {
  std::size_t operator()(const PlanPoint& p) const {
    const auto x = static_cast<std::uint64_t>(p.x), y = static_cast<std::uint64_t>(p.y);
    return static_cast<std::size_t>((x * 0x9E3779B97F4A7C15u) ^ (y * 0xC2B2AE3D27D4EB4Fu));
  }
};

struct Share {
  TriangleId id;
  Vector normal;  // length: twice the area in m^2
};

Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
void add(Vector& sum, const Vector& v) {
  for (std::size_t k = 0; k < 3; ++k) sum[k] += v[k];
}

class Accumulator {
 public:
  Accumulator(const Lattice& lattice, const VirtualNode& node) : lattice_(lattice) {
    n_ring_ = 4;
    for (const std::uint32_t n : node.n_side) n_ring_ += n;
    n_ring_ = std::min(n_ring_, node.vertices.size());
    border_shares_.resize(n_ring_);
    sums_.resize(node.vertices.size());
    for (std::size_t v = 0; v < n_ring_; ++v) {
      const LatticePoint p = global(node, node.vertices[v]);
      border_.emplace(PlanPoint{p.x, p.y}, v);
    }
  }

  // Adds the triangles of the tile itself or of a neighbour.
  void add_tile(const VirtualNode& tile, bool own) {
    for (const Triangle& t : tile.triangles) {
      std::array<LatticePoint, 3> p;
      std::array<std::ptrdiff_t, 3> border{};
      bool touches = own;
      for (std::size_t k = 0; k < 3; ++k) {
        p[k] = global(tile, tile.vertices[t[k]]);
        const auto found = border_.find(PlanPoint{p[k].x, p[k].y});
        border[k] = found == border_.end() ? -1 : static_cast<std::ptrdiff_t>(found->second);
        touches = touches || border[k] >= 0;
      }
      if (!touches) continue;
      std::rotate(p.begin(), std::min_element(p.begin(), p.end(), less), p.end());
      const Vector a = lattice_.globe_position(p[0]), b = lattice_.globe_position(p[1]),
                   c = lattice_.globe_position(p[2]);
      const Vector normal = cross({b[0] - a[0], b[1] - a[1], b[2] - a[2]}, {c[0] - a[0], c[1] - a[1], c[2] - a[2]});
      const TriangleId id = {p[0].x, p[0].y, p[0].z, p[1].x, p[1].y, p[1].z, p[2].x, p[2].y, p[2].z};
      for (std::size_t k = 0; k < 3; ++k) {
        if (border[k] >= 0) border_shares_[static_cast<std::size_t>(border[k])].push_back({id, normal});
        if (own && t[k] >= n_ring_) add(sums_[t[k]], normal);
      }
    }
  }

  std::vector<Vector> finish(const VirtualNode& node) {
    for (std::size_t v = 0; v < n_ring_; ++v) {
      auto& shares = border_shares_[v];
      std::sort(shares.begin(), shares.end(), [](const Share& a, const Share& b) { return a.id < b.id; });
      for (const Share& share : shares) add(sums_[v], share.normal);
    }
    for (std::size_t v = 0; v < node.vertices.size(); ++v) {
      const LatticePoint p = global(node, node.vertices[v]);
      Vector& n = sums_[v];
      const double length = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
      if (p.y == 0 || p.y == lattice_.height()) {
        n = {0.0, 0.0, p.y == 0 ? -1.0 : 1.0};
      } else if (length > 0) {
        for (double& component : n) component /= length;
      } else {
        n = vertical(p);
      }
    }
    return std::move(sums_);
  }

 private:
  // x in [0, width): the antimeridian is one line.
  LatticePoint global(const VirtualNode& tile, const LocalVertex& v) const {
    const std::int64_t side = lattice_.tile_side(tile.key.level);
    return {(tile.key.x * side + v.x) % lattice_.width(), tile.key.y * side + v.y, v.z};
  }
  static bool less(const LatticePoint& a, const LatticePoint& b) { return a.x != b.x ? a.x < b.x : a.y < b.y; }
  Vector vertical(const LatticePoint& p) const {
    const Vector low = lattice_.geodetic_to_ecef(lattice_.longitude_deg(p.x), lattice_.latitude_deg(p.y), 0.0);
    const Vector high = lattice_.geodetic_to_ecef(lattice_.longitude_deg(p.x), lattice_.latitude_deg(p.y), 1e6);
    return {(high[0] - low[0]) * 1e-6, (high[1] - low[1]) * 1e-6, (high[2] - low[2]) * 1e-6};
  }

  const Lattice& lattice_;
  std::size_t n_ring_ = 0;
  std::unordered_map<PlanPoint, std::size_t, PlanPointHash> border_;
  std::vector<std::vector<Share>> border_shares_;
  std::vector<Vector> sums_;
};

}  // namespace

std::vector<std::array<double, 3>> vertex_normals(const Lattice& lattice, const VirtualNode& node,
                                                  std::span<const VirtualNode> neighbours) {
  Accumulator accumulator(lattice, node);
  accumulator.add_tile(node, true);
  for (const VirtualNode& neighbour : neighbours) accumulator.add_tile(neighbour, false);
  return accumulator.finish(node);
}

std::array<std::uint8_t, 2> oct_encode(const std::array<double, 3>& normal) {
  const double sum = std::abs(normal[0]) + std::abs(normal[1]) + std::abs(normal[2]);
  double x = normal[0] / sum, y = normal[1] / sum;
  if (normal[2] < 0) {
    const double folded_x = (1.0 - std::abs(y)) * (x < 0 ? -1.0 : 1.0);
    y = (1.0 - std::abs(x)) * (y < 0 ? -1.0 : 1.0);
    x = folded_x;
  }
  const auto byte = [](double v) {
    return static_cast<std::uint8_t>(std::floor((std::clamp(v, -1.0, 1.0) * 0.5 + 0.5) * 255.0 + 0.5));
  };
  return {byte(x), byte(y)};
}

}  // namespace tind
