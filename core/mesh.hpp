// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cmath>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

namespace tind {

/// The corners of a triangle in local lattice steps, counter-clockwise.
struct PlanTriangle {
  double x[3], y[3];
};

/// A constrained Delaunay triangulation of a square whose vertices have integer coordinates, 0..side each, side <=
/// 2^45.
///
/// Vertices and faces are numbered from 0 in the order in which they came and never move; nothing is ever removed, so
/// all of 0..n-1 are alive. Storage is kept from one square to the next. All decisions are exact; four points on one
/// circle are left as they are. Not thread safe; two meshes do not share anything.
///
/// An edge is written as the integer 4 * face + i: the edge of `face` opposite its i-th vertex, from vertex i + 1 to
/// vertex i + 2 (modulo 3). kNone stands for the outside of the square, and for "there is none".
class Mesh {
 public:
  static constexpr std::int32_t kNone = -1;

  struct Vertex {
    double x = 0, y = 0;  ///< Whole numbers.
    std::int32_t z = 0;   ///< The caller's.
    std::int32_t face = kNone;
  };
  struct Face {
    std::int32_t v[3];       ///< Counter-clockwise.
    std::uint32_t fixed;     ///< Bit i: edge i is a constraint.
    std::int32_t twin[3];    ///< Edge of the neighbour across edge i, kNone at the square's sides.
    std::uint32_t reserved;  ///< Makes a face 32 bytes.
  };
  enum class Place { kInFace, kOnEdge, kOnVertex };
  struct Location {
    Place place = Place::kInFace;
    std::int32_t edge = 0;  ///< 4 * face + i; i: the edge (kOnEdge) or the vertex (kOnVertex).
  };

  static constexpr std::int32_t face_of(std::int32_t edge) { return edge >> 2; }
  static constexpr int index_of(std::int32_t edge) { return edge & 3; }
  static constexpr int next(int i) { return i == 2 ? 0 : i + 1; }
  static constexpr int before(int i) { return i == 0 ? 2 : i - 1; }

  /// Starts anew with `n_reserved` vertices that are not in the triangulation yet (set them with `vertex`), then makes
  /// the square's two triangles of four of them, counter-clockwise from its south-west corner.
  void reset(double side, std::int32_t n_reserved);
  /// Makes room for so many vertices at least, and their faces.
  void make_room(std::size_t n_vertices) {
    vertices_.reserve(n_vertices);
    faces_.reserve(2 * n_vertices);
  }
  void insert_corners(std::int32_t sw, std::int32_t se, std::int32_t ne, std::int32_t nw);

  std::int32_t n_vertices() const { return static_cast<std::int32_t>(vertices_.size()); }
  std::int32_t n_faces() const { return static_cast<std::int32_t>(faces_.size()); }
  Vertex& vertex(std::int32_t v) { return vertices_[static_cast<std::size_t>(v)]; }
  const Vertex& vertex(std::int32_t v) const { return vertices_[static_cast<std::size_t>(v)]; }
  const Face& face(std::int32_t f) const { return faces_[static_cast<std::size_t>(f)]; }

  std::int32_t start_of(std::int32_t edge) const { return face(edge >> 2).v[next(edge & 3)]; }
  std::int32_t end_of(std::int32_t edge) const { return face(edge >> 2).v[before(edge & 3)]; }
  std::int32_t opposite_of(std::int32_t edge) const { return face(edge >> 2).v[edge & 3]; }
  std::int32_t twin_of(std::int32_t edge) const { return face(edge >> 2).twin[edge & 3]; }
  bool is_fixed(std::int32_t edge) const { return (face(edge >> 2).fixed >> (edge & 3) & 1u) != 0; }
  /// Whether any edge of the face is on a side of the square.
  bool is_at_side(std::int32_t f) const {
    const Face& t = face(f);
    return (t.twin[0] | t.twin[1] | t.twin[2]) < 0;
  }

  PlanTriangle plan_of(std::int32_t f) const {
    const Vertex &a = vertex(face(f).v[0]), &b = vertex(face(f).v[1]), &c = vertex(face(f).v[2]);
    return {{a.x, b.x, c.x}, {a.y, b.y, c.y}};
  }

