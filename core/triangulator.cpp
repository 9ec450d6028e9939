// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/triangulator.hpp"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <functional>
#include <limits>
#include <utility>

#include "core/drainage/flow_run.hpp"
#include "core/error_queue.hpp"
#include "core/format/quantized_mesh.hpp"
#include "core/mesh.hpp"
#include "core/tile_errors.hpp"
#include "core/triangulator_posts.hpp"
#include "core/triangulator_result.hpp"
#include "core/triangulator_scan.hpp"

namespace tind {
namespace {

__extension__ using Int128 = __int128;

// A vertex is off its post by up to half a step each way: a constraint that passes so close may part them, and then
// nothing holds the surface at the post. Such a constraint runs through the vertex instead.
constexpr double kBesideSteps = 1.5;
// Same for steps of quantized-mesh, which moves the vertex and the constraint by up to 0.71 of them each: a triangle
// that is left between them turns over.
constexpr double kBesideServedSteps = 1.5;

// Refines one tile after the other; keeps its storage in between.
class TileRefiner {
 public:
  TileSurface run(const HeightField& field, const TileTask& task, int threads) {
    begin(field, task, false);
    TileSurface surface;
    triangulate(threads, surface);
    errors_of(extractor_.vertices(), surface.triangles).measure(task.n_cell_levels, threads, nullptr, surface);
    if (task.n_cell_levels > 0 && can_be_repeated(field)) {
      posts_.find_posts_of(surface.interior, of_vertices_);
      surface.vertex_posts = {scanner_.served_step_m(), of_vertices_.heights_m};
    }
    return surface;
  }

  std::optional<TileSurface> repeat(const HeightField& field, const TileTask& task, const EarlierTile& earlier,
                                    int threads) {
    begin(field, task, true);
    posts_.find_posts_of(earlier.interior, of_vertices_);
    VertexPosts vertex_posts{scanner_.served_step_m(), of_vertices_.heights_m};
    if (earlier.cells.size() != std::size_t{1} << (2 * task.n_cell_levels) || !earlier.has(vertex_posts)) return {};
    TileErrors::Known known{earlier.cells, std::vector<bool>(earlier.cells.size())};
    std::vector<PlanBox> changed;
    for (const TileKey& key : earlier.changed) add_changed(key, changed, known.is_changed);
    // Where the earlier mesh is too far from a changed post now, there is nothing to repeat.
    TileSurface measured;
    if (!measure_earlier(earlier, threads, known, measured)) return {};
    if (!posts_.restrict_to(of_vertices_, changed)) return {};
    TileSurface surface;
    mesh_.make_room(earlier_vertices_.size());
    scanned_.reserve(2 * earlier_vertices_.size());
    earlier_ = &earlier;
    const bool is_same = triangulate(threads, surface);
    earlier_ = nullptr;
    posts_.lift_restriction();
    if (!is_same || !std::equal(surface.interior.begin(), surface.interior.end(), earlier.interior.begin(),
                                earlier.interior.end())) {
      return {};
    }
    if (!std::equal(surface.triangles.begin(), surface.triangles.end(), earlier.triangles.begin(),
                    earlier.triangles.end())) {
      return {};
    }
    surface.stats.n_posts = measured.stats.n_posts;
    surface.stats.max_error_m = measured.stats.max_error_m;
    surface.stats.rmse_m = measured.stats.rmse_m;
    surface.cells = std::move(measured.cells);
    surface.vertex_posts = std::move(vertex_posts);
    return surface;
  }

 private:
  void begin(const HeightField& field, const TileTask& task, bool few) {
    field_ = &field;
    task_ = &task;
    side_ = field.lattice.tile_side(task.key.level);
    west_ = side_ * task.key.x;
    south_ = side_ * task.key.y;
    posts_.reset(field, task.key, has_vertex_served_far(), few);
    beside_ = std::max(kBesideSteps, kBesideServedSteps * static_cast<double>(side_) / kQuantizedSteps);
    scanner_.reset(field, task);
  }

