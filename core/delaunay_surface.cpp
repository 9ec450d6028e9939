// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/delaunay_surface.hpp"

#include <CGAL/Delaunay_triangulation_2.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>
#include <vector>

namespace tind {
namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using VertexBase = CGAL::Triangulation_vertex_base_with_info_2<float, Kernel>;
using Delaunay = CGAL::Delaunay_triangulation_2<Kernel, CGAL::Triangulation_data_structure_2<VertexBase>>;
using Face = Delaunay::Face_handle;
using Vertex = Delaunay::Vertex_handle;

constexpr float kVoid = std::numeric_limits<float>::quiet_NaN();

/// South first, then west: arithmetic in this order does not depend on how CGAL numbers a face's vertices.
bool south_west(Vertex a, Vertex b) {
  return std::make_tuple(a->point().y(), a->point().x()) < std::make_tuple(b->point().y(), b->point().x());
}

/// Whether the circle through a triangle's vertices has a radius of at most `max_radius`: |AB||BC||CA| <= 2 R * doubled
/// area, squared.
bool is_small(const Delaunay& dt, Face f, double max_radius) {
  if (dt.is_infinite(f)) return false;
  std::array<Vertex, 3> v = {f->vertex(0), f->vertex(1), f->vertex(2)};
  std::sort(v.begin(), v.end(), south_west);
  const double bx = v[1]->point().x() - v[0]->point().x(), by = v[1]->point().y() - v[0]->point().y();
  const double cx = v[2]->point().x() - v[0]->point().x(), cy = v[2]->point().y() - v[0]->point().y();
  const double area = bx * cy - by * cx;
  const double sides = (bx * bx + by * by) * (cx * cx + cy * cy) * ((cx - bx) * (cx - bx) + (cy - by) * (cy - by));
  return sides <= 4 * max_radius * max_radius * area * area;
}

float on_edge(Vertex a, Vertex b, double x, double y) {
  if (south_west(b, a)) std::swap(a, b);
  const double dx = b->point().x() - a->point().x(), dy = b->point().y() - a->point().y();
  const double t = ((x - a->point().x()) * dx + (y - a->point().y()) * dy) / (dx * dx + dy * dy);
  return static_cast<float>((1 - t) * static_cast<double>(a->info()) + t * static_cast<double>(b->info()));
}

float in_face(Face f, double x, double y) {
  std::array<Vertex, 3> v = {f->vertex(0), f->vertex(1), f->vertex(2)};
  std::sort(v.begin(), v.end(), south_west);
  const double bx = v[1]->point().x() - v[0]->point().x(), by = v[1]->point().y() - v[0]->point().y();
  const double cx = v[2]->point().x() - v[0]->point().x(), cy = v[2]->point().y() - v[0]->point().y();
  const double px = x - v[0]->point().x(), py = y - v[0]->point().y();
  const double area = bx * cy - by * cx;
  const double b = (px * cy - py * cx) / area, c = (bx * py - by * px) / area;
  const double z = static_cast<double>(v[0]->info());
  const double value = z + b * (static_cast<double>(v[1]->info()) - z) + c * (static_cast<double>(v[2]->info()) - z);
  // A sliver's rounding must not leave the range of its vertices.
  const auto [low, high] = std::minmax({v[0]->info(), v[1]->info(), v[2]->info()});
  return std::clamp(static_cast<float>(value), low, high);
}

}  // namespace

void interpolate_posts(std::span<const SurfaceSite> sites, const PostRaster& window, double max_radius,
                       std::span<float> heights_m) {
  assert(heights_m.size() == static_cast<std::size_t>(window.n_rows * window.n_cols));
  std::vector<std::pair<Kernel::Point_2, float>> points;
  points.reserve(sites.size());
  for (const SurfaceSite& s : sites) points.emplace_back(Kernel::Point_2(s.x, s.y), s.height_m);
  std::sort(points.begin(), points.end(), [](const auto& a, const auto& b) {
    return std::make_tuple(a.first.y(), a.first.x()) < std::make_tuple(b.first.y(), b.first.x());
  });
  Delaunay dt(points.begin(), points.end());
  std::fill(heights_m.begin(), heights_m.end(), kVoid);
  if (dt.dimension() < 2) return;
  Face hint;
  for (std::int64_t r = 0; r < window.n_rows; ++r) {
    const double y = window.y0 + static_cast<double>(r) * window.step;
    for (std::int64_t k = 0; k < window.n_cols; ++k) {
      // There and back: the walk from the last face stays short.
      const std::int64_t c = r % 2 == 0 ? k : window.n_cols - 1 - k;
      const double x = window.x0 + static_cast<double>(c) * window.step;
      float& height = heights_m[static_cast<std::size_t>(r * window.n_cols + c)];
      Delaunay::Locate_type where{};
      int i = 0;
      hint = dt.locate(Kernel::Point_2(x, y), where, i, hint);
      if (where == Delaunay::VERTEX) {
        height = hint->vertex(i)->info();
      } else if (where == Delaunay::EDGE) {
        if (is_small(dt, hint, max_radius) || is_small(dt, hint->neighbor(i), max_radius))
          height = on_edge(hint->vertex(Delaunay::ccw(i)), hint->vertex(Delaunay::cw(i)), x, y);
      } else if (where == Delaunay::FACE && is_small(dt, hint, max_radius)) {
        height = in_face(hint, x, y);
      }
    }
  }
}

}  // namespace tind
