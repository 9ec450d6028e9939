// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/triangulator_scan.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/format/quantized_mesh.hpp"
#include "core/registers.hpp"

namespace tind {
namespace {

// A post of a window.
struct PostAt {
  const PostWindow* window = nullptr;
  std::int64_t r = 0, c = 0;

  bool is_after(const PostWindow& w, std::int64_t row, std::int64_t col) const {
    return window == &w && (row < r || (row == r && col < c));
  }
};

// The largest |z + per_col * c - heights[c - c_first]| of c_first, c_first + 1, ...: of the n_fours * 4 posts from
// there on.
TIND_WIDE double largest_of_fours(const float* heights, std::int64_t c_first, std::int64_t n_fours, double z,
                                  double per_col) {
  using Four = double __attribute__((vector_size(32)));
  using FourFloats = float __attribute__((vector_size(16)));
  using FourBits = std::int64_t __attribute__((vector_size(32)));
  const double first = static_cast<double>(c_first);
  Four cols = {first, first + 1, first + 2, first + 3}, most = {0, 0, 0, 0};
  for (const float *at = heights, *end = at + 4 * n_fours; at != end; at += 4, cols += 4.0) {
    FourFloats h;
    __builtin_memcpy(&h, at, sizeof h);
    const Four error = z + per_col * cols - __builtin_convertvector(h, Four);
    const Four size = reinterpret_cast<Four>(reinterpret_cast<FourBits>(error) & INT64_MAX);
    most = size > most ? size : most;
  }
  return std::max(std::max(most[0], most[1]), std::max(most[2], most[3]));
}

// The error of the posts of columns [c_first, c_end) against z + per_col * column: sets `worst` to the largest above it
// and returns its column, -1 when there is none. Of equal errors the western one counts. `heights`, `origins`: from
// c_first on; origins may be null, else interpolated posts are left out.
std::int64_t worst_in_row(const float* heights, std::int64_t c_first, std::int64_t c_end, double z, double per_col,
                          const PostOrigin* origins, double& worst) {
  constexpr std::int64_t kLong = 12;
  std::int64_t found = -1, c = c_first;
  const auto error_at = [&](std::int64_t at) {
    return std::abs(z + per_col * static_cast<double>(at) - static_cast<double>(heights[at - c_first]));
  };
  if (origins == nullptr && c_end - c_first >= kLong) {
    const std::int64_t n_fours = (c_end - c_first) / 4;
    const double largest = largest_of_fours(heights, c_first, n_fours, z, per_col);
    if (largest > worst) {
      worst = largest;
      found = c_first;
      while (error_at(found) != largest) ++found;
    }
    c += 4 * n_fours;
  }
  double col = static_cast<double>(c);
  for (; c < c_end; ++c, ++col) {
    const std::int64_t k = c - c_first;
    const double error = std::abs(z + per_col * col - static_cast<double>(heights[k]));
    if (error > worst && (origins == nullptr || origins[k] != PostOrigin::kInterpolated)) {
      worst = error;
      found = c;
    }
  }
  return found;
}

// TilePosts::for_promising_boxes: all posts are promising.
bool any_post(std::int64_t, std::int64_t, float) { return true; }

// Least own error of posts that the served plane counts for: no limit.
constexpr double kNoLeast = -1;

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
  return plane_through(mesh_.vertex(f.v[0]), mesh_.vertex(f.v[1]), mesh_.vertex(f.v[2]));
}

FacePlane FaceScanner::plane_through(const Mesh::Vertex& a, const Mesh::Vertex& b, const Mesh::Vertex& c) const {
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
    x[i] = served_position(v.x, side_);
    y[i] = served_position(v.y, side_);
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
  if (std::min({f.v[0], f.v[1], f.v[2]}) < n_ring_ || posts_.n_points() != 0) {
    return scan_thoroughly(face, plane, kNoLeast);
  }

  // First the mesh as it is: most faces are far within the tolerance or far beyond it.
  const double tolerance = task_->tolerance_m, moved_m = served_distance(face, plane) + served_rounding_m_;
  const PlanTriangle plan = mesh_.plan_of(face);
  const double least_own_m = std::max(tolerance - moved_m, 0.0);
  const double rounding = posts_.is_restricted() ? 2 * rounding_of(plane) : 0;  // else nobody asks
  double worst = least_own_m;
  PostAt at;
  for (const PostWindow& w : posts_.windows()) {
    if (w.is_base_grid) {
      if (!posts_.is_covered(plan)) return scan_thoroughly(face, plane, kNoLeast);
      continue;
    }
    const double per_col = plane.slope_x * w.dx;
    const TriangleInPosts in(plan, w);
    const WidenedRows rows(TriangleRows(in.u, in.v), w.reach);
    const PlaneOverPosts over = plane_over(plane, w);
    const auto part = [&](std::int64_t r, double z, const float* heights, const PostOrigin* origins,
                          std::int64_t c_begin, std::int64_t c_end) {
      // Blocks come in any order: of equal errors the first post counts.
      double found = at.window == &w ? std::nextafter(worst, 0.0) : worst;
      const std::int64_t c = worst_in_row(heights, c_begin, c_end, z, per_col, origins, found);
      if (c < 0 || (found == worst && !at.is_after(w, r, c))) return;
      worst = found;
      at = {&w, r, c};
    };
    const auto row = [&](std::int64_t r, std::int64_t c_first, std::int64_t c_last) {
      const double z = plane.at(w.x0, w.y(r));
      posts_.for_parts(w, r, c_first, c_last + 1,
                       [&](const float* heights, const PostOrigin* origins, std::int64_t c_begin, std::int64_t c_end) {
                         part(r, z, heights, w.all_promised ? nullptr : origins, c_begin, c_end);
                       });
    };
    const auto strip = [&](const PostStrip& s) {
      const double least = at.window == &w ? std::nextafter(worst, 0.0) : worst;
      const StripWorst found = worst_in_strip(s, rows, over, least);
      if (found.c < 0 || (found.error_m == worst && !at.is_after(w, found.r, found.c))) return;
      worst = found.error_m;
      at = {&w, found.r, found.c};
    };
    posts_.for_promising_boxes(
        in, rows, w, worst,
        [&](const PostBlock& block, const PostBlocks::Extent& e) { return plane_bound(plane, w, block, e); },
        [&](const PostBlocks::Extent& e) {
          if (!w.all_promised || !posts_.for_strips(w, e, strip)) TilePosts::for_rows_in_box(rows, w, e, row);
        },
        [&](std::int64_t r, std::int64_t c, float height_m) {
          return std::abs(plane.at(w.x(c), w.y(r)) - static_cast<double>(height_m)) + rounding >= worst;
        },
        [&](std::int64_t r, std::int64_t c, float height_m) {
          part(r, plane.at(w.x0, w.y(r)), &height_m, nullptr, c, c + 1);
        });
  }
  if (at.window == nullptr) return {};
  const std::int64_t post = at.window->first_index + at.r * at.window->n_cols + at.c;
  if (worst > tolerance && may_become_vertex(face, at.window->x(at.c), at.window->y(at.r), post)) {
    return {static_cast<float>(worst), post};
  }
  return scan_thoroughly(face, plane, least_own_m);
}

// Bound of the distance of the served plane from the face's own, in the face, where no corner is on the border.
// Quantized-mesh moves each corner by up to s / 2, the reach, each way, so edges by s: the numerators N of the slopes
// change by at most (|bz| + |cz|) s, the doubled area A by at most (|bx| + |by| + |cx| + |cy|) s + 2 s^2. Where that
// leaves A / 2, slopes stay within twice (|N| + (|bz| + |cz|) s) / A, and the planes differ at a corner, so anywhere
// between them, by at most half a step times both slopes.
double FaceScanner::served_distance(std::int32_t face, const FacePlane& plane) const {
  const Mesh::Face& f = mesh_.face(face);
  const Mesh::Vertex &a = mesh_.vertex(f.v[0]), &b = mesh_.vertex(f.v[1]), &c = mesh_.vertex(f.v[2]);
  const double s = 2 * posts_.reach(), area = mesh_.doubled_area(a, b, c);
  const double edges = std::abs(b.x - a.x) + std::abs(b.y - a.y) + std::abs(c.x - a.x) + std::abs(c.y - a.y);
  if (2 * (edges * s + 2 * s * s) > area) return task_->tolerance_m;
  const double rise = (std::abs(b.z - a.z) + std::abs(c.z - a.z)) * unit_m_;
  return 1.000001 * s * (std::abs(plane.slope_x) + std::abs(plane.slope_y) + 2 * rise * s / area);
}

// What rounding may do to a plane's value anywhere in the tile.
double FaceScanner::rounding_of(const FacePlane& plane) const {
  return 0x1p-44 * (std::abs(plane.z_a) + side_ * (std::abs(plane.slope_x) + std::abs(plane.slope_y)));
}

// The planes' distance is extreme at the block's corners.
double FaceScanner::plane_bound(const FacePlane& plane, const PostWindow& w, const PostBlock& block,
                                const PostBlocks::Extent& e) const {
  const double origin = plane.at(w.x(e.col), w.y(e.row)) - static_cast<double>(block.origin_m);
  const double per_col = plane.slope_x * w.dx - static_cast<double>(block.per_col_m);
  const double per_row = plane.slope_y * w.dy - static_cast<double>(block.per_row_m);
  const double over_cols = per_col * static_cast<double>(e.n_cols - 1);
  const double over_rows = per_row * static_cast<double>(e.n_rows - 1);
  const double low = origin + std::min(over_cols, 0.0) + std::min(over_rows, 0.0);
  const double high = origin + std::max(over_cols, 0.0) + std::max(over_rows, 0.0);
  const double rounding = rounding_of(plane);
  return std::max(high - static_cast<double>(block.low_m), static_cast<double>(block.high_m) - low) + rounding;
}

// Every post against the plane (or the guard) and the served plane. The latter counts for posts whose own error is
// above `least_own_m`, so that what the fast way leaves out stays out, whatever the face's other posts are.
FaceCandidate FaceScanner::scan_thoroughly(std::int32_t face, const FacePlane& plane, double least_own_m) const {
  const PlanTriangle plan = mesh_.plan_of(face);
  const FacePlane served = served_plane_of(face, plane);
  const Guard guard = mesh_.is_at_side(face) ? guard_.of_face(mesh_, face, unit_m_) : Guard{};
  const bool is_fan = guard.kind == Guard::Kind::kFan;
  const double tolerance = task_->tolerance_m;
  struct Worst {
    double error_m;
    std::int64_t post = -1;
    bool is_below(double error, std::int64_t other) const {
      return error > error_m || (error == error_m && post >= 0 && other < post);
    }
  };
  Worst own_worst{tolerance}, served_worst{tolerance};
  const auto consider = [&](double own, double served_error, double x, double y, std::int64_t post) {
    if (own > tolerance) {
      if (own_worst.is_below(own, post) && may_become_vertex(face, x, y, post)) own_worst = {own, post};
    } else if (own_worst.post < 0 && served_worst.is_below(served_error, post) && own > least_own_m &&
               may_become_vertex(face, x, y, post)) {
      served_worst = {served_error, post};
    }
  };
  const auto consider_at = [&](double x, double y, double height_m, std::int64_t post) {
    const double own =
        is_fan ? guard_.fan_error(guard, x, y, height_m) : std::abs(plane.at(x, y) - height_m) + guard.extra_m;
    consider(own, std::abs(served.at(x, y) - height_m) + served_rounding_m_, x, y, post);
  };
  for (const PostWindow& w : posts_.windows()) {
    const TriangleInPosts in(plan, w);
    const WidenedRows rows(TriangleRows(in.u, in.v), w.reach);
    if (w.is_base_grid) {
      if (posts_.is_covered(plan) || is_near_base(face, guard)) continue;
      const auto row = [&](std::int64_t r, std::int64_t c_first, std::int64_t c_last) {
        for (std::int64_t c = c_first; c <= c_last; ++c) {
          const double x = w.x(c), y = w.y(r);
          if (!posts_.is_covered(x, y)) consider_at(x, y, field_->base_height_m, w.first_index + r * w.n_cols + c);
        }
      };
      posts_.for_promising_boxes(
          in, rows, w, own_worst.error_m,
          [](const PostBlock&, const PostBlocks::Extent&) { return std::numeric_limits<double>::infinity(); },
          [&](const PostBlocks::Extent& e) { TilePosts::for_rows_in_box(rows, w, e, row); }, any_post,
          [&](std::int64_t r, std::int64_t c, float) { row(r, c, c); });
      continue;
    }
    const auto part = [&](std::int64_t r, const float* heights, const PostOrigin* origins, std::int64_t c_begin,
                          std::int64_t c_end) {
      const double y = w.y(r), z = plane.at(w.x0, y), per_col = plane.slope_x * w.dx;
      const double served_z = served.at(w.x0, y), served_per_col = served.slope_x * w.dx;
      const std::int64_t row_index = w.first_index + r * w.n_cols;
      double col = static_cast<double>(c_begin);
      for (std::int64_t c = c_begin; c < c_end; ++c, ++col) {
        const double height = static_cast<double>(heights[c - c_begin]);
        const double own =
            is_fan ? guard_.fan_error(guard, w.x(c), y, height) : std::abs(z + per_col * col - height) + guard.extra_m;
        const double served_error = std::abs(served_z + served_per_col * col - height) + served_rounding_m_;
        if (std::max(own, served_error) > tolerance &&
            (origins == nullptr || origins[c - c_begin] != PostOrigin::kInterpolated)) {
          consider(own, served_error, w.x(c), y, row_index + c);
        }
      }
    };
    const auto row = [&](std::int64_t r, std::int64_t c_first, std::int64_t c_last) {
      posts_.for_parts(w, r, c_first, c_last + 1,
                       [&](const float* heights, const PostOrigin* origins, std::int64_t c_begin, std::int64_t c_end) {
                         part(r, heights, origins, c_begin, c_end);
                       });
    };
    posts_.for_promising_boxes(
        in, rows, w, own_worst.error_m,
        [&](const PostBlock& block, const PostBlocks::Extent& e) {
          const double own_m = plane_bound(plane, w, block, e) + guard.extra_m + guard.finer_m;
          if (own_worst.post >= 0) return own_m;
          return std::max(own_m, plane_bound(served, w, block, e) + served_rounding_m_);
        },
        [&](const PostBlocks::Extent& e) { TilePosts::for_rows_in_box(rows, w, e, row); }, any_post,
        [&](std::int64_t r, std::int64_t c, float height_m) { part(r, &height_m, nullptr, c, c + 1); });
  }
  posts_.for_points(plan, posts_.reach(), [&](std::uint32_t k, const TilePoint& p) {
    consider_at(p.x, p.y, p.height_m, posts_.index_of_point(k));
  });
  if (own_worst.post >= 0) return {static_cast<float>(own_worst.error_m), own_worst.post};
  if (served_worst.post >= 0) return {static_cast<float>(tolerance), served_worst.post};
  return {};
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
