// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/triangulator.hpp"

#include <CGAL/Constrained_Delaunay_triangulation_2.h>
#include <CGAL/Constrained_triangulation_face_base_2.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Triangulation_face_base_with_info_2.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <queue>
#include <unordered_map>

#include "core/format/quantized_mesh.hpp"

namespace tind {
namespace {

struct VertexInfo {
  std::int64_t x = 0, y = 0;  // local lattice steps
  std::int32_t z = 0;
  std::uint32_t index = 0;  // local order, set at the end for interior vertices
};

struct FaceInfo {
  std::uint32_t stamp = 0;  // grows with every rescan: older heap entries are stale
};

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using VertexBase = CGAL::Triangulation_vertex_base_with_info_2<VertexInfo, Kernel>;
using FaceBase =
    CGAL::Constrained_triangulation_face_base_2<Kernel, CGAL::Triangulation_face_base_with_info_2<FaceInfo, Kernel>>;
using Cdt =
    CGAL::Constrained_Delaunay_triangulation_2<Kernel, CGAL::Triangulation_data_structure_2<VertexBase, FaceBase>,
                                               CGAL::No_constraint_intersection_requiring_constructions_tag>;
using Vertex = Cdt::Vertex_handle;
using Face = Cdt::Face_handle;

__extension__ using Int128 = __int128;

// A regular grid of posts over the tile, in local lattice steps.
struct PostWindow {
  double x0 = 0, y0 = 0, dx = 1, dy = 1;  // position of post (0, 0) of the window and spacing
  std::int64_t n_cols = 0, n_rows = 0;
  std::int64_t field_col = 0,
               field_row = 0;  // of the window's post (0, 0); field_col < 0: the level's grid at base height

  bool is_grid() const { return field_col < 0; }
  double x(std::int64_t c) const { return x0 + static_cast<double>(c) * dx; }
  double y(std::int64_t r) const { return y0 + static_cast<double>(r) * dy; }
};

// An irregular post of the tile, local lattice steps.
struct TilePoint {
  double x = 0, y = 0, height_m = 0;
};

// The tile's irregular posts, by cells of a regular grid around them.
struct PointCells {
  double x0 = 0, y0 = 0, size = 1;
  std::int64_t n_cols = 0, n_rows = 0;
  std::vector<std::uint32_t> first;  // n_rows * n_cols + 1
  std::vector<TilePoint> points;

  std::int64_t col(double x) const {
    return std::clamp<std::int64_t>(static_cast<std::int64_t>(std::floor((x - x0) / size)), 0, n_cols - 1);
  }
  std::int64_t row(double y) const {
    return std::clamp<std::int64_t>(static_cast<std::int64_t>(std::floor((y - y0) / size)), 0, n_rows - 1);
  }
};

struct Candidate {
  double error = 0;
  std::int64_t x = 0, y = 0;  // local lattice steps of the vertex to be
  std::uint32_t stamp = 0;
  Face face;

  // Heap order: largest error, then south, then west.
  friend bool operator<(const Candidate& a, const Candidate& b) {
    if (a.error != b.error) return a.error < b.error;
    if (a.y != b.y) return a.y > b.y;
    return a.x > b.x;
  }
};

struct PositionHash {
  std::size_t operator()(const std::pair<std::int64_t, std::int64_t>& p) const noexcept {
    return std::hash<std::int64_t>{}(p.first * 0x9E3779B97F4A7C15ll ^ p.second);
  }
};

// Plane through a triangle: z = z_a + slope_x (x - x_a) + slope_y (y - y_a), metres over local lattice steps.
struct Plane {
  double x_a, y_a, z_a, slope_x, slope_y;
  double at(double x, double y) const { return z_a + slope_x * (x - x_a) + slope_y * (y - y_a); }
};

// What tessellation to finer borders may do to a face.
struct Guard {
  enum class Kind { kPlane, kFan } kind = Kind::kPlane;
  int border = 0;                          // kFan: the border of the one border edge
  double apex_along = 0, apex_across = 0;  // kFan: apex, along the border and its distance from it
  double apex_m = 0;
  double extra_m = 0;  // corner triangle: added to the error of every post
};

class TileRefiner {
 public:
  TileRefiner(const HeightField& field, const TileTask& task)
      : field_(field),
        task_(task),
        side_(field.lattice.tile_side(task.key.level)),
        west_(side_ * task.key.x),
        south_(side_ * task.key.y) {}

  TileSurface run() {
    make_windows();
    collect_points();
    served_rounding_m_ = served_height_step() / 2;
    insert_initial();
    refine();
    TileSurface surface;
    surface.n_inserted = n_inserted_;
    surface.n_of_lines = n_of_lines_;
    surface.n_left_out = n_left_out_;
    extract(surface);
    measure(surface.stats);
    return surface;
  }

 private:
  double height_m(std::int32_t z) const { return field_.lattice.height_m(z); }

