// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/triangulator_guard.hpp"

#include <algorithm>
#include <cmath>

namespace tind {

int BorderGuard::border_of(const Mesh::Vertex& a, const Mesh::Vertex& b) const {
  if (a.y == 0 && b.y == 0) return 0;
  if (a.x == side_ && b.x == side_) return 1;
  if (a.y == side_ && b.y == side_) return 2;
  return 3;
}

Guard BorderGuard::of_face(const Mesh& mesh, std::int32_t face, double unit_m) const {
  Guard guard;
  double finer_m = 0;  // largest distance of a finer border from B_L
  int n_edges = 0;
  std::int32_t opposite = 0;
  for (int i = 0; i < 3; ++i) {
    const std::int32_t edge = 4 * face + i;
    if (mesh.twin_of(edge) != Mesh::kNone) continue;
    ++n_edges;
    opposite = mesh.opposite_of(edge);
    const Mesh::Vertex &a = mesh.vertex(mesh.start_of(edge)), &b = mesh.vertex(mesh.end_of(edge));
    const int border = border_of(a, b);
    const auto& knots = (*envelopes_)[static_cast<std::size_t>(border)];
    const bool along_x = border % 2 == 0;
    const double low = along_x ? std::min(a.x, b.x) : std::min(a.y, b.y);
    const double high = along_x ? std::max(a.x, b.x) : std::max(a.y, b.y);
    auto knot =
        std::upper_bound(knots.begin(), knots.end(), low, [](double t, const EnvelopeKnot& k) { return t < k.t; });
    for (; knot != knots.end() && knot->t < high; ++knot) {
      finer_m = std::max({finer_m, knot->high_m - knot->own_m, knot->own_m - knot->low_m});
    }
    guard.border = border;
  }
  if (finer_m == 0) return guard;
  if (n_edges == 2) {
    guard.extra_m += finer_m;
    return guard;
  }
  const Mesh::Vertex& apex = mesh.vertex(opposite);
  guard.kind = Guard::Kind::kFan;
  guard.finer_m = finer_m;
  guard.apex_m = static_cast<double>(apex.z) * unit_m;
  guard.apex_along = guard.border % 2 == 0 ? apex.x : apex.y;
  guard.apex_across = guard.border == 0   ? apex.y
                      : guard.border == 1 ? side_ - apex.x
                      : guard.border == 2 ? side_ - apex.y
                                          : apex.x;
  return guard;
}

double BorderGuard::fan_error(const Guard& guard, double x, double y, double height_m) const {
  const double along = guard.border % 2 == 0 ? x : y;
  const double across = guard.border == 0 ? y : guard.border == 1 ? side_ - x : guard.border == 2 ? side_ - y : x;
  const double lambda = std::clamp(across / guard.apex_across, 0.0, 1.0);  // weight of the apex
  if (lambda >= 1) return std::abs(guard.apex_m - height_m);
  const double t = (along - lambda * guard.apex_along) / (1 - lambda);
  const auto& knots = (*envelopes_)[static_cast<std::size_t>(guard.border)];
  auto after = std::upper_bound(knots.begin(), knots.end(), t, [](double v, const EnvelopeKnot& k) { return v < k.t; });
  if (after == knots.begin()) ++after;
  if (after == knots.end()) --after;
  const EnvelopeKnot &a = *(after - 1), &b = *after;
  const double w = std::clamp((t - a.t) / (b.t - a.t), 0.0, 1.0);
  const double high = a.high_m + w * (b.high_m - a.high_m), low = a.low_m + w * (b.low_m - a.low_m);
  const double apex = lambda * guard.apex_m;
  return std::max(std::abs(apex + (1 - lambda) * high - height_m), std::abs(apex + (1 - lambda) * low - height_m));
}

}  // namespace tind
