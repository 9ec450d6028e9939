// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <vector>

#include "core/mesh.hpp"
#include "core/post_strip.hpp"
#include "core/triangulator.hpp"
#include "core/triangulator_guard.hpp"
#include "core/triangulator_posts.hpp"

namespace tind {

/// Plane through a triangle: z = z_a + slope_x (x - x_a) + slope_y (y - y_a), metres over local lattice steps.
struct FacePlane {
  double x_a, y_a, z_a, slope_x, slope_y;
  double at(double x, double y) const { return z_a + slope_x * (x - x_a) + slope_y * (y - y_a); }
};

/// The same over the posts of a window.
inline PlaneOverPosts plane_over(const FacePlane& p, const PostWindow& w) {
  return {p.z_a + p.slope_x * (w.x0 - p.x_a), p.slope_y, w.y0, w.dy, p.y_a, p.slope_x * w.dx};
}

/// The post of a face that is to become a vertex.
struct FaceCandidate {
  float error_m = 0;       ///< Its claim to be the next one, the tolerance or more; 0: none.
  std::int64_t post = -1;  ///< TilePosts index.
};

/// Finds the worst posts of faces. Reads the mesh and the posts, which must outlive it; no own decision depends on
/// what was scanned before.
class FaceScanner {
 public:
  FaceScanner(const Mesh& mesh, const TilePosts& posts) : mesh_(mesh), posts_(posts) {}

  void reset(const HeightField& field, const TileTask& task);

  /// Of the face's posts that may become vertices (that round to a free lattice point inside the tile) the worst one
  /// beyond the tolerance as the mesh is, whatever finer borders lie beside it; where there is none, the worst one
  /// beyond it as quantized-mesh serves the mesh, with the claim of one at the tolerance. Each post has a place in this
  /// order of its own, whatever the face's other posts are (docs/decisions/0013).
  FaceCandidate scan(std::int32_t face) const;

  /// Bound of the step that quantized-mesh rounds the tile's inner heights to: of all posts, a power of two.
  double served_step_m() const { return 2 * served_rounding_m_; }

  /// From now on this post is no candidate: its lattice point has a vertex.
  void give_up(std::int64_t post) { given_up_.push_back(post); }

  /// Corners counter-clockwise.
  FacePlane plane_through(const Mesh::Vertex& a, const Mesh::Vertex& b, const Mesh::Vertex& c) const;

  double rounding_of(const FacePlane& plane) const;
  /// Bound of |plane - h| over the posts of a block that lies at `e` in a window.
  double plane_bound(const FacePlane& plane, const PostWindow& w, const PostBlock& block,
                     const PostBlocks::Extent& e) const;

 private:
  double served_height_step() const;
  FacePlane plane_of(std::int32_t face) const;
  FacePlane served_plane_of(std::int32_t face, const FacePlane& plane) const;
  FaceCandidate scan_thoroughly(std::int32_t face, const FacePlane& plane, double least_own_m) const;
  double served_distance(std::int32_t face, const FacePlane& plane) const;
  bool may_become_vertex(std::int32_t face, double x, double y, std::int64_t post) const;
  bool is_near_base(std::int32_t face, const Guard& guard) const;

  const Mesh& mesh_;
  const TilePosts& posts_;
  const HeightField* field_ = nullptr;
  const TileTask* task_ = nullptr;
  BorderGuard guard_;
  double side_ = 0, unit_m_ = 1;
  double served_step_ = 0;        // of positions, lattice steps
  double served_rounding_m_ = 0;  // of inner heights
  std::int32_t n_ring_ = 0;
  std::vector<std::int64_t> given_up_;
};

}  // namespace tind
