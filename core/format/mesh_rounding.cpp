// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/format/mesh_rounding.hpp"

#include <algorithm>
#include <limits>
#include <string>
#include <unordered_map>

namespace tind {
namespace {

// Positions times n_steps stay below 2^59, so their cross products need 119 bits.
__extension__ using Int128 = __int128;

struct Point {
  std::int64_t x = 0, y = 0;
  friend bool operator==(const Point&, const Point&) = default;
};

// > 0 iff a, b, c turn counter-clockwise.
int orientation(const Point& a, const Point& b, const Point& c) {
  const Int128 cross = Int128{b.x - a.x} * (c.y - a.y) - Int128{b.y - a.y} * (c.x - a.x);
  return cross > 0 ? 1 : cross < 0 ? -1 : 0;
}

// Closed triangle a, b, c (counter-clockwise).
bool contains(const Point& a, const Point& b, const Point& c, const Point& p) {
  return orientation(a, b, p) >= 0 && orientation(b, c, p) >= 0 && orientation(c, a, p) >= 0;
}

tl::unexpected<Error> corrupt(const TileKey& key, const char* what) {
  return fail(ErrorKind::kCorrupt, "tile " + std::to_string(key.level) + "/" + std::to_string(key.x) + "/" +
                                       std::to_string(key.y) + ": " + what);
}

// A triangulation whose vertices move to the grid one at a time. All coordinates are multiplied by n_steps, so lattice
// positions (n_steps apart) and grid positions (side apart) are integers on one scale.
class Rounder {
 public:
  Rounder(const VirtualNode& node, std::int64_t side, std::int64_t n_steps)
      : node_(node), side_(side), n_steps_(n_steps), n_ring_(4) {
    for (const std::uint32_t n : node.n_side) n_ring_ += n;
  }

  Result<RoundedMesh> run();

 private:
  std::uint32_t n_vertices() const { return static_cast<std::uint32_t>(node_.vertices.size()); }
  // What is inside stays inside, where there is a grid point for it.
  std::int64_t nearest(std::int64_t lattice) const {
    const std::int64_t steps = (2 * lattice * n_steps_ + side_) / (2 * side_);
    return lattice <= 0 || lattice >= side_ || n_steps_ < 2 ? steps : std::clamp<std::int64_t>(steps, 1, n_steps_ - 1);
  }
  Point nearest_scaled(std::uint32_t v) const {
    return {nearest(node_.vertices[v].x) * side_, nearest(node_.vertices[v].y) * side_};
  }
  Point lattice_scaled(std::uint32_t v) const {
    return {node_.vertices[v].x * n_steps_, node_.vertices[v].y * n_steps_};
  }

  std::vector<std::uint32_t> merged_border_vertices() const;
  bool all_positive() const;
  bool is_triangulation() const;
  RoundedMesh result() const;

  // Step by step, for the few tiles that plain rounding would break.
  Result<void> repair(const std::vector<std::uint32_t>& merged);
  bool can_move(std::uint32_t v, const Point& to, std::uint32_t* blocked_by = nullptr) const;
  bool try_move(std::uint32_t v, const Point& to);
  bool try_nearby(std::uint32_t v);
  bool remove(std::uint32_t v);
  bool clip_ears(std::vector<std::uint32_t> polygon);
  void add_triangle(const Triangle& t);

