// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/mesh.hpp"

#include <algorithm>
#include <array>
#include <cassert>

#include "core/incircle.hpp"

namespace tind {
namespace {

__extension__ using Int128 = __int128;

// In-circle tests are exact in 128 bits while differences of coordinates are below this.
constexpr double kExactInt128 = 0x1p30;

std::int64_t whole(double v) { return static_cast<std::int64_t>(v); }

// Four points on a circle: t lies strictly inside the one through p, q and r, counter-clockwise, iff the angles that r
// and t see the chord pq under add up to more than 180 degrees: sine and cosine of each, times the same two lengths.
struct Angles {
  double t_sine, t_cosine, r_sine, r_cosine;

  Angles(const Mesh::Vertex& p, const Mesh::Vertex& q, const Mesh::Vertex& r, const Mesh::Vertex& t) {
    const double qpx = q.x - p.x, qpy = q.y - p.y, rpx = r.x - p.x, rpy = r.y - p.y, tpx = t.x - p.x, tpy = t.y - p.y;
    t_sine = qpx * tpy - qpy * tpx;
    r_sine = qpx * rpy - qpy * rpx;
    t_cosine = tpx * (t.x - q.x) + tpy * (t.y - q.y);
    r_cosine = rpx * (r.x - q.x) + rpy * (r.y - q.y);
  }
};

// Sides up to 2^26: all four numbers are whole and below 2^53.
bool is_in_near_circle(const Mesh::Vertex& p, const Mesh::Vertex& q, const Mesh::Vertex& r, const Mesh::Vertex& t) {
  const Angles a(p, q, r, t);
  const double left = a.t_sine * a.r_cosine, right = a.t_cosine * a.r_sine;
  if (std::abs(left - right) > 0x1p-51 * (std::abs(left) + std::abs(right))) return left > right;
  return Int128{whole(a.t_sine)} * whole(a.r_cosine) > Int128{whole(a.t_cosine)} * whole(a.r_sine);
}

bool is_in_far_circle(const Mesh::Vertex& p, const Mesh::Vertex& q, const Mesh::Vertex& r, const Mesh::Vertex& t) {
  const Angles a(p, q, r, t);
  const double value = a.t_sine * a.r_cosine - a.t_cosine * a.r_sine;
  double m = 0;  // largest difference of coordinates
  for (const double d :
       {q.x - p.x, q.y - p.y, r.x - p.x, r.y - p.y, t.x - p.x, t.y - p.y, t.x - q.x, t.y - q.y, r.x - q.x, r.y - q.y}) {
    m = std::max(m, std::abs(d));
  }
  // Each factor is at most 2 m^2 and wrong by at most 4 u m^2, u = 2^-53: the value by 48 u m^4 and a little.
  const double error = 0x1p-47 * (m * m) * (m * m);
  if (value > error) return true;
  if (value < -error) return false;
  if (m > kExactInt128) return is_in_circle_exact(p.x, p.y, q.x, q.y, r.x, r.y, t.x, t.y);
  const auto sine = [&](const Mesh::Vertex& v) {
    return Int128{whole(q.x - p.x)} * whole(v.y - p.y) - Int128{whole(q.y - p.y)} * whole(v.x - p.x);
  };
  const auto cosine = [&](const Mesh::Vertex& v) {
    return Int128{whole(v.x - p.x)} * whole(v.x - q.x) + Int128{whole(v.y - p.y)} * whole(v.y - q.y);
  };
  return sine(t) * cosine(r) > cosine(t) * sine(r);
}

}  // namespace

double Mesh::far_doubled_area(const Vertex& a, const Vertex& b, const Vertex& c) {
  return static_cast<double>(Int128{whole(b.x - a.x)} * whole(c.y - a.y) - Int128{whole(b.y - a.y)} * whole(c.x - a.x));
}

void Mesh::reset(double side, std::int32_t n_reserved) {
  side_ = side;
  products_are_exact_ = side <= 0x1p26;
  walk_ = 0;
  vertices_.assign(static_cast<std::size_t>(n_reserved), Vertex{});
  faces_.clear();
}

void Mesh::insert_corners(std::int32_t sw, std::int32_t se, std::int32_t ne, std::int32_t nw) {
  const std::int32_t f = add_face(sw, se, nw), g = add_face(ne, nw, se);
  link(4 * f, 4 * g, false);
}

std::int32_t Mesh::add_vertex(double x, double y, std::int32_t z) {
  vertices_.push_back({x, y, z, kNone});
  return n_vertices() - 1;
}

std::int32_t Mesh::add_face(std::int32_t a, std::int32_t b, std::int32_t c) {
  const std::int32_t f = n_faces();
  faces_.push_back({{a, b, c}, 0, {kNone, kNone, kNone}, 0});
  for (const std::int32_t v : {a, b, c}) vertex(v).face = f;
  return f;
}

void Mesh::set_fixed(std::int32_t edge, bool fixed) {
  for (const std::int32_t e : {edge, twin_of(edge)}) {
    if (e == kNone) continue;
    std::uint32_t& bits = faces_[static_cast<std::size_t>(e >> 2)].fixed;
    bits = fixed ? bits | 1u << (e & 3) : bits & ~(1u << (e & 3));
  }
}

// Makes two edges one, seen from both sides.
void Mesh::link(std::int32_t edge, std::int32_t twin, bool fixed) {
  const auto set = [&](std::int32_t e, std::int32_t to) {
    if (e == kNone) return;
    Face& f = faces_[static_cast<std::size_t>(e >> 2)];
    f.twin[e & 3] = to;
    f.fixed = fixed ? f.fixed | 1u << (e & 3) : f.fixed & ~(1u << (e & 3));
  };
  set(edge, twin);
  set(twin, edge);
}

Mesh::Location Mesh::locate(double x, double y, std::int32_t hint) {
  std::int32_t f = hint;
  int from = 3;  // the edge that the walk came in by: the point is on this side of it
  for (;;) {
    const Face& at = face(f);
    // Beside constraints the triangulation is not Delaunay and a walk may go in circles: no fixed order of edges then
    // is right for ever.
    walk_ = walk_ * 1664525u + 1013904223u;
    int i = static_cast<int>((walk_ >> 16) % 3);
    int zeros = 0, zero[3] = {};
    std::int32_t go = 4;
    for (int k = 0; k < 3; ++k, i = next(i)) {
      if (i == from) continue;
      const double side = orientation(vertex(at.v[next(i)]), vertex(at.v[before(i)]), x, y);
      if (side < 0) {
        go = i;
        break;
      }
      if (side == 0) zero[zeros++] = i;
    }
    if (go == 4) {
      if (zeros == 0) return {Place::kInFace, 4 * f};
      if (zeros == 1) return {Place::kOnEdge, 4 * f + zero[0]};
      return {Place::kOnVertex, 4 * f + 3 - zero[0] - zero[1]};
    }
    const std::int32_t across = at.twin[go];
    assert(across != kNone && "a point outside the square");
    f = across >> 2;
    from = across & 3;
  }
}

void Mesh::insert(std::int32_t v, const Location& where) {
  const std::int32_t f = face_of(where.edge);
  const int i = index_of(where.edge);
  const Face old = face(f);
  const auto fixed = [](const Face& t, int k) { return (t.fixed >> k & 1u) != 0; };
  if (where.place == Place::kInFace) {
    const std::int32_t a = old.v[0], b = old.v[1], c = old.v[2];
    const std::int32_t g = add_face(v, b, c), h = add_face(v, c, a);
    faces_[static_cast<std::size_t>(f)] = {{v, a, b}, 0, {kNone, kNone, kNone}, 0};
    vertex(a).face = vertex(b).face = vertex(v).face = f;
    link(4 * f, old.twin[2], fixed(old, 2));
    link(4 * g, old.twin[0], fixed(old, 0));
    link(4 * h, old.twin[1], fixed(old, 1));
    link(4 * f + 1, 4 * g + 2, false);
    link(4 * g + 1, 4 * h + 2, false);
    link(4 * h + 1, 4 * f + 2, false);
  } else {
    assert(where.place == Place::kOnEdge);
    const std::int32_t p = old.v[i], a = old.v[next(i)], b = old.v[before(i)], across = old.twin[i];
    const bool cut = fixed(old, i);
    const std::int32_t last = add_face(v, b, p);
    faces_[static_cast<std::size_t>(f)] = {{v, p, a}, 0, {kNone, kNone, kNone}, 0};
    vertex(p).face = vertex(a).face = f;
    link(4 * f, old.twin[before(i)], fixed(old, before(i)));
    link(4 * last, old.twin[next(i)], fixed(old, next(i)));
    link(4 * last + 1, 4 * f + 2, false);
    if (across == kNone) {
      link(4 * f + 1, kNone, cut);
      link(4 * last + 2, kNone, cut);
    } else {
      const std::int32_t g = face_of(across);
      const int j = index_of(across);
      const Face other = face(g);
      const std::int32_t q = other.v[j];
      const std::int32_t h = add_face(v, q, b);
      faces_[static_cast<std::size_t>(g)] = {{v, a, q}, 0, {kNone, kNone, kNone}, 0};
      vertex(a).face = vertex(q).face = g;
      link(4 * g, other.twin[next(j)], fixed(other, next(j)));
      link(4 * h, other.twin[before(j)], fixed(other, before(j)));
      link(4 * f + 1, 4 * g + 2, cut);
      link(4 * g + 1, 4 * h + 2, false);
      link(4 * h + 1, 4 * last + 2, cut);
    }
    vertex(v).face = last;  // on a side of the square: the most clockwise one
  }
  make_star_delaunay(v);
}

bool Mesh::must_flip(std::int32_t edge) const {
  const std::int32_t twin = twin_of(edge);
  if (twin == kNone || is_fixed(edge)) return false;
  const Vertex &p = vertex(start_of(edge)), &q = vertex(end_of(edge));
  const Vertex &r = vertex(opposite_of(edge)), &t = vertex(opposite_of(twin));
  return products_are_exact_ ? is_in_near_circle(p, q, r, t) : is_in_far_circle(p, q, r, t);
}

// The other diagonal of the two triangles beside an edge. With p opposite the edge and q beyond it, its face becomes
// (p, start, q), the neighbour (p, q, end).
void Mesh::flip(std::int32_t edge) {
  const std::int32_t twin = twin_of(edge), f = edge >> 2, g = twin >> 2;
  const int i = edge & 3, j = twin & 3;
  const Face near = face(f), far = face(g);
  const std::int32_t p = near.v[i], a = near.v[next(i)], b = near.v[before(i)], q = far.v[j];
  const auto bit = [](const Face& t, int from, int to) { return (t.fixed >> from & 1u) << to; };
  faces_[static_cast<std::size_t>(f)] = {{p, a, q},
                                         bit(far, next(j), 0) | bit(near, before(i), 2),
                                         {far.twin[next(j)], 4 * g + 2, near.twin[before(i)]},
                                         0};
  faces_[static_cast<std::size_t>(g)] = {{p, q, b},
                                         bit(far, before(j), 0) | bit(near, next(i), 1),
                                         {far.twin[before(j)], near.twin[next(i)], 4 * f + 1},
                                         0};
  const auto point_back = [&](std::int32_t e, std::int32_t to) {
    if (e != kNone) faces_[static_cast<std::size_t>(e >> 2)].twin[e & 3] = to;
  };
  point_back(far.twin[next(j)], 4 * f);
  point_back(near.twin[before(i)], 4 * f + 2);
  point_back(far.twin[before(j)], 4 * g);
  point_back(near.twin[next(i)], 4 * g + 1);
  vertex(a).face = f;
  vertex(b).face = g;
}

// Once around a new vertex, which is the first of all its faces: a flip adds the next face to go to.
void Mesh::make_star_delaunay(std::int32_t v) {
  const std::int32_t first = vertex(v).face;
  for (std::int32_t f = first;;) {
    while (must_flip(4 * f)) flip(4 * f);
    const std::int32_t e = face(f).twin[1];
    if (e == kNone || (e >> 2) == first) return;
    f = e >> 2;
  }
}

void Mesh::make_delaunay(std::vector<std::int32_t>& edges) {
  while (!edges.empty()) {
    const std::int32_t edge = edges.back();
    edges.pop_back();
    if (!must_flip(edge)) continue;
    const std::int32_t f = edge >> 2, g = twin_of(edge) >> 2;
    flip(edge);
    edges.insert(edges.end(), {4 * f, 4 * f + 2, 4 * g, 4 * g + 1});
  }
}

void Mesh::release(std::int32_t edge) {
  set_fixed(edge, false);
  std::vector<std::int32_t> edges = {edge};
  make_delaunay(edges);
}

std::int32_t Mesh::find_edge(std::int32_t a, std::int32_t b) const {
  std::int32_t found = kNone;
  for_faces_around(a, [&](std::int32_t f, int i) {
    if (face(f).v[next(i)] == b) found = 4 * f + before(i);
    if (face(f).v[before(i)] == b && found == kNone) found = 4 * f + next(i);
  });
  return found;
}

// From one vertex straight on towards another, to the first vertex on the way: `reached`. `crossed`: the edges in
// between, right end first. False where one of them is a constraint.
bool Mesh::step_along(std::int32_t from, std::int32_t to, std::vector<std::pair<std::int32_t, std::int32_t>>& crossed,
                      std::int32_t& reached) const {
  crossed.clear();
  reached = kNone;
  const Vertex &a = vertex(from), &b = vertex(to);
  const auto side_of = [&](std::int32_t v) { return orientation(a, b, vertex(v).x, vertex(v).y); };
  const auto is_ahead = [&](std::int32_t v) {
    return side_of(v) == 0 && ((vertex(v).x - a.x) * (b.x - a.x) > 0 || (vertex(v).y - a.y) * (b.y - a.y) > 0);
  };
  std::int32_t edge = kNone;
  for_faces_around(from, [&](std::int32_t f, int i) {
    const std::int32_t right = face(f).v[next(i)], left = face(f).v[before(i)];
    if (is_ahead(right)) reached = right;
    if (is_ahead(left)) reached = left;
    if (side_of(right) < 0 && side_of(left) > 0) edge = 4 * f + i;
  });
  if (reached != kNone) return true;
  for (;;) {
    assert(edge != kNone);
    if (is_fixed(edge)) return false;
    crossed.emplace_back(start_of(edge), end_of(edge));
    const std::int32_t twin = twin_of(edge), apex = opposite_of(twin);
    const double side = side_of(apex);
    if (side == 0) {
      reached = apex;
      return true;
    }
    edge = (twin & ~3) + (side > 0 ? next(twin & 3) : before(twin & 3));
  }
}

bool Mesh::constrain(std::int32_t a, std::int32_t b) {
  std::vector<std::pair<std::int32_t, std::int32_t>> crossed;
  std::int32_t reached = kNone;
  for (std::int32_t at = a; at != b; at = reached) {
    if (!step_along(at, b, crossed, reached)) return false;
  }
  for (std::int32_t at = a; at != b; at = reached) {
    step_along(at, b, crossed, reached);
    if (!clear_way(at, reached, crossed)) return false;
  }
  return true;
}

// Flips the edges that cross the way between two vertices until the way is an edge (Sloan 1993, "A fast algorithm for
// generating constrained Delaunay triangulations", Computers and Structures 47), then makes it a constraint. Every
// round of the queue flips an edge; should the edges still cross after many rounds, the way is given up.
bool Mesh::clear_way(std::int32_t from, std::int32_t to, std::vector<std::pair<std::int32_t, std::int32_t>>& crossed) {
  const std::size_t most_steps = 64 + 16 * crossed.size() * crossed.size();
  std::vector<std::pair<std::int32_t, std::int32_t>> made;
  const auto side_of = [&](std::int32_t v) {
    return v == from || v == to ? 0.0 : orientation(vertex(from), vertex(to), vertex(v).x, vertex(v).y);
  };
  std::size_t at = 0;
  for (; at < crossed.size() && at < most_steps; ++at) {
    const auto [u, w] = crossed[at];
    const std::int32_t edge = find_edge(u, w), twin = twin_of(edge);
    const std::int32_t p = opposite_of(edge), q = opposite_of(twin), s = start_of(edge), e = end_of(edge);
    const auto is_left = [&](std::int32_t i, std::int32_t j, std::int32_t k) {
      return orientation(vertex(i), vertex(j), vertex(k).x, vertex(k).y) > 0;
    };
    if (!is_left(p, s, q) || !is_left(q, e, p)) {  // not convex
      crossed.emplace_back(u, w);
      continue;
    }
    flip(edge);
    const double p_side = side_of(p), q_side = side_of(q);
    if ((p_side > 0 && q_side < 0) || (p_side < 0 && q_side > 0)) {
      crossed.emplace_back(p, q);
    } else {
      made.emplace_back(p, q);
    }
  }
  const std::int32_t way = find_edge(from, to);
  if (way != kNone) set_fixed(way, true);
  if (at < crossed.size()) made.insert(made.end(), crossed.begin() + static_cast<std::ptrdiff_t>(at), crossed.end());
  std::vector<std::int32_t> edges;
  for (const auto& [u, w] : made) {
    const std::int32_t edge = find_edge(u, w);
    if (edge != kNone) edges.push_back(edge);
  }
  make_delaunay(edges);
  return way != kNone;
}

}  // namespace tind
