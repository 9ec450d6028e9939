// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/mesh.hpp"
#include "core/triangulator_posts.hpp"
#include "core/triangulator_scan.hpp"
#include "core/virtual_node.hpp"

namespace tind {

/// Errors of a tile's finished mesh at the source's own posts with west <= X < east, south <= Y < north, each counted
/// once (docs/format.md 5). Reads what it is given, which must outlive it.
class TileErrors {
 public:
  /// `vertices`: the triangles' corners by their index, local lattice steps; `side`: of the tile. `at_pole`: nothing
  /// lies north of the tile, so the posts on its north side count, too.
  TileErrors(const TilePosts& posts, const FaceScanner& scanner, std::span<const Mesh::Vertex> vertices,
             std::span<const Triangle> triangles, double side, bool at_pole)
      : posts_(posts), scanner_(scanner), vertices_(vertices), triangles_(triangles), side_(side), at_pole_(at_pole) {}

  /// Sets n_posts, max_error_m (never less than it is) and rmse_m. Works on `threads` >= 1 threads; the result does not
  /// depend on them.
  void measure(int threads, TileStats& stats) const;

 private:
  struct Sums : StripErrors {
    void add(double error_m) {
      largest_m = greater(error_m, largest_m);
      sum_m2 += error_m * error_m;
      ++n;
    }
    void add(const StripErrors& e) {
      largest_m = greater(e.largest_m, largest_m);
      sum_m2 += e.sum_m2;
      n += e.n;
    }
  };
  // The posts of a window that count.
  struct Measured {
    const PostWindow& window;
    std::int64_t n_rows = 0, n_cols = 0;
    bool all_source = false;
  };
  class OfTriangle;

  Sums of_window(const PostWindow& w, int threads) const;
  Sums of_triangles(const Measured& m, std::span<const Triangle> triangles) const;
  Sums one_by_one(const Measured& m) const;
  Sums of_points() const;
  PlanTriangle plan_of(const Triangle& t) const {
    const Mesh::Vertex &a = vertices_[t[0]], &b = vertices_[t[1]], &c = vertices_[t[2]];
    return {{a.x, b.x, c.x}, {a.y, b.y, c.y}};
  }
  FacePlane plane_of(const Triangle& t) const {
    return scanner_.plane_through(vertices_[t[0]], vertices_[t[1]], vertices_[t[2]]);
  }

  const TilePosts& posts_;
  const FaceScanner& scanner_;
  const std::span<const Mesh::Vertex> vertices_;
  const std::span<const Triangle> triangles_;
  const double side_;
  const bool at_pole_;
};

}  // namespace tind
