// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/format/quantized_mesh.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>

#include "core/format/mesh_rounding.hpp"
#include "core/format/vertex_normals.hpp"

namespace tind {
namespace {

using Vector = std::array<double, 3>;

constexpr auto kSteps = static_cast<std::int64_t>(kQuantizedSteps);
constexpr std::size_t kShortIndexVertices = 65536;
constexpr std::uint8_t kOctNormalsExtension = 1;
constexpr std::uint32_t kUnused = std::numeric_limits<std::uint32_t>::max();
// Squares overflow to infinity, so that CesiumJS's test (EllipsoidalOccluder) never finds the point hidden.
constexpr double kNeverOccluded = 1e160;

double norm(const Vector& v) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

bool is_float(double v) { return static_cast<double>(static_cast<float>(v)) == v; }

struct Heights {
  double minimum_m = 0, maximum_m = 0;
  std::vector<std::uint16_t> q;  // per vertex of the tile
};

// Divisors of 32767, largest first.
constexpr std::array<double, 8> kDivisors = {32767, 4681, 1057, 217, 151, 31, 7, 1};

// A header's height range: minimum a multiple of the unit, `units` units up to the maximum.
struct HeightRange {
  double minimum_m = 0, unit_m = 0, units = 0;
};

// The range of a tile from `low` to `high`. The unit is the border step over a power of two, so that border heights are
// whole units; the number of units divides 32767, so that whole units are whole steps of the encoding; minimum and
// maximum are exact 32-bit floats. 32767 units, whose step is the unit itself, unless that is more than twice the true
// range: high plateaus have no float for so fine a unit.
std::optional<HeightRange> find_range(double low, double high, double range, double border_step) {
  const auto smallest_of = [&](double units) -> std::optional<HeightRange> {
    for (double unit = std::min(border_step, std::exp2(std::floor(std::log2(range / units)))); unit <= border_step;
         unit *= 2) {
      const double minimum = std::floor(low / unit) * unit, maximum = minimum + units * unit;
      if (high <= maximum && is_float(minimum) && is_float(maximum)) return HeightRange{minimum, unit, units};
    }
    return std::nullopt;
  };
  std::optional<HeightRange> best;
  for (const double units : kDivisors) {
    const auto found = smallest_of(units);
    if (found && (!best || found->units * found->unit_m < best->units * best->unit_m)) best = found;
    if (units == kDivisors.front() && best && best->units * best->unit_m <= 2 * range) break;
  }
  return best;
}

// `used`: vertices that some triangle has. The range is the tile's and holds the others, too.
std::optional<Heights> quantize_heights(const Lattice& lattice, const VirtualNode& node, const std::vector<bool>& used,
                                        double border_step_m) {
  std::size_t n_ring = 4;
  for (const std::uint32_t n : node.n_side) n_ring += n;
  const double border_step = std::exp2(std::ceil(std::log2(std::max(border_step_m, kSmallestBorderStepM))));
  std::vector<double> h(node.vertices.size());
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (std::size_t v = 0; v < h.size(); ++v) {
    h[v] = lattice.height_m(node.vertices[v].z);
    if (v < n_ring) h[v] = round_to_step(h[v], border_step);
    low = std::min(low, h[v]);
    high = std::max(high, h[v]);
  }
  Heights out;
  out.q.resize(h.size());
  if (low == high && is_float(low)) {
    out.minimum_m = out.maximum_m = low;
    return out;
  }
  const double range = std::max(high - low, lattice.height_unit_m());
  const std::optional<HeightRange> best = find_range(low, high, range, border_step);
  if (!best) return std::nullopt;
  out.minimum_m = best->minimum_m;
  out.maximum_m = best->minimum_m + best->units * best->unit_m;
  const double step = best->units * best->unit_m / static_cast<double>(kSteps);
  for (std::size_t v = 0; v < h.size(); ++v) {
    if (used[v]) out.q[v] = static_cast<std::uint16_t>(std::floor((h[v] - out.minimum_m) / step + 0.5));
  }
  return out;
}

// The order in which triangles first name the vertices, as high-water-mark coding needs it.
struct Order {
  std::vector<std::uint32_t> new_index;  // per vertex of the tile; kUnused where no triangle has it
  std::vector<std::uint32_t> old_index;
};

Order order_by_first_use(std::size_t n_vertices, const std::vector<Triangle>& triangles) {
  Order order;
  order.new_index.assign(n_vertices, kUnused);
  for (const Triangle& t : triangles) {
    for (const std::uint32_t v : t) {
      if (order.new_index[v] != kUnused) continue;
      order.new_index[v] = static_cast<std::uint32_t>(order.old_index.size());
      order.old_index.push_back(v);
    }
  }
  return order;
}

struct Bounds {
  Vector center{};
  double radius_m = 0;
  Vector occlusion_point{};
};

// How far out along `direction` a point must lie to be visible whenever `position` is (both on the unit sphere's
// scale): CesiumJS, EllipsoidalOccluder.computeHorizonCullingPoint; cesium.com/blog/2013/05/09. Infinite where none is
// far enough.
double occlusion_magnitude(const Vector& position, const Vector& direction) {
  const double length = norm(position), magnitude = std::max(1.0, length);
  const Vector p = {position[0] / length, position[1] / length, position[2] / length};
  const double cos_alpha = p[0] * direction[0] + p[1] * direction[1] + p[2] * direction[2];
  const double sin_alpha = std::sqrt(std::max(0.0, 1.0 - cos_alpha * cos_alpha));
  const double cos_beta = 1.0 / magnitude, sin_beta = std::sqrt(magnitude * magnitude - 1.0) * cos_beta;
  const double cosine = cos_alpha * cos_beta - sin_alpha * sin_beta;
  return cosine > 1e-9 ? 1.0 / cosine : std::numeric_limits<double>::infinity();
}

Bounds bounds_of(const Ellipsoid& ellipsoid, const std::vector<Vector>& points, double minimum_m) {
  Bounds bounds;
  Vector low = points[0], high = points[0];
  for (const Vector& p : points) {
    for (std::size_t k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], p[k]);
      high[k] = std::max(high[k], p[k]);
    }
  }
  for (std::size_t k = 0; k < 3; ++k) bounds.center[k] = (low[k] + high[k]) / 2;
  for (const Vector& p : points) {
    const Vector from_center = {p[0] - bounds.center[0], p[1] - bounds.center[1], p[2] - bounds.center[2]};
    bounds.radius_m = std::max(bounds.radius_m, norm(from_center));
  }
  // Clients round positions to 32 bits relative to the center.
  bounds.radius_m = bounds.radius_m * (1.0 + 1e-6) + 0.01;

