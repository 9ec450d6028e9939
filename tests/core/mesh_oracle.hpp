// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <set>
#include <string>
#include <utility>
#include <vector>

namespace tind::test {

/// A triangulation as plain lists: what is checked, and what CGAL makes of the same points.
struct PlainMesh {
  std::vector<std::array<double, 2>> points;
  std::vector<std::array<int, 3>> triangles;
  std::set<std::pair<int, int>> constraints;  ///< Edges, the smaller index first.
};

/// What is wrong with it as a constrained Delaunay triangulation of the square 0..side: turned triangles, gaps,
/// overlaps, points that are missing, constraints that are no edges, edges that are not Delaunay. By CGAL's exact
/// predicates. Empty: nothing.
std::string wrong_with(const PlainMesh& mesh, double side);

/// The edges of CGAL's constrained Delaunay triangulation, the smaller index first. `lines`: constraints as pairs of
/// points, which may pass through other points but not cross each other.
std::set<std::pair<int, int>> edges_by_cgal(const std::vector<std::array<double, 2>>& points,
                                            const std::vector<std::pair<int, int>>& lines);

}  // namespace tind::test