  // ---- posts -------------------------------------------------------------------------------------------------------

  // Degrees carry about 1e-13 of rounding: a post this close to a tile's side, in lattice steps, lies on it.
  double nudge() const { return 1e-5 + 1e-13 * static_cast<double>(field_.lattice.width()); }

  void make_windows() {
    const double width = static_cast<double>(field_.lattice.width()), side = static_cast<double>(side_);
    for (const double turn : {-width, 0.0, width}) {
      PostWindow w;
      w.dx = field_.dx;
      w.dy = field_.dy;
      const double x0 = field_.x0 + turn - static_cast<double>(west_), y0 = field_.y0 - static_cast<double>(south_);
      const auto first = [this](double origin, double step) {
        return std::max<std::int64_t>(0, static_cast<std::int64_t>(std::ceil((-origin - nudge()) / step)));
      };
      const auto last = [this, side](double origin, double step, std::int64_t n) {
        return std::min<std::int64_t>(n - 1, static_cast<std::int64_t>(std::floor((side - origin + nudge()) / step)));
      };
      w.field_col = first(x0, w.dx);
      w.field_row = first(y0, w.dy);
      w.n_cols = last(x0, w.dx, field_.n_cols) - w.field_col + 1;
      w.n_rows = last(y0, w.dy, field_.n_rows) - w.field_row + 1;
      if (w.n_cols <= 0 || w.n_rows <= 0) continue;
      w.x0 = x0 + static_cast<double>(w.field_col) * w.dx;
      w.y0 = y0 + static_cast<double>(w.field_row) * w.dy;
      windows_.push_back(w);
    }
    const auto covered = [&](std::int64_t x, std::int64_t y) {
      return field_.covers(static_cast<double>(west_ + x), static_cast<double>(south_ + y));
    };
    // Posts end where the grid ends: beyond it the base height is checked on the level's own grid.
    if (covered(0, 0) && covered(side_, 0) && covered(0, side_) && covered(side_, side_) && field_.n_rows > 1) {
      const double west = static_cast<double>(west_), last = field_.post_x(field_.n_cols - 1);
      if (field_.wraps || (field_.x0 <= west && west + side <= last)) return;
    }
    PostWindow grid;
    grid.field_col = -1;
    grid.dx = grid.dy = static_cast<double>(side_ / kCellsPerTile);
    grid.n_cols = grid.n_rows = kCellsPerTile + 1;
    windows_.push_back(grid);
  }

  void collect_points() {
    const double width = static_cast<double>(field_.lattice.width()), side = static_cast<double>(side_);
    std::vector<TilePoint> found;
    for (const double turn : {0.0, width}) {
      const double west = static_cast<double>(west_) + turn, south = static_cast<double>(south_);
      field_.points.for_blocks(west - nudge(), south - nudge(), west + side + nudge(), south + side + nudge(),
                               [&](const PointPost& p) {
                                 const TilePoint local{p.x - west, p.y - south, static_cast<double>(p.height_m)};
                                 if (local.x < -nudge() || local.x > side + nudge()) return;
                                 if (local.y < -nudge() || local.y > side + nudge()) return;
                                 found.push_back(local);
                               });
    }
    if (found.empty()) return;
    double x1 = found[0].x, y1 = found[0].y;
    cells_.x0 = x1;
    cells_.y0 = y1;
    for (const TilePoint& p : found) {
      cells_.x0 = std::min(cells_.x0, p.x);
      cells_.y0 = std::min(cells_.y0, p.y);
      x1 = std::max(x1, p.x);
      y1 = std::max(y1, p.y);
    }
    // About one point a cell, wherever the points are.
    const double n = static_cast<double>(found.size()), longer = std::max({x1 - cells_.x0, y1 - cells_.y0, 1.0});
    cells_.size = std::max(std::sqrt((x1 - cells_.x0) * (y1 - cells_.y0) / n), longer / n);
    cells_.n_cols = static_cast<std::int64_t>((x1 - cells_.x0) / cells_.size) + 1;
    cells_.n_rows = static_cast<std::int64_t>((y1 - cells_.y0) / cells_.size) + 1;
    const auto cell_of = [&](const TilePoint& p) {
      return static_cast<std::size_t>(cells_.row(p.y) * cells_.n_cols + cells_.col(p.x));
    };
    cells_.first.assign(static_cast<std::size_t>(cells_.n_cols * cells_.n_rows) + 1, 0);
    for (const TilePoint& p : found) ++cells_.first[cell_of(p) + 1];
    for (std::size_t k = 1; k < cells_.first.size(); ++k) cells_.first[k] += cells_.first[k - 1];
    cells_.points.resize(found.size());
    std::vector<std::uint32_t> next(cells_.first.begin(), cells_.first.end() - 1);
    for (const TilePoint& p : found) cells_.points[next[cell_of(p)]++] = p;
  }

