// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/border_line.hpp"
#include "core/mesh.hpp"

namespace tind {

/// What tessellation to finer borders may do to a face (DESIGN "Seams", the guard).
struct Guard {
  enum class Kind { kPlane, kFan } kind = Kind::kPlane;
  int border = 0;                          ///< kFan: the border of the one border edge, 0 south .. 3 west.
  double apex_along = 0, apex_across = 0;  ///< kFan: apex, along the border and its distance from it, lattice steps.
  double apex_m = 0;                       ///< kFan: height of the apex.
  double finer_m = 0;                      ///< kFan: largest distance of a finer border from B_L.
  double extra_m = 0;                      ///< Corner triangle: added to the error of every post.
};

/// The borders of a tile as its guard sees them. Does not own the envelopes.
class BorderGuard {
 public:
  using Envelopes = std::array<std::vector<EnvelopeKnot>, 4>;

  void reset(double side, const Envelopes& envelopes) {
    side_ = side;
    envelopes_ = &envelopes;
  }

  /// The guard of a face; `unit_m`: metres per height unit.
  Guard of_face(const Mesh& mesh, std::int32_t face, double unit_m) const;

  /// Error of a post in a virtual triangle over all tessellations: the plane through the apex and any B_g between the
  /// envelope's bounds. `guard` is a fan; position in local lattice steps.
  double fan_error(const Guard& guard, double x, double y, double height_m) const;

 private:
  int border_of(const Mesh::Vertex& a, const Mesh::Vertex& b) const;

  double side_ = 0;
  const Envelopes* envelopes_ = nullptr;
};

}  // namespace tind
