// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/mesh.hpp"

#include <algorithm>
#include <cmath>
#include <functional>

#include <gtest/gtest.h>

#include "tests/core/mesh_oracle.hpp"
#include "tests/support/test_field.hpp"

namespace tind::test {
namespace {

using Points = std::vector<std::array<double, 2>>;
using Lines = std::vector<std::pair<int, int>>;

PlainMesh plain(const Mesh& mesh) {
  PlainMesh out;
  for (std::int32_t v = 0; v < mesh.n_vertices(); ++v) out.points.push_back({mesh.vertex(v).x, mesh.vertex(v).y});
  for (std::int32_t f = 0; f < mesh.n_faces(); ++f) {
    out.triangles.push_back({mesh.face(f).v[0], mesh.face(f).v[1], mesh.face(f).v[2]});
    for (std::int32_t e = 4 * f; e < 4 * f + 3; ++e) {
      if (!mesh.is_fixed(e)) continue;
      out.constraints.emplace(std::min(mesh.start_of(e), mesh.end_of(e)), std::max(mesh.start_of(e), mesh.end_of(e)));
    }
  }
  return out;
}

// What is wrong with how faces and vertices point at each other.
std::string wrong_links(const Mesh& mesh) {
  for (std::int32_t f = 0; f < mesh.n_faces(); ++f) {
    for (std::int32_t e = 4 * f; e < 4 * f + 3; ++e) {
      const std::int32_t t = mesh.twin_of(e);
      if (t == Mesh::kNone) continue;
      if (mesh.twin_of(t) != e || mesh.start_of(t) != mesh.end_of(e) || mesh.end_of(t) != mesh.start_of(e)) {
        return "twins do not match";
      }
      if (mesh.is_fixed(t) != mesh.is_fixed(e)) return "a constraint has one side";
    }
  }
  for (std::int32_t v = 0; v < mesh.n_vertices(); ++v) {
    int n = 0, expected = 0;
    bool all_have_it = true;
    mesh.for_faces_around(v, [&](std::int32_t f, int i) {
      ++n;
      all_have_it = all_have_it && mesh.face(f).v[i] == v;
    });
    for (std::int32_t f = 0; f < mesh.n_faces(); ++f) {
      expected += std::count(mesh.face(f).v, mesh.face(f).v + 3, v) > 0;
    }
    if (n != expected || !all_have_it) return "the faces around a vertex are not all there";
  }
  return "";
}

// The points in a square, its corners first; constraints that do not fit are dropped from `lines`.
Mesh mesh_of(double side, const Points& points, Lines& lines) {
  Mesh mesh;
  mesh.reset(side, 4);
  for (int v = 0; v < 4; ++v) {
    mesh.vertex(v).x = points[static_cast<std::size_t>(v)][0];
    mesh.vertex(v).y = points[static_cast<std::size_t>(v)][1];
  }
  mesh.insert_corners(0, 1, 2, 3);
  std::int32_t hint = 0;
  for (std::size_t k = 4; k < points.size(); ++k) {
    const Mesh::Location where = mesh.locate(points[k][0], points[k][1], hint);
    EXPECT_NE(where.place, Mesh::Place::kOnVertex);
    const std::int32_t v = mesh.add_vertex(points[k][0], points[k][1], 0);
    mesh.insert(v, where);
    hint = mesh.vertex(v).face;
  }
  std::erase_if(lines, [&](const auto& line) {
    const PlainMesh before = plain(mesh);
    if (mesh.constrain(line.first, line.second)) return false;
    EXPECT_EQ(plain(mesh).triangles, before.triangles);  // what is left out leaves no trace
    EXPECT_EQ(plain(mesh).constraints, before.constraints);
    return true;
  });
  return mesh;
}

Points square(double side) { return {{0, 0}, {side, 0}, {side, side}, {0, side}}; }

// Random points of a square without repeats; `at` maps two numbers in [0, 1) to a point.
Points scattered(double side, int n, std::uint64_t seed,
                 const std::function<std::array<double, 2>(double, double)>& at) {
  Points points = square(side);
  std::set<std::array<double, 2>> seen(points.begin(), points.end());
  for (int k = 0; k < n; ++k) {
    const auto p = at(noise(seed, k, 0), noise(seed, k, 1));
    if (seen.insert(p).second) points.push_back(p);
  }
  return points;
}

Lines random_lines(std::size_t n_points, int n, std::uint64_t seed) {
  Lines lines;
  for (int k = 0; k < n; ++k) {
    const auto end = [&](int which) { return static_cast<int>(noise(seed, k, which) * static_cast<double>(n_points)); };
    if (end(7) != end(8)) lines.emplace_back(end(7), end(8));
  }
  return lines;
}

std::set<std::pair<int, int>> edges_of(const PlainMesh& mesh) {
  std::set<std::pair<int, int>> edges;
  for (const auto& t : mesh.triangles) {
    for (std::size_t k = 0; k < 3; ++k) {
      edges.emplace(std::min(t[k], t[(k + 1) % 3]), std::max(t[k], t[(k + 1) % 3]));
    }
  }
  return edges;
}

struct Shape {
  const char* name;
  double side;
  std::function<std::array<double, 2>(double, double)> at;
};

// Sides from tiles whose posts are a few steps apart to the largest there are.
std::vector<Shape> shapes() {
  const auto whole = [](double v) { return std::floor(v); };
  std::vector<Shape> out;
  for (const double side : {1024.0, 0x1p16, 0x1p26, 0x1p31, 0x1p45}) {
    out.push_back({"anywhere", side, [=](double u, double v) {
                     return std::array{whole(u * (side + 1)), whole(v * (side + 1))};
                   }});
    out.push_back({"on a grid", side, [=](double u, double v) {
                     return std::array{whole(u * 17) * side / 16, whole(v * 17) * side / 16};
                   }});
    out.push_back({"on the sides", side, [=](double u, double v) {
                     const double t = whole(u * side);
                     return v < 0.25   ? std::array{t, 0.0}
                            : v < 0.5  ? std::array{t, side}
                            : v < 0.75 ? std::array{0.0, t}
                                       : std::array{side, t};
                   }});
    out.push_back({"on a line", side, [=](double u, double v) {
                     const double t = whole(u * side);
                     return v < 0.9 ? std::array{t, t} : std::array{t, whole(v * side)};
                   }});
    out.push_back({"close together", side, [=](double u, double v) {
                     return std::array{side / 2 + whole(u * 40), side / 2 + whole(v * 40)};
                   }});
  }
  return out;
}

TEST(Mesh, IsDelaunayWhereverThePointsLie) {
  for (const Shape& shape : shapes()) {
    const Points points = scattered(shape.side, 300, 5, shape.at);
    Lines none;
    const Mesh mesh = mesh_of(shape.side, points, none);
    EXPECT_EQ(wrong_with(plain(mesh), shape.side), "") << shape.name << ", side " << shape.side;
    EXPECT_EQ(wrong_links(mesh), "") << shape.name << ", side " << shape.side;
  }
}

TEST(Mesh, HasTheEdgesThatCgalHas) {
  for (const double side : {0x1p16, 0x1p26, 0x1p45}) {
    const Points points = scattered(side, 500, 6, [=](double u, double v) {
      return std::array{std::floor(u * side), std::floor(v * side)};
    });
    Lines lines;
    EXPECT_EQ(edges_of(plain(mesh_of(side, points, lines))), edges_by_cgal(points, {})) << side;
    lines = random_lines(points.size(), 40, 3);
    const std::size_t all = lines.size();
    const Mesh mesh = mesh_of(side, points, lines);
    EXPECT_LT(lines.size(), all);  // they do cross
    EXPECT_GT(lines.size(), 8u);
    EXPECT_EQ(edges_of(plain(mesh)), edges_by_cgal(points, lines)) << side;
  }
}

TEST(Mesh, HoldsConstraintsWhereverThePointsLie) {
  for (const Shape& shape : shapes()) {
    for (std::uint64_t seed = 1; seed <= 3; ++seed) {
      const Points points = scattered(shape.side, 120, seed, shape.at);
      Lines lines = random_lines(points.size(), 60, seed);
      Mesh mesh = mesh_of(shape.side, points, lines);
      EXPECT_EQ(wrong_with(plain(mesh), shape.side), "") << shape.name << ", side " << shape.side;
      EXPECT_EQ(wrong_links(mesh), "") << shape.name << ", side " << shape.side;
      EXPECT_FALSE(lines.empty());
      // Points on top of it afterwards: constraints are cut, not lost.
      const double length_before = [&] {
        double sum = 0;
        for (const auto& [a, b] : plain(mesh).constraints) {
          sum += std::hypot(mesh.vertex(a).x - mesh.vertex(b).x, mesh.vertex(a).y - mesh.vertex(b).y);
        }
        return sum;
      }();
      for (int k = 0; k < 60; ++k) {
        const auto p = shape.at(noise(seed + 50, k, 0), noise(seed + 50, k, 1));
        const Mesh::Location where = mesh.locate(p[0], p[1], 0);
        if (where.place == Mesh::Place::kOnVertex) continue;
        mesh.insert(mesh.add_vertex(p[0], p[1], 0), where);
      }
      EXPECT_EQ(wrong_with(plain(mesh), shape.side), "") << shape.name << ", side " << shape.side;
      double length = 0;
      for (const auto& [a, b] : plain(mesh).constraints) {
        length += std::hypot(mesh.vertex(a).x - mesh.vertex(b).x, mesh.vertex(a).y - mesh.vertex(b).y);
      }
      EXPECT_NEAR(length, length_before, 1e-9 * length_before);
    }
  }
}

TEST(Mesh, IsDelaunayAgainWhenAConstraintIsReleased) {
  const double side = 0x1p16;
  const Points points = scattered(side, 200, 8, [=](double u, double v) {
    return std::array{std::floor(u * side), std::floor(v * side)};
  });
  Lines lines = random_lines(points.size(), 30, 9);
  Mesh mesh = mesh_of(side, points, lines);
  const auto constraints = plain(mesh).constraints;
  EXPECT_NE(edges_of(plain(mesh)), edges_by_cgal(points, {}));
  for (const auto& [a, b] : constraints) mesh.release(mesh.find_edge(a, b));
  EXPECT_EQ(edges_of(plain(mesh)), edges_by_cgal(points, {}));
}

TEST(Mesh, FindsPointsFromAnywhere) {
  const double side = 0x1p20;
  const Points points = scattered(side, 150, 4, [=](double u, double v) {
    return std::array{std::floor(u * 33) * side / 32, std::floor(v * 33) * side / 32};
  });
  Lines lines = random_lines(points.size(), 40, 2);
  Mesh mesh = mesh_of(side, points, lines);
  for (std::int32_t v = 0; v < mesh.n_vertices(); ++v) {
    for (std::int32_t f = 0; f < mesh.n_faces(); f += 7) {
      const Mesh::Location where = mesh.locate(mesh.vertex(v).x, mesh.vertex(v).y, f);
      ASSERT_EQ(where.place, Mesh::Place::kOnVertex);
      ASSERT_EQ(mesh.opposite_of(where.edge), v);
    }
  }
  for (std::int32_t e = 0; e < 4 * mesh.n_faces(); ++e) {
    if ((e & 3) == 3) continue;
    const Mesh::Vertex &a = mesh.vertex(mesh.start_of(e)), &b = mesh.vertex(mesh.end_of(e));
    const Mesh::Location where = mesh.locate((a.x + b.x) / 2, (a.y + b.y) / 2, 0);
    ASSERT_EQ(where.place, Mesh::Place::kOnEdge);
    ASSERT_TRUE(where.edge == e || where.edge == mesh.twin_of(e));
  }
}

TEST(Mesh, KeepsNothingOfTheSquareBefore) {
  const auto at = [](double u, double v) { return std::array{std::floor(u * 4096), std::floor(v * 4096)}; };
  const Points points = scattered(4096, 100, 1, at);
  Lines lines = random_lines(points.size(), 20, 1);
  const Lines wished = lines;
  const PlainMesh fresh = plain(mesh_of(4096, points, lines));
  Mesh mesh;
  for (const int n : {60, 100}) {
    mesh.reset(4096, 4);
    for (int v = 0; v < 4; ++v) {
      mesh.vertex(v).x = points[static_cast<std::size_t>(v)][0];
      mesh.vertex(v).y = points[static_cast<std::size_t>(v)][1];
    }
    mesh.insert_corners(0, 1, 2, 3);
    std::int32_t hint = 0;
    for (std::size_t k = 4; k < points.size() && k < static_cast<std::size_t>(n + 4); ++k) {
      const std::int32_t v = mesh.add_vertex(points[k][0], points[k][1], 0);
      mesh.insert(v, mesh.locate(points[k][0], points[k][1], hint));
      hint = mesh.vertex(v).face;
    }
    if (n == 100) {
      for (const auto& [a, b] : wished) mesh.constrain(a, b);
    }
  }
  EXPECT_EQ(plain(mesh).triangles, fresh.triangles);
  EXPECT_EQ(plain(mesh).constraints, fresh.constraints);
}

TEST(MeshOracle, SeesWhatIsBroken) {
  const double side = 1024;
  const Points points = scattered(side, 40, 2, [=](double u, double v) {
    return std::array{std::floor(u * side), std::floor(v * side)};
  });
  Lines lines = random_lines(points.size(), 4, 2);
  const PlainMesh good = plain(mesh_of(side, points, lines));
  ASSERT_EQ(wrong_with(good, side), "");
  int n_flipped = 0;
  for (std::size_t i = 0; i < good.triangles.size(); ++i) {  // every flip of an edge that may be flipped
    for (std::size_t j = 0; j < i; ++j) {
      for (std::size_t k = 0; k < 3; ++k) {
        const int p = good.triangles[i][k], a = good.triangles[i][(k + 1) % 3], b = good.triangles[i][(k + 2) % 3];
        const auto& t = good.triangles[j];
        const auto at = std::find(t.begin(), t.end(), b);
        if (at == t.end() || t[(static_cast<std::size_t>(at - t.begin()) + 1) % 3] != a) continue;
        const int q = t[(static_cast<std::size_t>(at - t.begin()) + 2) % 3];
        PlainMesh bad = good;
        bad.triangles[i] = {p, a, q};
        bad.triangles[j] = {p, q, b};
        EXPECT_NE(wrong_with(bad, side), "");
        ++n_flipped;
      }
    }
  }
  EXPECT_GT(n_flipped, 50);
  PlainMesh bad = good;
  bad.triangles.pop_back();
  EXPECT_EQ(wrong_with(bad, side), "the areas do not add up");
  bad = good;
  bad.points.push_back({1, 1});
  EXPECT_EQ(wrong_with(bad, side), "a point is in no triangle");
  bad = good;
  std::swap(bad.triangles[3][0], bad.triangles[3][1]);
  EXPECT_EQ(wrong_with(bad, side), "a triangle is turned over");
}

}  // namespace
}  // namespace tind::test