  // Whether quantized-mesh moves a vertex that is there from the start further than half a step.
  bool has_vertex_served_far() const {
    const double side = static_cast<double>(side_);
    const auto is_far = [side](const LocalVertex& v) {
      return is_served_far(static_cast<double>(v.x), side) || is_served_far(static_cast<double>(v.y), side);
    };
    const auto any = [&](const auto& vertices) { return std::any_of(vertices.begin(), vertices.end(), is_far); };
    return any(task_->initial) || std::any_of(task_->borders.begin(), task_->borders.end(), any) ||
           std::any_of(task_->constraints.begin(), task_->constraints.end(), any);
  }

  // Of the restricted posts, if they are. False, and it ends early, where the mesh will not be the earlier one.
  bool triangulate(int threads, TileSurface& surface) {
    insert_ring();
    insert_inside(task_->initial);
    insert_constraints(surface);
    if (!refine(threads, surface)) return false;
    extractor_.extract(mesh_, n_ring_, surface);
    return true;
  }

  TileErrors errors_of(std::span<const Mesh::Vertex> vertices, std::span<const Triangle> triangles) const {
    const bool at_pole = task_->key.y + 1 == TileKey::count_y(task_->key.level);
    return {posts_,
            scanner_,
            vertices,
            triangles,
            static_cast<double>(side_),
            at_pole,
            SquareQuantum::of_scale(task_->tolerance_m)};
  }

  // Measures the earlier mesh at today's posts. False: it is not within the tolerance at a post that may have changed,
  // or is no mesh of the task's ring.
  bool measure_earlier(const EarlierTile& earlier, int threads, const TileErrors::Known& known, TileSurface& surface) {
    earlier_vertices_.clear();
    const auto add = [this](const LocalVertex& v) {
      earlier_vertices_.push_back({static_cast<double>(v.x), static_cast<double>(v.y), v.z, Mesh::kNone});
    };
    for (const auto& border : task_->borders) std::for_each(border.begin(), border.end(), add);
    std::for_each(earlier.interior.begin(), earlier.interior.end(), add);
    for (const Triangle& t : earlier.triangles) {
      if (std::max({t[0], t[1], t[2]}) >= earlier_vertices_.size()) return false;
    }
    errors_of(earlier_vertices_, earlier.triangles).measure(task_->n_cell_levels, threads, &known, surface);
    for (std::size_t k = 0; k < surface.cells.size(); ++k) {
      if (known.is_changed[k] && static_cast<double>(surface.cells[k].largest_m) > task_->tolerance_m) return false;
    }
    return true;
  }

  // A descendant's box, and the cells that it meets.
  void add_changed(const TileKey& key, std::vector<PlanBox>& boxes, std::vector<bool>& cells) const {
    const std::int64_t side = field_->lattice.tile_side(key.level);
    const double west = static_cast<double>(side * key.x - west_), south = static_cast<double>(side * key.y - south_);
    boxes.push_back({west, south, west + static_cast<double>(side), south + static_cast<double>(side)});
    const int n_levels = task_->n_cell_levels;
    const std::int64_t cell_side = side_ >> n_levels, n = std::int64_t{1} << n_levels;
    const std::int64_t i_first = (side * key.x - west_) / cell_side, j_first = (side * key.y - south_) / cell_side;
    const std::int64_t n_met = std::max<std::int64_t>(1, side / cell_side);
    for (std::int64_t j = j_first; j < std::min(n, j_first + n_met); ++j) {
      for (std::int64_t i = i_first; i < std::min(n, i_first + n_met); ++i) {
        cells[static_cast<std::size_t>(j * n + i)] = true;
      }
    }
  }

  // ---- initial vertices --------------------------------------------------------------------------------------------