  const Vector radii = {ellipsoid.semi_major_m, ellipsoid.semi_major_m, ellipsoid.semi_minor_m()};
  const auto scaled = [&](const Vector& v, double shrink_m) {
    return Vector{v[0] / (radii[0] - shrink_m), v[1] / (radii[1] - shrink_m), v[2] / (radii[2] - shrink_m)};
  };
  const Vector toward = scaled(bounds.center, 0.0);
  const double length = norm(toward);
  const Vector direction = {toward[0] / length, toward[1] / length, toward[2] / length};
  // Below the ellipsoid CesiumJS culls against one shrunk by the lowest height; the farther point is right for both.
  const double shrink_m = std::max(0.0, -minimum_m);
  double magnitude = 0;
  for (const Vector& p : points) {
    magnitude = std::max(magnitude, occlusion_magnitude(scaled(p, 0.0), direction));
    if (shrink_m > 0) magnitude = std::max(magnitude, occlusion_magnitude(scaled(p, shrink_m), direction));
  }
  // A level-0 tile reaches 90 degrees from its middle and more: no point stands for it, it may be visible from
  // everywhere.
  if (!std::isfinite(magnitude) || !std::isfinite(direction[0])) {
    const Vector anywhere = {1.0, 0.0, 0.0};
    const Vector& d = std::isfinite(direction[0]) ? direction : anywhere;
    bounds.occlusion_point = {d[0] * kNeverOccluded, d[1] * kNeverOccluded, d[2] * kNeverOccluded};
  } else {
    bounds.occlusion_point = {direction[0] * magnitude, direction[1] * magnitude, direction[2] * magnitude};
  }
  return bounds;
}

void write_vector(ByteWriter& out, const Vector& v) {
  for (const double component : v) out.fixed(component);
}

template <class Value>
void write_deltas(ByteWriter& out, const std::vector<std::uint32_t>& old_index, Value&& value) {
  std::int32_t last = 0;
  for (const std::uint32_t v : old_index) {
    const std::int32_t current = value(v), delta = current - last;
    out.fixed(static_cast<std::uint16_t>((delta << 1) ^ (delta >> 31)));
    last = current;
  }
}

template <class Index>
void write_indices(ByteWriter& out, const VirtualNode& node, const RoundedMesh& mesh, const Order& order) {
  out.fixed(static_cast<std::uint32_t>(mesh.triangles.size()));
  std::uint32_t highest = 0;
  for (const Triangle& t : mesh.triangles) {
    for (const std::uint32_t v : t) {
      const std::uint32_t index = order.new_index[v];
      out.fixed(static_cast<Index>(highest - index));
      if (index == highest) ++highest;
    }
  }
  // West and east by v, south and north by u.
  constexpr std::array<std::size_t, 4> kBorders = {3, 0, 1, 2};
  std::array<std::size_t, 5> first{};
  for (std::size_t b = 0; b < 4; ++b) first[b + 1] = first[b] + node.n_side[b] + 1;
  for (const std::size_t b : kBorders) {
    std::vector<Index> indices;
    for (std::size_t k = first[b]; k <= first[b + 1]; ++k) {
      const std::uint32_t index = order.new_index[k % first[4]];
      if (index != kUnused) indices.push_back(static_cast<Index>(index));
    }
    if (b >= 2) std::reverse(indices.begin(), indices.end());
    out.fixed(static_cast<std::uint32_t>(indices.size()));
    for (const Index index : indices) out.fixed(index);
  }
}

}  // namespace