  // Calls visit(index, point) for the irregular posts in a triangle, borders included: those outside by a rounding,
  // too.
  template <class Visit>
  void for_points(Face f, Visit visit) const {
    if (cells_.points.empty()) return;
    std::array<double, 3> x{}, y{};
    for (int i = 0; i < 3; ++i) {
      x[static_cast<std::size_t>(i)] = static_cast<double>(f->vertex(i)->info().x);
      y[static_cast<std::size_t>(i)] = static_cast<double>(f->vertex(i)->info().y);
    }
    const auto [south, north] = std::minmax({y[0], y[1], y[2]});
    const auto [west, east] = std::minmax({x[0], x[1], x[2]});
    const double end_x = cells_.x0 + cells_.size * static_cast<double>(cells_.n_cols);
    const double end_y = cells_.y0 + cells_.size * static_cast<double>(cells_.n_rows);
    if (east + nudge() < cells_.x0 || west - nudge() > end_x || north + nudge() < cells_.y0 ||
        south - nudge() > end_y) {
      return;
    }
    std::array<double, 3> slack{};
    for (std::size_t i = 0; i < 3; ++i) {
      const std::size_t j = (i + 1) % 3;
      slack[i] = -nudge() * std::hypot(x[j] - x[i], y[j] - y[i]);
    }
    for (std::int64_t r = cells_.row(south - nudge()); r <= cells_.row(north + nudge()); ++r) {
      // Where the triangle lies in this row of cells.
      const double low = cells_.y0 + cells_.size * static_cast<double>(r) - nudge();
      const double high = low + cells_.size + 2 * nudge();
      double left = std::numeric_limits<double>::infinity(), right = -left;
      for (std::size_t i = 0; i < 3; ++i) {
        const std::size_t j = (i + 1) % 3;
        if (std::max(y[i], y[j]) < low || std::min(y[i], y[j]) > high) continue;
        for (const double at : {std::clamp(low, std::min(y[i], y[j]), std::max(y[i], y[j])),
                                std::clamp(high, std::min(y[i], y[j]), std::max(y[i], y[j]))}) {
          const double t = y[i] == y[j] ? 0 : (at - y[i]) / (y[j] - y[i]), cut = x[i] + t * (x[j] - x[i]);
          left = std::min({left, cut, y[i] == y[j] ? x[j] : cut});
          right = std::max({right, cut, y[i] == y[j] ? x[j] : cut});
        }
      }
      if (left > right) continue;
      for (std::int64_t c = cells_.col(left - nudge()); c <= cells_.col(right + nudge()); ++c) {
        const auto cell = static_cast<std::size_t>(r * cells_.n_cols + c);
        for (std::uint32_t k = cells_.first[cell]; k < cells_.first[cell + 1]; ++k) {
          const TilePoint& p = cells_.points[k];
          bool inside = true;
          for (std::size_t i = 0; i < 3 && inside; ++i) {
            const std::size_t j = (i + 1) % 3;
            inside = (x[j] - x[i]) * (p.y - y[i]) - (y[j] - y[i]) * (p.x - x[i]) >= slack[i];
          }
          if (inside) visit(k, p);
        }
      }
    }
  }

  // Bound of the step that quantized-mesh rounds the tile's inner heights to: its range over 32767, up to a power of
  // two.
  double served_height_step() const {
    double low = std::numeric_limits<double>::infinity(), high = -low;
    for (const PostWindow& w : windows_) {
      for (std::int64_t r = 0; !w.is_grid() && r < w.n_rows; ++r) {
        const auto [least, most] = std::minmax_element(field_row(w, r), field_row(w, r) + w.n_cols);
        low = std::min(low, static_cast<double>(*least));
        high = std::max(high, static_cast<double>(*most));
      }
    }
    for (const TilePoint& p : cells_.points) {
      low = std::min(low, p.height_m);
      high = std::max(high, p.height_m);
    }
    for (const auto& piece : task_.constraints) {
      for (const LocalVertex& v : piece) {
        low = std::min(low, height_m(v.z));
        high = std::max(high, height_m(v.z));
      }
    }
    for (const auto& border : task_.borders) {
      for (const LocalVertex& v : border) {
        low = std::min(low, height_m(v.z));
        high = std::max(high, height_m(v.z));
      }
    }
    const double step = std::exp2(std::ceil(std::log2(std::max(high - low, 0x1p-16) / kQuantizedSteps)));
    return std::min(step, task_.height_step_m);
  }

  // ---- triangulation -----------------------------------------------------------------------------------------------

  void insert_vertex_info(Vertex v, const LocalVertex& p, std::uint32_t index) {
    v->info() = {p.x, p.y, p.z, index};
    used_.emplace(std::pair{p.x, p.y}, v);
  }

  Vertex insert_point(std::int64_t x, std::int64_t y, Face hint) {
    return cdt_.insert(Kernel::Point_2(static_cast<double>(x), static_cast<double>(y)), hint);
  }