  void insert_ring() {
    n_ring_ = 0;
    for (const auto& border : task_->borders) n_ring_ += static_cast<std::int32_t>(border.size());
    mesh_.reset(static_cast<double>(side_), n_ring_);
    std::array<std::int32_t, 4> corners{};
    std::int32_t v = 0;
    for (std::size_t b = 0; b < 4; ++b) {
      corners[b] = v;
      for (const LocalVertex& p : task_->borders[b]) {
        mesh_.vertex(v++) = {static_cast<double>(p.x), static_cast<double>(p.y), p.z, Mesh::kNone};
      }
    }
    mesh_.insert_corners(corners[0], corners[1], corners[2], corners[3]);
    hint_ = 0;
    for (v = 0; v < n_ring_; ++v) {
      if (std::find(corners.begin(), corners.end(), v) != corners.end()) continue;
      const Mesh::Vertex& p = mesh_.vertex(v);
      mesh_.insert(v, mesh_.locate(p.x, p.y, hint_));
      hint_ = mesh_.vertex(v).face;
    }
  }

  // Inserts the points that are not there yet, near ones one after another; returns how many.
  std::uint64_t insert_inside(const std::vector<LocalVertex>& points) {
    morton_order(points, order_);
    std::uint64_t n = 0;
    for (const std::uint32_t k : order_) {
      const LocalVertex& p = points[k];
      assert(p.x > 0 && p.y > 0 && p.x < side_ && p.y < side_ && "a border vertex born inside");
      const double x = static_cast<double>(p.x), y = static_cast<double>(p.y);
      const Mesh::Location where = mesh_.locate(x, y, hint_);
      if (where.place == Mesh::Place::kOnVertex) continue;
      const std::int32_t v = mesh_.add_vertex(x, y, p.z);
      mesh_.insert(v, where);
      hint_ = mesh_.vertex(v).face;
      ++n;
    }
    return n;
  }

  // ---- break lines -------------------------------------------------------------------------------------------------

  void insert_constraints(TileSurface& surface) {
    if (task_->constraints.empty()) return;
    std::vector<LocalVertex> ends;  // all first: the heaviest lines lie far apart
    for (const auto& piece : task_->constraints) {
      for (const LocalVertex& p : piece) {
        if (p.x > 0 && p.y > 0 && p.x < side_ && p.y < side_) ends.push_back(p);
      }
    }
    surface.n_of_lines = insert_inside(ends);
    for (const auto& [a, b] : task_->constraints) {
      const std::int32_t from = vertex_at(a), to = vertex_at(b);
      if (from != to && !mesh_.constrain(from, to)) ++surface.n_left_out;
    }
    lead_constraints_through_vertices();
  }

  std::int32_t vertex_at(const LocalVertex& p) {
    const Mesh::Location where = mesh_.locate(static_cast<double>(p.x), static_cast<double>(p.y), hint_);
    assert(where.place == Mesh::Place::kOnVertex && "an end of a break line on the border must be a border vertex");
    hint_ = Mesh::face_of(where.edge);
    return mesh_.opposite_of(where.edge);
  }

  // Distance of a point from an edge, lattice steps; infinite where its foot is not on the edge.
  double distance_to_edge(std::int32_t edge, double x, double y) const {
    const Mesh::Vertex &a = mesh_.vertex(mesh_.start_of(edge)), &b = mesh_.vertex(mesh_.end_of(edge));
    const double dx = b.x - a.x, dy = b.y - a.y, px = x - a.x, py = y - a.y;
    const double length2 = dx * dx + dy * dy, along = px * dx + py * dy;
    if (along <= 0 || along >= length2) return std::numeric_limits<double>::infinity();
    return std::abs(mesh_.doubled_area(a, b, {x, y, 0, Mesh::kNone})) / std::sqrt(length2);
  }

