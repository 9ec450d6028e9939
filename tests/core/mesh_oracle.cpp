// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/core/mesh_oracle.hpp"

#include <CGAL/Constrained_Delaunay_triangulation_2.h>
#include <CGAL/Constrained_triangulation_face_base_2.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>

#include <map>

namespace tind::test {
namespace {

__extension__ using Int128 = __int128;
using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Point = Kernel::Point_2;
using Cdt = CGAL::Constrained_Delaunay_triangulation_2<
    Kernel,
    CGAL::Triangulation_data_structure_2<CGAL::Triangulation_vertex_base_with_info_2<int, Kernel>,
                                         CGAL::Constrained_triangulation_face_base_2<Kernel>>,
    CGAL::No_constraint_intersection_requiring_constructions_tag>;

}  // namespace

std::string wrong_with(const PlainMesh& mesh, double side) {
  const auto at = [&](int v) {
    const auto& p = mesh.points[static_cast<std::size_t>(v)];
    return Point(p[0], p[1]);
  };
  std::map<std::pair<int, int>, int> opposite;  // directed edge -> the third corner
  Int128 doubled_area = 0;
  std::set<int> seen;
  for (const auto& t : mesh.triangles) {
    if (CGAL::orientation(at(t[0]), at(t[1]), at(t[2])) != CGAL::LEFT_TURN) return "a triangle is turned over";
    const auto whole = [&](int v, std::size_t k) {
      return static_cast<Int128>(mesh.points[static_cast<std::size_t>(v)][k]);
    };
    doubled_area += (whole(t[1], 0) - whole(t[0], 0)) * (whole(t[2], 1) - whole(t[0], 1)) -
                    (whole(t[1], 1) - whole(t[0], 1)) * (whole(t[2], 0) - whole(t[0], 0));
    for (std::size_t k = 0; k < 3; ++k) {
      seen.insert(t[k]);
      if (!opposite.emplace(std::pair{t[k], t[(k + 1) % 3]}, t[(k + 2) % 3]).second) return "an edge is there twice";
    }
  }
  if (doubled_area != static_cast<Int128>(side) * static_cast<Int128>(side) * 2) return "the areas do not add up";
  if (seen.size() != mesh.points.size()) return "a point is in no triangle";
  for (const auto& [a, b] : mesh.constraints) {
    if (!opposite.contains({a, b}) && !opposite.contains({b, a})) return "a constraint is no edge";
  }
  for (const auto& [edge, apex] : opposite) {
    const auto [a, b] = edge;
    const auto other = opposite.find({b, a});
    if (other == opposite.end()) {
      const Point p = at(a), q = at(b);
      const bool on_side =
          (p.x() == q.x() && (p.x() == 0 || p.x() == side)) || (p.y() == q.y() && (p.y() == 0 || p.y() == side));
      if (!on_side) return "a gap";
      continue;
    }
    if (mesh.constraints.contains({std::min(a, b), std::max(a, b)})) continue;
    if (CGAL::side_of_oriented_circle(at(a), at(b), at(apex), at(other->second)) == CGAL::ON_POSITIVE_SIDE) {
      return "an edge is not Delaunay";
    }
  }
  return "";
}

std::set<std::pair<int, int>> edges_by_cgal(const std::vector<std::array<double, 2>>& points,
                                            const std::vector<std::pair<int, int>>& lines) {
  Cdt cdt;
  std::vector<Cdt::Vertex_handle> vertices;
  for (std::size_t k = 0; k < points.size(); ++k) {
    vertices.push_back(cdt.insert(Point(points[k][0], points[k][1])));
    vertices.back()->info() = static_cast<int>(k);
  }
  for (const auto& [a, b] : lines) {
    cdt.insert_constraint(vertices[static_cast<std::size_t>(a)], vertices[static_cast<std::size_t>(b)]);
  }
  std::set<std::pair<int, int>> edges;
  for (const Cdt::Edge& e : cdt.finite_edges()) {
    const int a = e.first->vertex(Cdt::ccw(e.second))->info(), b = e.first->vertex(Cdt::cw(e.second))->info();
    edges.emplace(std::min(a, b), std::max(a, b));
  }
  return edges;
}

}  // namespace tind::test