  void insert_initial() {
    // Corners first: from then on every point lies inside the square or on its hull.
    std::array<std::uint32_t, 4> first_index{};
    for (std::size_t b = 0; b < 4; ++b) {
      first_index[b] = n_ring_;
      n_ring_ += static_cast<std::uint32_t>(task_.borders[b].size());
    }
    for (std::size_t b = 0; b < 4; ++b) {
      const LocalVertex& corner = task_.borders[b][0];
      insert_vertex_info(insert_point(corner.x, corner.y, Face()), corner, first_index[b]);
    }
    Face hint;
    for (std::size_t b = 0; b < 4; ++b) {
      for (std::size_t k = 1; k < task_.borders[b].size(); ++k) {
        const LocalVertex& p = task_.borders[b][k];
        const Vertex v = insert_point(p.x, p.y, hint);
        insert_vertex_info(v, p, first_index[b] + static_cast<std::uint32_t>(k));
        hint = v->face();
      }
    }
    insert_inside(task_.initial, hint);
    std::vector<LocalVertex> ends;  // all first: the heaviest lines lie far apart
    for (const auto& piece : task_.constraints) ends.insert(ends.end(), piece.begin(), piece.end());
    n_of_lines_ = insert_inside(std::move(ends), hint);
    for (const auto& [a, b] : task_.constraints) {
      const Vertex from = used_.at({a.x, a.y}), to = used_.at({b.x, b.y});
      if (from != to && !constrain(from, to)) ++n_left_out_;
    }
    lead_constraints_through_vertices();
  }

  // Distance of a point from the edge opposite vertex i, lattice steps; infinite where its foot is not on the edge.
  static double distance_to_edge(Face f, int i, std::int64_t x, std::int64_t y) {
    const VertexInfo &a = f->vertex(Cdt::ccw(i))->info(), &b = f->vertex(Cdt::cw(i))->info();
    const double dx = static_cast<double>(b.x - a.x), dy = static_cast<double>(b.y - a.y);
    const double px = static_cast<double>(x - a.x), py = static_cast<double>(y - a.y);
    const double length2 = dx * dx + dy * dy, along = px * dx + py * dy;
    if (along <= 0 || along >= length2) return std::numeric_limits<double>::infinity();
    return std::abs(static_cast<double>(Int128{b.x - a.x} * (y - a.y) - Int128{b.y - a.y} * (x - a.x))) /
           std::sqrt(length2);
  }

  // A vertex is off its post by up to half a step each way: a constraint that passes so close may part them, and then
  // nothing holds the surface at the post. Such a constraint runs through the vertex instead.
  static constexpr double kBesideSteps = 1.5;

  // Whether both ways to w are shorter than a -> b. Led through such vertices alone, constraints come to an end; three
  // vertices a step or two apart would else hand one round for ever.
  static bool is_shortened_by(Vertex a, Vertex b, Vertex w) {
    const auto length2 = [](Vertex p, Vertex q) {
      const std::int64_t dx = p->info().x - q->info().x, dy = p->info().y - q->info().y;
      return Int128{dx} * dx + Int128{dy} * dy;
    };
    return std::max(length2(a, w), length2(w, b)) < length2(a, b);
  }

  void lead_constraints_through_vertices() {
    std::vector<std::pair<Vertex, Vertex>> open;
    for (const Cdt::Edge& e : cdt_.finite_edges()) {
      if (e.first->is_constrained(e.second)) {
        open.emplace_back(e.first->vertex(Cdt::ccw(e.second)), e.first->vertex(Cdt::cw(e.second)));
      }
    }
    while (!open.empty()) {
      const auto [a, b] = open.back();
      open.pop_back();
      Face f;
      int i = 0;
      if (!cdt_.is_edge(a, b, f, i) || !f->is_constrained(i)) continue;
      for (int beside = 0; beside < 2; ++beside) {
        const Vertex w = f->vertex(i);
        if (!cdt_.is_infinite(w) && distance_to_edge(f, i, w->info().x, w->info().y) < kBesideSteps &&
            is_shortened_by(a, b, w)) {
          cdt_.remove_constrained_edge(f, i);
          for (const Vertex end : {a, b}) {
            constrain(end, w);
            open.emplace_back(end, w);
          }
          break;
        }
        const Face other = f->neighbor(i);
        i = cdt_.mirror_index(f, i);
        f = other;
      }
    }
  }

  bool constrain(Vertex a, Vertex b) {
    try {
      cdt_.insert_constraint(a, b);
      return true;
    } catch (const Cdt::Intersection_of_constraints_exception&) {
      return false;
    }
  }