  // Whether both ways to w are shorter than a -> b. Led through such vertices alone, constraints come to an end; three
  // vertices a step or two apart would else hand one round for ever.
  bool is_shortened_by(std::int32_t a, std::int32_t b, std::int32_t w) const {
    const auto length2 = [this](std::int32_t i, std::int32_t j) {
      const Mesh::Vertex &p = mesh_.vertex(i), &q = mesh_.vertex(j);
      const auto dx = static_cast<std::int64_t>(p.x - q.x), dy = static_cast<std::int64_t>(p.y - q.y);
      return Int128{dx} * dx + Int128{dy} * dy;
    };
    return std::max(length2(a, w), length2(w, b)) < length2(a, b);
  }

  void lead_constraints_through_vertices() {
    std::vector<std::pair<std::int32_t, std::int32_t>> open;
    for (std::int32_t f = 0; f < mesh_.n_faces(); ++f) {
      for (std::int32_t e = 4 * f; e < 4 * f + 3; ++e) {
        if (mesh_.is_fixed(e) && mesh_.twin_of(e) < e) open.emplace_back(mesh_.start_of(e), mesh_.end_of(e));
      }
    }
    while (!open.empty()) {
      const auto [a, b] = open.back();
      open.pop_back();
      const std::int32_t edge = mesh_.find_edge(a, b);
      if (edge == Mesh::kNone || !mesh_.is_fixed(edge)) continue;
      for (const std::int32_t e : {edge, mesh_.twin_of(edge)}) {
        if (e == Mesh::kNone) continue;
        const std::int32_t w = mesh_.opposite_of(e);
        if (distance_to_edge(e, mesh_.vertex(w).x, mesh_.vertex(w).y) >= beside_ || !is_shortened_by(a, b, w)) {
          continue;
        }
        mesh_.release(e);
        for (const std::int32_t end : {a, b}) {
          mesh_.constrain(end, w);
          open.emplace_back(end, w);
        }
        break;
      }
    }
  }

  // The new vertex takes over the constraints of a face's edges that it lies close to; returns their ends.
  std::vector<std::int32_t> release_edges_beside(std::int32_t face, double x, double y) {
    std::vector<std::int32_t> ends;
    if (mesh_.face(face).fixed == 0) return ends;
    for (std::int32_t e = 4 * face; e < 4 * face + 3; ++e) {
      if (!mesh_.is_fixed(e)) continue;
      const double distance = distance_to_edge(e, x, y);
      if (distance == 0 || distance >= beside_) continue;
      mesh_.set_fixed(e, false);
      ends.push_back(mesh_.start_of(e));
      ends.push_back(mesh_.end_of(e));
    }
    return ends;
  }

  // ---- greedy insertion --------------------------------------------------------------------------------------------

  void scan(std::int32_t face) {
    Scanned& scanned = scanned_[static_cast<std::size_t>(face)];
    scanned.candidate = scanner_.scan(face);
    ++scanned.stamp;
    queue(face);
  }
  void queue(std::int32_t face) {
    const Scanned& scanned = scanned_[static_cast<std::size_t>(face)];
    if (scanned.candidate.post >= 0) queue_.push(face, scanned.candidate.error_m, scanned.stamp);
  }

