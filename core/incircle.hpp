// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

namespace tind {

/// Whether (tx, ty) lies strictly inside the circle through p, q and r, which turn counter-clockwise: exact for all
/// finite coordinates, slow. In a file of its own: one of the doors to CGAL.
bool is_in_circle_exact(double px, double py, double qx, double qy, double rx, double ry, double tx, double ty);

}  // namespace tind