  // The new vertex takes over the constraints of a face's edges that it lies close to; returns their ends.
  std::vector<Vertex> release_edges_beside(Face f, std::int64_t x, std::int64_t y) {
    std::vector<Vertex> ends;
    for (int i = 0; i < 3; ++i) {
      if (!f->is_constrained(i)) continue;
      const double distance = distance_to_edge(f, i, x, y);
      if (distance == 0 || distance >= kBesideSteps) continue;
      const Face other = f->neighbor(i);
      other->set_constraint(cdt_.mirror_index(f, i), false);
      f->set_constraint(i, false);
      ends.push_back(f->vertex(Cdt::ccw(i)));
      ends.push_back(f->vertex(Cdt::cw(i)));
    }
    return ends;
  }

  void constrain_edge(Vertex a, Vertex b) {
    Face f;
    int i = 0;
    if (!cdt_.is_edge(a, b, f, i)) return;
    const Face other = f->neighbor(i);
    other->set_constraint(cdt_.mirror_index(f, i), true);
    f->set_constraint(i, true);
  }

  // Inserts the points that are not there yet, near ones one after another; returns how many.
  std::uint64_t insert_inside(std::vector<LocalVertex> points, Face& hint) {
    std::stable_sort(points.begin(), points.end(), morton_before);
    std::uint64_t n = 0;
    for (const LocalVertex& p : points) {
      if (used_.contains({p.x, p.y})) continue;
      assert(p.x > 0 && p.y > 0 && p.x < side_ && p.y < side_ && "a border vertex born inside");
      const Vertex v = insert_point(p.x, p.y, hint);
      insert_vertex_info(v, p, 0);
      hint = v->face();
      ++n;
    }
    return n;
  }

  static bool morton_before(const LocalVertex& a, const LocalVertex& b) {
    return morton_less(static_cast<std::uint64_t>(a.x), static_cast<std::uint64_t>(a.y),
                       static_cast<std::uint64_t>(b.x), static_cast<std::uint64_t>(b.y));
  }

  void refine() {
    for (Face f : cdt_.finite_face_handles()) scan(f);
    while (!heap_.empty()) {
      const Candidate best = heap_.top();
      heap_.pop();
      if (best.stamp != best.face->info().stamp) continue;
      const std::vector<Vertex> released = release_edges_beside(best.face, best.x, best.y);
      const Vertex v = insert_point(best.x, best.y, best.face);
      for (const Vertex end : released) constrain_edge(v, end);
      const LocalVertex p{best.x, best.y, field_.lattice_height(west_ + best.x, south_ + best.y)};
      insert_vertex_info(v, p, 0);
      ++n_inserted_;
      // Flips keep faces alive, so the changed faces are exactly those around the new vertex.
      Cdt::Face_circulator f = cdt_.incident_faces(v);
      const Cdt::Face_circulator end = f;
      do {
        if (!cdt_.is_infinite(f)) scan(f);
      } while (++f != end);
    }
  }

  // ---- scanning ----------------------------------------------------------------------------------------------------

  Plane plane_of(Face f) const {
    const VertexInfo &a = f->vertex(0)->info(), &b = f->vertex(1)->info(), &c = f->vertex(2)->info();
    const std::int64_t bx = b.x - a.x, by = b.y - a.y, cx = c.x - a.x, cy = c.y - a.y;
    // Exact: slivers on coarse tiles have an area far below the rounding of the products.
    const double area = static_cast<double>(Int128{bx} * cy - Int128{by} * cx);
    const double bz = height_m(b.z) - height_m(a.z), cz = height_m(c.z) - height_m(a.z);
    return {static_cast<double>(a.x), static_cast<double>(a.y), height_m(a.z),
            (bz * static_cast<double>(cy) - cz * static_cast<double>(by)) / area,
            (cz * static_cast<double>(bx) - bz * static_cast<double>(cx)) / area};
  }

  // The same plane after quantized-mesh has rounded positions and border heights; the plane itself where that leaves no
  // area.
  Plane served_plane_of(Face f, const Plane& plane) const {
    const double step = static_cast<double>(side_) / kQuantizedSteps;
    std::array<double, 3> x{}, y{}, z{};
    for (int i = 0; i < 3; ++i) {
      const VertexInfo& v = f->vertex(i)->info();
      const auto at = static_cast<std::size_t>(i);
      x[at] = std::round(static_cast<double>(v.x) / step) * step;
      y[at] = std::round(static_cast<double>(v.y) / step) * step;
      const bool on_border = v.x == 0 || v.y == 0 || v.x == side_ || v.y == side_;
      z[at] = on_border ? round_to_step(height_m(v.z), task_.height_step_m) : height_m(v.z);
    }
    const double bx = x[1] - x[0], by = y[1] - y[0], cx = x[2] - x[0], cy = y[2] - y[0];
    const double area = bx * cy - by * cx, bz = z[1] - z[0], cz = z[2] - z[0];
    if (!(area > step * step / 2)) return plane;
    return {x[0], y[0], z[0], (bz * cy - cz * by) / area, (cz * bx - bz * cx) / area};
  }