  bool refine(int threads, TileSurface& surface) {
    queue_.reset(static_cast<float>(task_->tolerance_m));
    scanned_.assign(static_cast<std::size_t>(mesh_.n_faces()), {});
    constexpr std::int32_t kFacesOfJob = 256;
    for_each_job({threads, nullptr, {}}, (mesh_.n_faces() + kFacesOfJob - 1) / kFacesOfJob, [&](int, std::int64_t job) {
      const auto first = static_cast<std::int32_t>(job) * kFacesOfJob;
      for (std::int32_t f = first; f < std::min(first + kFacesOfJob, mesh_.n_faces()); ++f) {
        scanned_[static_cast<std::size_t>(f)].candidate = scanner_.scan(f);
      }
    });
    for (std::int32_t f = 0; f < mesh_.n_faces(); ++f) queue(f);
    while (const auto next = queue_.pop()) {
      const auto [candidate, stamp] = scanned_[static_cast<std::size_t>(next->face)];
      if (next->stamp != stamp) continue;
      if (earlier_ != nullptr) {
        const auto vertex = posts_.vertex_of(candidate.post);
        if (!vertex) return false;
        const LocalVertex& v = earlier_->interior[*vertex];  // it has the height that it had
        surface.n_inserted += insert_post(next->face, v.x, v.y, [&v] { return v.z; }) ? 1 : 0;
      } else {
        posts_.prefetch_around(candidate.post);  // while the mesh makes room for it
        const auto [post_x, post_y] = posts_.position(candidate.post);
        const std::int64_t x = floor_of(post_x + 0.5), y = floor_of(post_y + 0.5);
        const auto height = [&] { return field_->lattice_height(west_ + x, south_ + y); };
        surface.n_inserted += insert_post(next->face, x, y, height) ? 1 : 0;
      }
      // A post whose lattice point has a vertex, or that lies beside the face, leaves the face as it is.
      if (scanned_[static_cast<std::size_t>(next->face)].stamp != stamp) continue;
      scanner_.give_up(candidate.post);
      scan(next->face);
    }
    return true;
  }

  // With the height height(); false where there is a vertex already.
  template <class Height>
  bool insert_post(std::int32_t face, std::int64_t x, std::int64_t y, Height height) {
    const double at_x = static_cast<double>(x), at_y = static_cast<double>(y);
    const Mesh::Location where = mesh_.locate(at_x, at_y, face);
    if (where.place == Mesh::Place::kOnVertex) return false;
    const std::vector<std::int32_t> released = release_edges_beside(face, at_x, at_y);
    const std::int32_t v = mesh_.add_vertex(at_x, at_y, height());
    mesh_.insert(v, where);
    for (const std::int32_t end : released) {
      const std::int32_t edge = mesh_.find_edge(v, end);
      if (edge != Mesh::kNone) mesh_.set_fixed(edge, true);
    }
    scanned_.resize(static_cast<std::size_t>(mesh_.n_faces()));
    mesh_.for_faces_around(v, [this](std::int32_t f, int) { scan(f); });
    return true;
  }

  const HeightField* field_ = nullptr;
  const TileTask* task_ = nullptr;
  std::int64_t side_ = 0, west_ = 0, south_ = 0;
  double beside_ = 0;  // constraints that pass a vertex so closely run through it, lattice steps
  std::int32_t n_ring_ = 0;
  std::int32_t hint_ = 0;  // a face near the last vertex
  Mesh mesh_;
  TilePosts posts_;
  FaceScanner scanner_{mesh_, posts_};
  TileExtractor extractor_;
  struct Scanned {
    FaceCandidate candidate;
    std::uint32_t stamp = 0;  // counts the face's scans
  };
  std::vector<Scanned> scanned_;  // per face
  ErrorQueue queue_;
  const EarlierTile* earlier_ = nullptr;  // while it is repeated
  std::vector<Mesh::Vertex> earlier_vertices_;
  TilePosts::OfVertices of_vertices_;
  std::vector<std::uint32_t> order_;
};

TileRefiner& refiner() {
  // Memory of one tile's size per thread: tiles come by the thousand.
  thread_local TileRefiner refiner;
  return refiner;
}

}  // namespace

TileSurface triangulate(const HeightField& field, const TileTask& task, int threads) {
  return refiner().run(field, task, threads);
}

bool can_be_repeated(const HeightField& field) { return field.points.empty() && std::min(field.dx, field.dy) > 2; }

std::optional<TileSurface> repeat_triangulation(const HeightField& field, const TileTask& task,
                                                const EarlierTile& earlier, int threads) {
  return refiner().repeat(field, task, earlier, threads);
}

}  // namespace tind
