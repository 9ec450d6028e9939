// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <span>

namespace tind {

/// An irregular sample of a surface. Plan coordinates in any one unit, the same for both axes.
struct SurfaceSite {
  double x = 0, y = 0;
  float height_m = 0;
};

/// A regular window of posts: post (r, c) lies at (x0 + c * step, y0 + r * step); row-major.
struct PostRaster {
  double x0 = 0, y0 = 0, step = 1;
  std::int64_t n_rows = 0, n_cols = 0;
};

/// Heights at the posts of `window`, linear in the triangles of the sites' Delaunay triangulation. A post is NaN where
/// no triangle whose circumscribed circle has a radius of at most `max_radius` contains it, so the posts with a height
/// fill the sites' alpha shape (Edelsbrunner, Kirkpatrick, Seidel 1983).
///
/// A circle of such a triangle reaches at most 2 max_radius from a post inside the triangle: two sets of sites that
/// agree that far around a window agree in its heights, but for the diagonal of four or more sites on exactly one
/// circle. There the choice depends on the sites given, not on their order.
///
/// `sites`: no two at one position, finite. `heights_m`: n_rows * n_cols. Pure and thread safe. Built into
/// tind_triangulator, for CGAL.
void interpolate_posts(std::span<const SurfaceSite> sites, const PostRaster& window, double max_radius,
                       std::span<float> heights_m);

}  // namespace tind