  const VirtualNode& node_;
  std::int64_t side_, n_steps_;
  std::uint32_t n_ring_;
  std::vector<Point> at_;
  std::vector<Triangle> triangles_;
  std::vector<bool> alive_;                           // per triangle
  std::vector<std::vector<std::uint32_t>> incident_;  // per vertex: its triangles
};

std::vector<std::uint32_t> Rounder::merged_border_vertices() const {
  std::vector<std::uint32_t> merged;
  std::uint32_t first = 1;
  for (std::size_t b = 0; b < 4; ++b) {
    const std::uint32_t n = node_.n_side[b];
    std::int64_t last = 0;
    for (std::uint32_t k = 0; k < n; ++k) {
      const std::uint32_t v = first + (b >= 2 ? n - 1 - k : k);  // stored direction: W->E or S->N
      const std::int64_t q = nearest(b % 2 == 0 ? node_.vertices[v].x : node_.vertices[v].y);
      if (q <= last || q >= n_steps_) {
        merged.push_back(v);
      } else {
        last = q;
      }
    }
    first += n + 1;
  }
  return merged;
}

bool Rounder::all_positive() const {
  return std::all_of(triangles_.begin(), triangles_.end(),
                     [&](const Triangle& t) { return orientation(at_[t[0]], at_[t[1]], at_[t[2]]) > 0; });
}

// Every directed edge once; those without a reverse are the ring's, in order; the areas add up to the square.
bool Rounder::is_triangulation() const {
  std::unordered_map<std::uint64_t, bool> edges;
  edges.reserve(3 * triangles_.size());
  const auto code = [](std::uint64_t a, std::uint64_t b) { return a << 32 | b; };
  Int128 doubled_area = 0;
  for (const Triangle& t : triangles_) {
    const Point &a = at_[t[0]], &b = at_[t[1]], &c = at_[t[2]];
    doubled_area += Int128{b.x - a.x} * (c.y - a.y) - Int128{b.y - a.y} * (c.x - a.x);
    for (std::size_t k = 0; k < 3; ++k) {
      if (!edges.emplace(code(t[k], t[(k + 1) % 3]), true).second) return false;
    }
  }
  std::size_t n_open = 0;
  for (const auto& [edge, unused] : edges) {
    const std::uint64_t a = edge >> 32, b = edge & 0xffffffffu;
    if (edges.contains(code(b, a))) continue;
    if (a >= n_ring_ || b != (a + 1) % n_ring_) return false;
    ++n_open;
  }
  const Int128 square = Int128{side_ * n_steps_} * (side_ * n_steps_);
  return n_open == n_ring_ && doubled_area == 2 * square;
}

RoundedMesh Rounder::result() const {
  RoundedMesh mesh;
  mesh.positions.reserve(at_.size());
  for (const Point& p : at_) {
    mesh.positions.push_back({static_cast<std::uint16_t>(p.x / side_), static_cast<std::uint16_t>(p.y / side_)});
  }
  for (std::size_t t = 0; t < triangles_.size(); ++t) {
    if (alive_.empty() || alive_[t]) mesh.triangles.push_back(triangles_[t]);
  }
  return mesh;
}

Result<RoundedMesh> Rounder::run() {
  if (n_vertices() < n_ring_) return corrupt(node_.key, "fewer vertices than its border has");
  for (const LocalVertex& v : node_.vertices) {
    if (v.x < 0 || v.y < 0 || v.x > side_ || v.y > side_) return corrupt(node_.key, "a vertex lies outside the tile");
  }
  for (const Triangle& t : node_.triangles) {
    for (const std::uint32_t v : t) {
      if (v >= n_vertices()) return corrupt(node_.key, "a triangle names a vertex that does not exist");
    }
  }
  triangles_ = node_.triangles;
  at_.resize(n_vertices());
  const std::vector<std::uint32_t> merged = merged_border_vertices();
  if (merged.empty()) {
    for (std::uint32_t v = 0; v < n_vertices(); ++v) at_[v] = nearest_scaled(v);
    if (all_positive()) return result();
  }
  for (std::uint32_t v = 0; v < n_vertices(); ++v) at_[v] = lattice_scaled(v);
  if (!all_positive() || !is_triangulation()) return corrupt(node_.key, "its triangles do not tile its square");
  if (auto repaired = repair(merged); !repaired) return tl::unexpected(repaired.error());
  return result();
}

void Rounder::add_triangle(const Triangle& t) {
  const auto index = static_cast<std::uint32_t>(triangles_.size());
  triangles_.push_back(t);
  alive_.push_back(true);
  for (const std::uint32_t v : t) incident_[v].push_back(index);
}

// True iff all triangles around v stay positive with v at `to`; else `blocked_by` is one that does not.
bool Rounder::can_move(std::uint32_t v, const Point& to, std::uint32_t* blocked_by) const {
  for (const std::uint32_t index : incident_[v]) {
    const Triangle& t = triangles_[index];
    const auto at = [&](std::size_t k) -> const Point& { return t[k] == v ? to : at_[t[k]]; };
    if (orientation(at(0), at(1), at(2)) > 0) continue;
    if (blocked_by) *blocked_by = index;
    return false;
  }
  return true;
}

bool Rounder::try_move(std::uint32_t v, const Point& to) {
  if (!can_move(v, to)) return false;
  at_[v] = to;
  return true;
}

// The grid points within two steps of the nearest one, by distance from the true position.
bool Rounder::try_nearby(std::uint32_t v) {
  const Point nearest = nearest_scaled(v), truth = lattice_scaled(v);
  std::vector<std::pair<double, Point>> candidates;
  for (int dy = -2; dy <= 2; ++dy) {
    for (int dx = -2; dx <= 2; ++dx) {
      const Point p{nearest.x + dx * side_, nearest.y + dy * side_};
      // A point on the border is never free: the border's edges are all taken by its own vertices.
      if (p.x <= 0 || p.y <= 0 || p.x >= side_ * n_steps_ || p.y >= side_ * n_steps_) continue;
      const double ex = static_cast<double>(p.x - truth.x), ey = static_cast<double>(p.y - truth.y);
      candidates.emplace_back(ex * ex + ey * ey, p);
    }
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const auto& a, const auto& b) { return a.first < b.first; });
  return std::any_of(candidates.begin(), candidates.end(),
                     [&](const auto& candidate) { return try_move(v, candidate.second); });
}

// Triangulates a simple polygon (counter-clockwise, straight angles allowed) by ears. A polygon with four or more
// vertices always has an ear whose closed triangle holds no other vertex; cutting only those leaves no zero-area rest.
bool Rounder::clip_ears(std::vector<std::uint32_t> polygon) {
  std::size_t start = 0;
  while (polygon.size() > 3) {
    const std::size_t n = polygon.size();
    bool cut = false;
    for (std::size_t tried = 0; tried < n && !cut; ++tried) {
      const std::size_t i = (start + tried) % n, before = (i + n - 1) % n, after = (i + 1) % n;
      const Point &a = at_[polygon[before]], &b = at_[polygon[i]], &c = at_[polygon[after]];
      if (orientation(a, b, c) <= 0) continue;
      bool empty = true;
      for (std::size_t k = 0; k < n && empty; ++k) {
        empty = k == before || k == i || k == after || !contains(a, b, c, at_[polygon[k]]);
      }
      if (!empty) continue;
      add_triangle({polygon[before], polygon[i], polygon[after]});
      polygon.erase(polygon.begin() + static_cast<std::ptrdiff_t>(i));
      start = i + 1;  // go on elsewhere: ears in a row would make a fan of slivers
      cut = true;
    }
    if (!cut) return false;
  }
  if (polygon.size() < 3 || orientation(at_[polygon[0]], at_[polygon[1]], at_[polygon[2]]) <= 0) return false;
  add_triangle({polygon[0], polygon[1], polygon[2]});
  return true;
}

// Takes v out and triangulates the hole. For a border vertex the hole is closed along the border.
bool Rounder::remove(std::uint32_t v) {
  std::unordered_map<std::uint32_t, std::uint32_t> next;  // the link of v, counter-clockwise
  std::unordered_map<std::uint32_t, bool> is_end;
  const std::vector<std::uint32_t> around = std::move(incident_[v]);
  incident_[v].clear();
  for (const std::uint32_t index : around) {
    const Triangle& t = triangles_[index];
    const std::size_t k = t[0] == v ? 0 : t[1] == v ? 1 : 2;
    if (!next.emplace(t[(k + 1) % 3], t[(k + 2) % 3]).second) return false;
    is_end[t[(k + 2) % 3]] = true;
  }
  if (around.empty()) return false;
  std::uint32_t first = triangles_[around[0]][0] == v ? triangles_[around[0]][1] : triangles_[around[0]][0];
  if (v < n_ring_) {
    const auto open = std::find_if(next.begin(), next.end(), [&](const auto& e) { return !is_end.contains(e.first); });
    if (open == next.end()) return false;
    first = open->first;
  } else if (!next.contains(first)) {
    return false;
  }
  std::vector<std::uint32_t> polygon = {first};
  for (auto it = next.find(first); it != next.end() && it->second != first; it = next.find(it->second)) {
    polygon.push_back(it->second);
    if (polygon.size() > next.size() + 1) return false;
  }
  if (polygon.size() != next.size() + (v < n_ring_ ? 1u : 0u)) return false;
  for (const std::uint32_t index : around) {
    alive_[index] = false;
    for (const std::uint32_t other : triangles_[index]) {
      if (other != v) std::erase(incident_[other], index);
    }
  }
  return clip_ears(std::move(polygon));
}

Result<void> Rounder::repair(const std::vector<std::uint32_t>& merged) {
  const auto broken = [&] { return corrupt(node_.key, "its triangles do not tile its square"); };
  alive_.assign(triangles_.size(), true);
  incident_.assign(n_vertices(), {});
  for (std::uint32_t t = 0; t < triangles_.size(); ++t) {
    for (const std::uint32_t v : triangles_[t]) incident_[v].push_back(t);
  }
  for (const std::uint32_t v : merged) {
    if (!remove(v)) return broken();
  }

  // Most vertices are free at once; moving them frees others.
  std::vector<std::uint32_t> waiting;
  for (std::uint32_t v = 0; v < n_vertices(); ++v) {
    if (!incident_[v].empty()) waiting.push_back(v);
  }
  for (std::size_t before = waiting.size() + 1; !waiting.empty() && waiting.size() < before;) {
    before = waiting.size();
    std::erase_if(waiting, [&](std::uint32_t v) { return try_move(v, nearest_scaled(v)); });
  }
  // A border vertex must go to its grid point, whatever this costs inside: a triangle in its way always has an
  // interior vertex, because the border keeps its order.
  for (const std::uint32_t v : waiting) {
    if (v >= n_ring_) continue;
    for (std::uint32_t blocking = 0; !can_move(v, nearest_scaled(v), &blocking);) {
      const Triangle& t = triangles_[blocking];
      const auto inner = std::find_if(t.begin(), t.end(), [&](std::uint32_t w) { return w >= n_ring_; });
      if (inner == t.end() || !remove(*inner)) return broken();
    }
    at_[v] = nearest_scaled(v);
  }
  for (const std::uint32_t v : waiting) {
    if (v < n_ring_ || incident_[v].empty()) continue;
    if (!try_nearby(v) && !remove(v)) return broken();
  }
  return {};
}

}  // namespace

Result<RoundedMesh> round_to_grid(const VirtualNode& node, std::int64_t side, std::int64_t n_steps) {
  return Rounder(node, side, n_steps).run();
}

}  // namespace tind
