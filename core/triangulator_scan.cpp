// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/triangulator_scan.hpp"

#include <algorithm>
#include <cmath>

#include "core/format/quantized_mesh.hpp"

namespace tind {
namespace {

double nearest_whole(double v) { return static_cast<double>(floor_of(v + 0.5)); }

}  // namespace

void FaceScanner::reset(const HeightField& field, const TileTask& task) {
  field_ = &field;
  task_ = &task;
  side_ = static_cast<double>(field.lattice.tile_side(task.key.level));
  unit_m_ = field.lattice.height_unit_m();
  guard_.reset(side_, task.envelopes);
  n_ring_ = 0;
  for (const auto& border : task.borders) n_ring_ += static_cast<std::int32_t>(border.size());
  given_up_.clear();
  served_step_ = side_ / kQuantizedSteps;
  served_rounding_m_ = served_height_step() / 2;
}

// Bound of the step that quantized-mesh rounds the tile's inner heights to: its range over 32767, up to a power of
// two.
double FaceScanner::served_height_step() const {
  auto [low, high] = posts_.height_range();
  const auto include = [&, this](const LocalVertex& v) {
    const double height_m = static_cast<double>(v.z) * unit_m_;
    low = std::min(low, height_m);
    high = std::max(high, height_m);
  };
  for (const LocalVertex& v : task_->initial) include(v);
  for (const auto& piece : task_->constraints) {
    for (const LocalVertex& v : piece) include(v);
  }
  for (const auto& border : task_->borders) {
    for (const LocalVertex& v : border) include(v);
  }
  const double step = std::exp2(std::ceil(std::log2(std::max(high - low, 0x1p-16) / kQuantizedSteps)));
  return std::min(step, task_->height_step_m);
}

FacePlane FaceScanner::plane_of(std::int32_t face) const {
  const Mesh::Face& f = mesh_.face(face);
  const Mesh::Vertex &a = mesh_.vertex(f.v[0]), &b = mesh_.vertex(f.v[1]), &c = mesh_.vertex(f.v[2]);
  // Exact: slivers on coarse tiles have an area far below the rounding of the products.
  const double per_area = 1 / mesh_.doubled_area(a, b, c);
  const double bx = b.x - a.x, by = b.y - a.y, cx = c.x - a.x, cy = c.y - a.y;
  const double a_m = a.z * unit_m_, bz = b.z * unit_m_ - a_m, cz = c.z * unit_m_ - a_m;
  return {a.x, a.y, a_m, (bz * cy - cz * by) * per_area, (cz * bx - bz * cx) * per_area};
}

// The same plane after quantized-mesh has rounded positions and border heights; the plane itself where that leaves no
// area.
FacePlane FaceScanner::served_plane_of(std::int32_t face, const FacePlane& plane) const {
  const Mesh::Face& f = mesh_.face(face);
  double x[3], y[3], z[3];
  for (int i = 0; i < 3; ++i) {
    const Mesh::Vertex& v = mesh_.vertex(f.v[i]);
    x[i] = nearest_whole(v.x / served_step_) * served_step_;
    y[i] = nearest_whole(v.y / served_step_) * served_step_;
    z[i] = v.z * unit_m_;
    if (f.v[i] < n_ring_) z[i] = round_to_step(z[i], task_->height_step_m);
  }
  const double bx = x[1] - x[0], by = y[1] - y[0], cx = x[2] - x[0], cy = y[2] - y[0];
  const double area = bx * cy - by * cx, bz = z[1] - z[0], cz = z[2] - z[0];
  if (!(area > served_step_ * served_step_ / 2)) return plane;
  return {x[0], y[0], z[0], (bz * cy - cz * by) / area, (cz * bx - bz * cx) / area};
}

// Posts that round to a free lattice point inside the tile. The border line answers for those that round onto it: a
// row of vertices one step inside would make slivers that nothing can hold.
bool FaceScanner::may_become_vertex(std::int32_t face, double x, double y, std::int64_t post) const {
  const double lx = nearest_whole(x), ly = nearest_whole(y);
  if (lx <= 0 || ly <= 0 || lx >= side_ || ly >= side_) return false;
  for (const std::int32_t v : mesh_.face(face).v) {
    if (mesh_.vertex(v).x == lx && mesh_.vertex(v).y == ly) return false;
  }
  return given_up_.empty() || std::find(given_up_.begin(), given_up_.end(), post) == given_up_.end();
}

FaceCandidate FaceScanner::scan(std::int32_t face) const {
  const Mesh::Face& f = mesh_.face(face);
  const FacePlane plane = plane_of(face);
  if (std::min({f.v[0], f.v[1], f.v[2]}) < n_ring_ || posts_.n_points() != 0) return scan_thoroughly(face, plane);

  // First the mesh as it is. Most faces are far within the tolerance or far beyond it.
  const Mesh::Vertex &a = mesh_.vertex(f.v[0]), &b = mesh_.vertex(f.v[1]), &c = mesh_.vertex(f.v[2]);
  const PlanTriangle plan = mesh_.plan_of(face);
  double worst = 0;
  std::int64_t worst_r = 0, worst_c = 0;
  const PostWindow* worst_window = nullptr;
  for (const PostWindow& w : posts_.windows()) {
    if (w.is_base_grid) {
      if (!posts_.is_covered(plan)) return scan_thoroughly(face, plane);
      continue;
    }
    const double z_step = plane.slope_x * w.dx;
    TilePosts::for_rows(plan, w, [&](std::int64_t r, std::int64_t c_first, std::int64_t c_last) {
      const float* heights = posts_.row_heights(w, r);
      const double z = plane.at(w.x(c_first), w.y(r));
      for (std::int64_t col = c_first; col <= c_last; ++col) {
        const double error =
            std::abs(z + z_step * static_cast<double>(col - c_first) - static_cast<double>(heights[col]));
        if (error > worst && (w.all_promised || posts_.row_origins(w, r)[col] != PostOrigin::kInterpolated)) {
          worst = error;
          worst_r = r;
          worst_c = col;
          worst_window = &w;
        }
      }
    });
  }
  if (worst_window == nullptr) return {};
  // Quantized-mesh moves each corner by up to half a step s each way, so edges by s: the numerators N of the slopes
  // change by at most (|bz| + |cz|) s, the doubled area A by at most (|bx| + |by| + |cx| + |cy|) s + 2 s^2. Where that
  // leaves A / 2, slopes stay within twice (|N| + (|bz| + |cz|) s) / A, and the planes differ at a corner, so anywhere,
  // by at most half a step times both slopes.
  const double s = served_step_, area = mesh_.doubled_area(a, b, c);
  const double edges = std::abs(b.x - a.x) + std::abs(b.y - a.y) + std::abs(c.x - a.x) + std::abs(c.y - a.y);
  const double rise = (std::abs(b.z - a.z) + std::abs(c.z - a.z)) * unit_m_;
  if (2 * (edges * s + 2 * s * s) <= area) {
    const double moved = s * (std::abs(plane.slope_x) + std::abs(plane.slope_y) + 2 * rise * s / area);
    if (worst + moved * 1.000001 + served_rounding_m_ <= task_->tolerance_m) return {};
  }
  const std::int64_t post = worst_window->first_index + worst_r * worst_window->n_cols + worst_c;
  if (worst > task_->tolerance_m && may_become_vertex(face, worst_window->x(worst_c), worst_window->y(worst_r), post)) {
    return {static_cast<float>(worst), post};
  }
  return scan_thoroughly(face, plane);
}

// Every post against the plane (or the guard) and the served plane.
FaceCandidate FaceScanner::scan_thoroughly(std::int32_t face, const FacePlane& plane) const {
  const PlanTriangle plan = mesh_.plan_of(face);
  const FacePlane served = served_plane_of(face, plane);
  const Guard guard = mesh_.is_at_side(face) ? guard_.of_face(mesh_, face, unit_m_) : Guard{};
  const auto post_error = [&](double x, double y, double height_m) {
    const double own = guard.kind == Guard::Kind::kFan ? guard_.fan_error(guard, x, y, height_m)
                                                       : std::abs(plane.at(x, y) - height_m) + guard.extra_m;
    return std::max(own, std::abs(served.at(x, y) - height_m) + served_rounding_m_);
  };
  double worst = task_->tolerance_m;
  std::int64_t worst_post = -1;
  const auto consider = [&](double error, double x, double y, std::int64_t post) {
    if (!may_become_vertex(face, x, y, post)) return;
    worst = error;
    worst_post = post;
  };
  for (const PostWindow& w : posts_.windows()) {
    if (w.is_base_grid && (posts_.is_covered(plan) || is_near_base(face, guard))) continue;
    TilePosts::for_rows(plan, w, [&](std::int64_t r, std::int64_t c_first, std::int64_t c_last) {
      const double y = w.y(r);
      const std::int64_t row_index = w.first_index + r * w.n_cols;
      if (w.is_base_grid) {
        for (std::int64_t c = c_first; c <= c_last; ++c) {
          const double x = w.x(c), error = post_error(x, y, field_->base_height_m);
          if (error > worst && !posts_.is_covered(x, y)) consider(error, x, y, row_index + c);
        }
        return;
      }
      const float* heights = posts_.row_heights(w, r);
      const PostOrigin* origins = posts_.row_origins(w, r);
      if (guard.kind == Guard::Kind::kFan) {
        for (std::int64_t c = c_first; c <= c_last; ++c) {
          const double x = w.x(c), error = post_error(x, y, static_cast<double>(heights[c]));
          if (error > worst && origins[c] != PostOrigin::kInterpolated) consider(error, x, y, row_index + c);
        }
        return;
      }
      const double z = plane.at(w.x(c_first), y), z_step = plane.slope_x * w.dx;
      const double z_served = served.at(w.x(c_first), y), served_step = served.slope_x * w.dx;
      for (std::int64_t c = c_first; c <= c_last; ++c) {
        const double along = static_cast<double>(c - c_first), height = static_cast<double>(heights[c]);
        const double error = std::max(std::abs(z + z_step * along - height) + guard.extra_m,
                                      std::abs(z_served + served_step * along - height) + served_rounding_m_);
        if (error > worst && origins[c] != PostOrigin::kInterpolated) consider(error, w.x(c), y, row_index + c);
      }
    });
  }
  posts_.for_points(plan, [&](std::uint32_t k, const TilePoint& p) {
    const double error = post_error(p.x, p.y, p.height_m);
    if (error > worst) consider(error, p.x, p.y, posts_.index_of_point(k));
  });
  if (worst_post < 0) return {};
  return {static_cast<float>(worst), worst_post};
}

// A face whose corners (and finer borders) are within the tolerance of the base height is so everywhere.
bool FaceScanner::is_near_base(std::int32_t face, const Guard& guard) const {
  double largest = 0;
  for (const std::int32_t v : mesh_.face(face).v) {
    largest = std::max(largest, std::abs(mesh_.vertex(v).z * unit_m_ - field_->base_height_m));
  }
  return largest + guard.extra_m <= task_->tolerance_m;
}

}  // namespace tind
