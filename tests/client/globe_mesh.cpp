// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/globe_mesh.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace tind::client {
namespace {

constexpr std::size_t kFirstSlots = 1 << 16;
constexpr std::size_t kEnough = 4;

std::uint64_t mix(std::uint64_t v) {
  v = (v ^ (v >> 32)) * 0x9e3779b97f4a7c15ull;
  return v ^ (v >> 29);
}

std::uint64_t hash_point(std::int64_t x, std::int64_t y) {
  return mix(static_cast<std::uint64_t>(x) * 0xd6e8feb86659fd93ull + static_cast<std::uint64_t>(y));
}

}  // namespace

GlobeMesh::GlobeMesh(const LatticeFrame& frame) : frame_(frame) { clear(); }

void GlobeMesh::clear() {
  points_.clear();
  if (point_slots_.empty()) point_slots_.resize(kFirstSlots);
  if (edge_slots_.empty()) {
    edge_slots_.resize(kFirstSlots);
    edge_uses_.resize(kFirstSlots);
  }
  std::fill(point_slots_.begin(), point_slots_.end(), 0);
  std::fill(edge_slots_.begin(), edge_slots_.end(), 0);
  std::fill(edge_uses_.begin(), edge_uses_.end(), 0);
  n_edges_ = n_triangles_ = 0;
  twice_area_ = 0;
  faults_.clear();
}

void GlobeMesh::add_fault(std::string fault) {
  if (faults_.size() < kEnough) faults_.push_back(std::move(fault));
}

std::string GlobeMesh::place(const Point& p) const {
  return fmt::format("lattice ({}, {}) height {} (longitude {:.6f}, latitude {:.6f})", p.x, p.y, p.z,
                     static_cast<double>(p.x) * frame_.step_deg() - 180,
                     static_cast<double>(p.y) * frame_.step_deg() - 90);
}

void GlobeMesh::grow_points() {
  std::vector<std::uint32_t> slots(point_slots_.size() * 2);
  const std::uint64_t mask = slots.size() - 1;
  for (std::uint32_t k = 0; k < points_.size(); ++k) {
    std::uint64_t at = hash_point(points_[k].x, points_[k].y) & mask;
    while (slots[at] != 0) at = (at + 1) & mask;
    slots[at] = k + 1;
  }
  point_slots_ = std::move(slots);
}

std::uint32_t GlobeMesh::point_number(std::int64_t x, std::int64_t y, std::int32_t z, const TileId& id) {
  if (points_.size() * 2 >= point_slots_.size()) grow_points();
  const std::uint64_t mask = point_slots_.size() - 1;
  for (std::uint64_t at = hash_point(x, y) & mask;; at = (at + 1) & mask) {
    const std::uint32_t slot = point_slots_[at];
    if (slot == 0) {
      points_.push_back({x, y, z});
      point_slots_[at] = static_cast<std::uint32_t>(points_.size());
      return static_cast<std::uint32_t>(points_.size() - 1);
    }
    const Point& p = points_[slot - 1];
    if (p.x != x || p.y != y) continue;
    if (p.z != z) add_fault(fmt::format("tile {}: another height, {}, at {}", id.text(), z, place(p)));
    return slot - 1;
  }
}

void GlobeMesh::grow_edges() {
  std::vector<std::uint64_t> slots(edge_slots_.size() * 2);
  std::vector<std::uint8_t> uses(slots.size());
  const std::uint64_t mask = slots.size() - 1;
  for (std::size_t k = 0; k < edge_slots_.size(); ++k) {
    if (edge_slots_[k] == 0) continue;
    std::uint64_t at = mix(edge_slots_[k]) & mask;
    while (slots[at] != 0) at = (at + 1) & mask;
    slots[at] = edge_slots_[k];
    uses[at] = edge_uses_[k];
  }
  edge_slots_ = std::move(slots);
  edge_uses_ = std::move(uses);
}