  /// Appends a vertex that is not in the triangulation yet.
  std::int32_t add_vertex(double x, double y, std::int32_t z);

  /// Where a point of the square lies, walking from face `hint`.
  Location locate(double x, double y, std::int32_t hint);

  /// Inserts vertex `v`, which is not in the triangulation, at a place that `locate` gave for it and that is no vertex.
  /// A constraint on which it lies is cut in two. The faces that have changed are exactly those around v.
  void insert(std::int32_t v, const Location& where);

  /// Calls visit(face, i) for the faces around vertex v, counter-clockwise, v being their i-th vertex.
  template <class Visit>
  void for_faces_around(std::int32_t v, Visit visit) const;

  /// The edge between two vertices, seen from either side; kNone when there is none.
  std::int32_t find_edge(std::int32_t a, std::int32_t b) const;

  /// Makes the straight line between two vertices a chain of constraints (through the vertices that lie on it). False,
  /// and nothing is changed, where it would cross a constraint.
  bool constrain(std::int32_t a, std::int32_t b);
  /// An edge that is there becomes a constraint or stops being one, nothing else changes.
  void set_fixed(std::int32_t edge, bool fixed);
  /// An edge stops being a constraint; edges flip until all are Delaunay again.
  void release(std::int32_t edge);

  /// Twice the area of the triangle of three points, exact but for one rounding; > 0 iff they turn counter-clockwise.
  double doubled_area(const Vertex& a, const Vertex& b, const Vertex& c) const {
    const double left = (b.x - a.x) * (c.y - a.y), right = (b.y - a.y) * (c.x - a.x);
    return products_are_exact_ ? left - right : far_doubled_area(a, b, c);
  }
  /// Sign of the same: > 0 iff c is left of a -> b.
  double orientation(const Vertex& a, const Vertex& b, double cx, double cy) const {
    const double left = (b.x - a.x) * (cy - a.y), right = (b.y - a.y) * (cx - a.x), area = left - right;
    if (products_are_exact_ || std::abs(area) > 0x1p-50 * (std::abs(left) + std::abs(right))) return area;
    return far_doubled_area(a, b, {cx, cy, 0, kNone});
  }

 private:
  static double far_doubled_area(const Vertex& a, const Vertex& b, const Vertex& c);
  bool must_flip(std::int32_t edge) const;
  void flip(std::int32_t edge);
  void link(std::int32_t edge, std::int32_t twin, bool fixed);
  std::int32_t add_face(std::int32_t a, std::int32_t b, std::int32_t c);
  void make_star_delaunay(std::int32_t v);
  void make_delaunay(std::vector<std::int32_t>& edges);
  bool step_along(std::int32_t from, std::int32_t to, std::vector<std::pair<std::int32_t, std::int32_t>>& crossed,
                  std::int32_t& reached) const;
  bool clear_way(std::int32_t from, std::int32_t to, std::vector<std::pair<std::int32_t, std::int32_t>>& crossed);

  double side_ = 0;
  bool products_are_exact_ = true;  // differences of coordinates below 2^26
  std::uint32_t walk_ = 0;          // which edge of a face a walk tries first
  std::vector<Vertex> vertices_;
  std::vector<Face> faces_;
};

template <class Visit>
void Mesh::for_faces_around(std::int32_t v, Visit visit) const {
  const std::int32_t first = vertex(v).face;
  std::int32_t f = first;
  const auto corner = [&](std::int32_t g) { return face(g).v[0] == v ? 0 : face(g).v[1] == v ? 1 : 2; };
  // Clockwise to the square's side, if v lies on it.
  if (vertex(v).x == 0 || vertex(v).y == 0 || vertex(v).x == side_ || vertex(v).y == side_) {
    for (std::int32_t e = face(f).twin[before(corner(f))]; e != kNone; e = face(f).twin[before(corner(f))]) f = e >> 2;
  }
  const std::int32_t start = f;
  for (;;) {
    const int i = corner(f);
    const std::int32_t e = face(f).twin[next(i)];
    visit(f, i);
    if (e == kNone || (e >> 2) == start) return;
    f = e >> 2;
  }
}

}  // namespace tind