  // Border of the hull edge opposite vertex i.
  int border_of_edge(Face f, int i) const {
    const VertexInfo &a = f->vertex(Cdt::ccw(i))->info(), &b = f->vertex(Cdt::cw(i))->info();
    if (a.y == 0 && b.y == 0) return 0;
    if (a.x == side_ && b.x == side_) return 1;
    if (a.y == side_ && b.y == side_) return 2;
    return 3;
  }

  Guard guard_of(Face f) const {
    Guard guard;
    double finer_m = 0;  // largest distance of a finer border from B_L
    int n_edges = 0, opposite = 0;
    for (int i = 0; i < 3; ++i) {
      if (!cdt_.is_infinite(f->neighbor(i))) continue;
      ++n_edges;
      opposite = i;
      const int border = border_of_edge(f, i);
      const auto& knots = task_.envelopes[static_cast<std::size_t>(border)];
      const VertexInfo &a = f->vertex(Cdt::ccw(i))->info(), &b = f->vertex(Cdt::cw(i))->info();
      const bool along_x = border % 2 == 0;
      const double low = static_cast<double>(along_x ? std::min(a.x, b.x) : std::min(a.y, b.y));
      const double high = static_cast<double>(along_x ? std::max(a.x, b.x) : std::max(a.y, b.y));
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
    const VertexInfo& apex = f->vertex(opposite)->info();
    guard.kind = Guard::Kind::kFan;
    guard.apex_m = height_m(apex.z);
    const auto s = static_cast<double>(side_), x = static_cast<double>(apex.x), y = static_cast<double>(apex.y);
    guard.apex_along = guard.border % 2 == 0 ? x : y;
    guard.apex_across = guard.border == 0 ? y : guard.border == 1 ? s - x : guard.border == 2 ? s - y : x;
    return guard;
  }

  // Error of a post in a virtual triangle over all tessellations: the plane through the apex and any B_g between the
  // envelope's bounds.
  double fan_error(const Guard& guard, double x, double y, double height) const {
    const auto s = static_cast<double>(side_);
    const double along = guard.border % 2 == 0 ? x : y;
    const double across = guard.border == 0 ? y : guard.border == 1 ? s - x : guard.border == 2 ? s - y : x;
    const double lambda = std::clamp(across / guard.apex_across, 0.0, 1.0);  // weight of the apex
    if (lambda >= 1) return std::abs(guard.apex_m - height);
    const double t = (along - lambda * guard.apex_along) / (1 - lambda);
    const auto& knots = task_.envelopes[static_cast<std::size_t>(guard.border)];
    auto after =
        std::upper_bound(knots.begin(), knots.end(), t, [](double v, const EnvelopeKnot& k) { return v < k.t; });
    if (after == knots.begin()) ++after;
    if (after == knots.end()) --after;
    const EnvelopeKnot &a = *(after - 1), &b = *after;
    const double w = std::clamp((t - a.t) / (b.t - a.t), 0.0, 1.0);
    const double high = a.high_m + w * (b.high_m - a.high_m), low = a.low_m + w * (b.low_m - a.low_m);
    const double apex = lambda * guard.apex_m;
    return std::max(std::abs(apex + (1 - lambda) * high - height), std::abs(apex + (1 - lambda) * low - height));
  }

  // Calls row(r, c_first, c_last) for the posts of a window in a triangle, borders included: posts outside by a
  // rounding are scanned with it, so that none falls between two.
  template <class Row>
  void for_rows(Face f, const PostWindow& w, Row row) const {
    std::array<const VertexInfo*, 3> v = {&f->vertex(0)->info(), &f->vertex(1)->info(), &f->vertex(2)->info()};
    std::sort(v.begin(), v.end(), [](const auto* a, const auto* b) { return a->y < b->y; });
    const double slack_x = nudge() / w.dx, slack_y = nudge() / w.dy;
    std::array<double, 3> x{}, y{};
    for (std::size_t i = 0; i < 3; ++i) {
      x[i] = (static_cast<double>(v[i]->x) - w.x0) / w.dx;
      y[i] = (static_cast<double>(v[i]->y) - w.y0) / w.dy;
    }
    const auto r_first = std::max<std::int64_t>(0, static_cast<std::int64_t>(std::ceil(y[0] - slack_y)));
    const auto r_last = std::min<std::int64_t>(w.n_rows - 1, static_cast<std::int64_t>(std::floor(y[2] + slack_y)));
    const double long_slope = (x[2] - x[0]) / (y[2] - y[0]);
    const double low_slope = y[1] > y[0] ? (x[1] - x[0]) / (y[1] - y[0]) : 0;
    const double high_slope = y[2] > y[1] ? (x[2] - x[1]) / (y[2] - y[1]) : 0;
    for (std::int64_t r = r_first; r <= r_last; ++r) {
      const double at = std::clamp(static_cast<double>(r), y[0], y[2]);
      const double x_long = x[0] + long_slope * (at - y[0]);
      double x_short = x[1];
      if (at < y[1]) {
        x_short = x[0] + low_slope * (at - y[0]);
      } else if (y[2] > y[1]) {
        x_short = x[1] + high_slope * (at - y[1]);
      }
      const double left = std::min(x_long, x_short), right = std::max(x_long, x_short);
      const auto c_first = std::max<std::int64_t>(0, static_cast<std::int64_t>(std::ceil(left - slack_x)));
      const auto c_last = std::min<std::int64_t>(w.n_cols - 1, static_cast<std::int64_t>(std::floor(right + slack_x)));
      if (c_first <= c_last) row(r, c_first, c_last);
    }
  }

  const float* field_row(const PostWindow& w, std::int64_t r) const {
    return field_.heights_m + (w.field_row + r) * field_.n_cols + w.field_col;
  }

  // Posts that may become vertices: those that round to a free lattice point inside the tile. The border line answers
  // for those that round onto it: a row of vertices one step inside would make slivers that nothing can hold.
  bool to_vertex(double x, double y, Candidate& candidate) const {
    const std::int64_t lx = std::llround(x), ly = std::llround(y);
    if (lx <= 0 || ly <= 0 || lx >= side_ || ly >= side_) return false;
    if (used_.contains({lx, ly})) return false;
    candidate.x = lx;
    candidate.y = ly;
    return true;
  }

  // Finds the worst post of a face and queues it when it is beyond the tolerance.
  void scan(Face f) {
    const std::uint32_t stamp = ++f->info().stamp;
    const Plane plane = plane_of(f);
    const Plane served = served_plane_of(f, plane);
    const Guard guard = guard_of(f);
    Candidate best;
    best.error = task_.tolerance_m;
    bool found = false;
    const auto consider = [&](double error, double x, double y) {
      if (!to_vertex(x, y, best)) return;
      best.error = error;
      found = true;
    };
    for (const PostWindow& w : windows_) {
      if (w.is_grid()) {
        if (within_tolerance_of_base(f, guard)) continue;
        for_rows(f, w, [&](std::int64_t r, std::int64_t c_first, std::int64_t c_last) {
          const double y = w.y(r);
          for (std::int64_t c = c_first; c <= c_last; ++c) {
            const double x = w.x(c);
            const double error = post_error(plane, served, guard, x, y, field_.base_height_m);
            if (error > best.error && !field_.covers(x + static_cast<double>(west_), y + static_cast<double>(south_))) {
              consider(error, x, y);
            }
          }
        });
        continue;
      }
      for_rows(f, w, [&](std::int64_t r, std::int64_t c_first, std::int64_t c_last) {
        const float* heights = field_row(w, r);
        const double y = w.y(r);
        if (guard.kind == Guard::Kind::kFan) {
          for (std::int64_t c = c_first; c <= c_last; ++c) {
            const double error = post_error(plane, served, guard, w.x(c), y, static_cast<double>(heights[c]));
            if (error > best.error && is_post(heights + c)) consider(error, w.x(c), y);
          }
          return;
        }
        const double z = plane.at(w.x(c_first), y), z_step = plane.slope_x * w.dx;
        const double z_served = served.at(w.x(c_first), y), served_step = served.slope_x * w.dx;
        for (std::int64_t c = c_first; c <= c_last; ++c) {
          const auto along = static_cast<double>(c - c_first), height = static_cast<double>(heights[c]);
          const double error = std::max(std::abs(z + z_step * along - height) + guard.extra_m,
                                        std::abs(z_served + served_step * along - height) + served_rounding_m_);
          if (error > best.error && is_post(heights + c)) consider(error, w.x(c), y);
        }
      });
    }
    for_points(f, [&](std::uint32_t, const TilePoint& p) {
      const double error = post_error(plane, served, guard, p.x, p.y, p.height_m);
      if (error > best.error) consider(error, p.x, p.y);
    });
    if (!found) return;
    best.stamp = stamp;
    best.face = f;
    heap_.push(best);
  }

  // Whether a grid post is one to answer for: not where it was interpolated between irregular ones.
  bool is_post(const float* height) const {
    return field_.origins[height - field_.heights_m] != PostOrigin::kInterpolated;
  }

  double post_error(const Plane& plane, const Plane& served, const Guard& guard, double x, double y,
                    double height) const {
    const double own = guard.kind == Guard::Kind::kFan ? fan_error(guard, x, y, height)
                                                       : std::abs(plane.at(x, y) - height) + guard.extra_m;
    return std::max(own, std::abs(served.at(x, y) - height) + served_rounding_m_);
  }

  // A face whose corners (and finer borders) are within the tolerance of the base height is so everywhere.
  bool within_tolerance_of_base(Face f, const Guard& guard) const {
    double largest = 0;
    for (int i = 0; i < 3; ++i) {
      largest = std::max(largest, std::abs(height_m(f->vertex(i)->info().z) - field_.base_height_m));
    }
    return largest + guard.extra_m <= task_.tolerance_m;
  }

  // ---- results -----------------------------------------------------------------------------------------------------

  void extract(TileSurface& surface) {
    std::vector<Vertex> interior;
    TileStats& stats = surface.stats;
    stats.min_z = std::numeric_limits<std::int32_t>::max();
    stats.max_z = std::numeric_limits<std::int32_t>::min();
    for (Vertex v : cdt_.finite_vertex_handles()) {
      const VertexInfo& p = v->info();
      stats.min_z = std::min(stats.min_z, p.z);
      stats.max_z = std::max(stats.max_z, p.z);
      if (p.x > 0 && p.y > 0 && p.x < side_ && p.y < side_) interior.push_back(v);
    }
    const auto local = [](Vertex v) { return LocalVertex{v->info().x, v->info().y, v->info().z}; };
    std::sort(interior.begin(), interior.end(), [&](Vertex a, Vertex b) { return morton_before(local(a), local(b)); });
    surface.interior.reserve(interior.size());
    std::uint32_t index = n_ring_;
    for (Vertex v : interior) {
      v->info().index = index++;
      surface.interior.push_back(local(v));
    }
    for (Face f : cdt_.finite_face_handles()) {
      Triangle t = {f->vertex(0)->info().index, f->vertex(1)->info().index, f->vertex(2)->info().index};
      std::rotate(t.begin(), std::min_element(t.begin(), t.end()), t.end());
      surface.triangles.push_back(t);
    }
    std::sort(surface.triangles.begin(), surface.triangles.end());
  }

  // Error and RMSE at the source's own posts with west <= X < east, south <= Y < north, each counted once
  // (docs/format.md 5).
  void measure(TileStats& stats) const {
    double largest = 0, sum = 0;
    const double end = static_cast<double>(side_) - nudge();
    // Nothing lies north of the pole: its posts belong to the tiles below it.
    const bool at_pole = task_.key.y + 1 == TileKey::count_y(task_.key.level);
    const double end_y = at_pole ? std::numeric_limits<double>::infinity() : end;
    for (const PostWindow& w : windows_) {
      if (w.is_grid()) continue;
      std::vector<bool> seen(static_cast<std::size_t>(w.n_cols * w.n_rows), false);
      for (Face f : cdt_.finite_face_handles()) {
        const Plane plane = plane_of(f);
        for_rows(f, w, [&](std::int64_t r, std::int64_t c_first, std::int64_t c_last) {
          const double y = w.y(r);
          if (y >= end_y) return;
          const float* heights = field_row(w, r);
          const PostOrigin* origins = field_.origins + (heights - field_.heights_m);
          for (std::int64_t c = c_first; c <= c_last; ++c) {
            if (origins[c] != PostOrigin::kSource || w.x(c) >= end) continue;
            const auto at = static_cast<std::size_t>(r * w.n_cols + c);
            if (seen[at]) continue;
            seen[at] = true;
            const double error = std::abs(plane.at(w.x(c), y) - static_cast<double>(heights[c]));
            largest = std::max(largest, error);
            sum += error * error;
            ++stats.n_posts;
          }
        });
      }
    }
    std::vector<bool> seen(cells_.points.size(), false);
    for (Face f : cdt_.finite_face_handles()) {
      const Plane plane = plane_of(f);
      for_points(f, [&](std::uint32_t k, const TilePoint& p) {
        if (seen[k] || p.x < -nudge() || p.y < -nudge() || p.x >= end || p.y >= end_y) return;
        seen[k] = true;
        const double error = std::abs(plane.at(p.x, p.y) - p.height_m);
        largest = std::max(largest, error);
        sum += error * error;
        ++stats.n_posts;
      });
    }
    stats.max_error_m = std::nextafter(static_cast<float>(largest), std::numeric_limits<float>::max());
    if (largest == 0) stats.max_error_m = 0;
    stats.rmse_m = stats.n_posts ? static_cast<float>(std::sqrt(sum / static_cast<double>(stats.n_posts))) : 0;
  }

  const HeightField& field_;
  const TileTask& task_;
  const std::int64_t side_, west_, south_;
  std::vector<PostWindow> windows_;
  PointCells cells_;
  Cdt cdt_;
  double served_rounding_m_ = 0;  // of inner heights
  std::uint32_t n_ring_ = 0;
  std::uint64_t n_inserted_ = 0, n_of_lines_ = 0, n_left_out_ = 0;
  std::unordered_map<std::pair<std::int64_t, std::int64_t>, Vertex, PositionHash> used_;
  std::priority_queue<Candidate> heap_;
};

}  // namespace

TileSurface triangulate(const HeightField& field, const TileTask& task) { return TileRefiner(field, task).run(); }

}  // namespace tind