void GlobeMesh::add_edge(std::uint32_t from, std::uint32_t to, std::int64_t dx) {
  if (n_edges_ * 2 >= edge_slots_.size()) grow_edges();
  const bool back = from > to;
  // Two edges between the same two points are different when each spans half the globe, one eastwards and one
  // westwards.
  const std::int64_t ahead = back ? -dx : dx;
  const std::uint64_t east_half = ahead == frame_.width() / 2 ? 1 : 0;
  const std::uint64_t low = std::min(from, to), high = std::max(from, to);
  const std::uint64_t code = (low << 33) | (high << 2) | (east_half << 1) | 1u;
  const std::uint64_t mask = edge_slots_.size() - 1;
  std::uint64_t at = mix(code) & mask;
  while (edge_slots_[at] != 0 && edge_slots_[at] != code) at = (at + 1) & mask;
  if (edge_slots_[at] == 0) {
    edge_slots_[at] = code;
    ++n_edges_;
  }
  const int shift = back ? 2 : 0;
  if (((edge_uses_[at] >> shift) & 3) < 3) edge_uses_[at] = static_cast<std::uint8_t>(edge_uses_[at] + (1 << shift));
}

void GlobeMesh::add(const TileId& id, std::span<const Vertex> vertices, std::span<const Corners> triangles) {
  const std::int64_t x0 = frame_.origin_x(id), y0 = frame_.origin_y(id), width = frame_.width();
  local_.resize(vertices.size());
  for (std::size_t k = 0; k < vertices.size(); ++k) {
    const std::int64_t x = ((x0 + vertices[k].x) % width + width) % width;
    local_[k] = point_number(x, y0 + vertices[k].y, vertices[k].z, id);
  }
  for (const Corners& t : triangles) {
    const Vertex &a = vertices[t[0]], &b = vertices[t[1]], &c = vertices[t[2]];
    const Int128 area = twice_area(a.x, a.y, b.x, b.y, c.x, c.y);
    twice_area_ += area;
    if (area <= 0) {
      add_fault(fmt::format("tile {}: a triangle with {} plan area at {}", id.text(), area == 0 ? "no" : "a negative",
                            place(points_[local_[t[0]]])));
    }
    add_edge(local_[t[0]], local_[t[1]], b.x - a.x);
    add_edge(local_[t[1]], local_[t[2]], c.x - b.x);
    add_edge(local_[t[2]], local_[t[0]], a.x - c.x);
  }
  n_triangles_ += triangles.size();
}

std::vector<std::string> GlobeMesh::find_faults() const {
  std::vector<std::string> faults = faults_;
  const Int128 whole = Int128{2} * frame_.width() * frame_.height();
  if (twice_area_ != whole) {
    faults.push_back(fmt::format("plan areas sum to {} of the globe's lattice area, not to all of it exactly",
                                 static_cast<double>(twice_area_) / static_cast<double>(whole)));
  }
  std::uint64_t n_open = 0;
  for (std::size_t k = 0; k < edge_slots_.size(); ++k) {
    if (edge_slots_[k] == 0 || edge_uses_[k] == (1 | 1 << 2)) continue;
    const Point& a = points_[edge_slots_[k] >> 33];
    const Point& b = points_[(edge_slots_[k] >> 2) & 0x7fffffffu];
    const bool pole_row = a.y == b.y && (a.y == 0 || a.y == frame_.height());
    if (pole_row && (edge_uses_[k] == 1 || edge_uses_[k] == 1 << 2)) continue;
    if (n_open++ < kEnough) {
      faults.push_back(fmt::format("crack or overlap: edge from {} to {} is used {} time(s) one way and {} the other",
                                   place(a), place(b), edge_uses_[k] & 3, edge_uses_[k] >> 2));
    }
  }
  if (n_open > kEnough) faults.push_back(fmt::format("{} such edges in all", n_open));
  return faults;
}

}  // namespace tind::client
