// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/incircle.hpp"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>

namespace tind {

bool is_in_circle_exact(double px, double py, double qx, double qy, double rx, double ry, double tx, double ty) {
  using Point = CGAL::Exact_predicates_inexact_constructions_kernel::Point_2;
  return CGAL::side_of_oriented_circle(Point(px, py), Point(qx, qy), Point(rx, ry), Point(tx, ty)) ==
         CGAL::ON_POSITIVE_SIDE;
}

}  // namespace tind