Result<Bytes> encode_quantized_mesh(const Lattice& lattice, const VirtualNode& node,
                                    const QuantizedMeshOptions& options) {
  const std::string name =
      "tile " + std::to_string(node.key.level) + "/" + std::to_string(node.key.x) + "/" + std::to_string(node.key.y);
  if (!node.key.valid() || node.key.level > lattice.level || !(options.border_step_m > 0)) {
    return fail(ErrorKind::kCorrupt, name + ": no such tile or border step");
  }
  const std::int64_t side = lattice.tile_side(node.key.level);
  const Result<RoundedMesh> mesh = round_to_grid(node, side, kSteps);
  if (!mesh) return tl::unexpected(mesh.error());

  Order order = order_by_first_use(node.vertices.size(), mesh->triangles);
  const std::size_t n_sides = node.n_side[0] + node.n_side[1] + node.n_side[2] + node.n_side[3];
  for (std::size_t b = 0, corner = 0; b < 4; corner += node.n_side[b] + 1, ++b) {
    if (order.new_index[corner] == kUnused) return fail(ErrorKind::kCorrupt, name + ": a corner is in no triangle");
  }
  if (node.vertices.size() < 4 + n_sides) return fail(ErrorKind::kCorrupt, name + ": vertices are missing");
  std::vector<bool> used(node.vertices.size());
  for (const std::uint32_t v : order.old_index) used[v] = true;

  const std::optional<Heights> heights = quantize_heights(lattice, node, used, options.border_step_m);
  if (!heights) {
    return fail(ErrorKind::kUnsupported,
                name + ": its heights do not fit 32767 steps of " + std::to_string(options.border_step_m) + " m");
  }

  // What clients will decode.
  const double west = lattice.longitude_deg(node.key.x * side), south = lattice.latitude_deg(node.key.y * side);
  const double side_deg = static_cast<double>(side) * lattice.step_deg();
  const double range_m = heights->maximum_m - heights->minimum_m;
  std::vector<Vector> points;
  points.reserve(order.old_index.size());
  for (const std::uint32_t v : order.old_index) {
    const auto [u_q, v_q] = mesh->positions[v];
    points.push_back(lattice.geodetic_to_ecef(
        west + u_q / static_cast<double>(kSteps) * side_deg, south + v_q / static_cast<double>(kSteps) * side_deg,
        heights->minimum_m + heights->q[v] / static_cast<double>(kSteps) * range_m));
  }
  const Bounds bounds = bounds_of(lattice.ellipsoid, points, heights->minimum_m);

  // CesiumJS reads a tile of exactly 65,536 vertices with two index widths at once: one vertex that no triangle uses
  // more.
  if (order.old_index.size() == kShortIndexVertices) order.old_index.push_back(order.old_index.back());

  ByteWriter out;
  write_vector(out, bounds.center);
  out.fixed(static_cast<float>(heights->minimum_m));
  out.fixed(static_cast<float>(heights->maximum_m));
  write_vector(out, bounds.center);
  out.fixed(bounds.radius_m);
  write_vector(out, bounds.occlusion_point);
  out.fixed(static_cast<std::uint32_t>(order.old_index.size()));
  write_deltas(out, order.old_index, [&](std::uint32_t v) { return mesh->positions[v][0]; });
  write_deltas(out, order.old_index, [&](std::uint32_t v) { return mesh->positions[v][1]; });
  write_deltas(out, order.old_index, [&](std::uint32_t v) { return heights->q[v]; });
  if (order.old_index.size() > kShortIndexVertices) {
    while (out.size() % sizeof(std::uint32_t) != 0) out.fixed(std::uint8_t{0});
    write_indices<std::uint32_t>(out, node, *mesh, order);
  } else {
    write_indices<std::uint16_t>(out, node, *mesh, order);
  }
  if (options.normals) {
    const std::vector<Vector> normals = vertex_normals(lattice, node, options.neighbours);
    out.fixed(kOctNormalsExtension);
    out.fixed(static_cast<std::uint32_t>(2 * order.old_index.size()));
    for (const std::uint32_t v : order.old_index) out.raw(oct_encode(normals[v]));
  }
  return out.take();
}

}  // namespace tind
