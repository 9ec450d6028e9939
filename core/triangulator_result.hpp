// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <vector>

#include "core/mesh.hpp"
#include "core/triangulator.hpp"
#include "core/triangulator_posts.hpp"
#include "core/triangulator_scan.hpp"

namespace tind {

/// Brings a finished mesh into the order of docs/format.md 5 and measures it. Storage is kept from tile to tile.
class TileExtractor {
 public:
  /// Interior vertices in Morton order, triangles in local order, lowest and highest vertex. The first `n_ring`
  /// vertices of the mesh are the ring, in local order.
  void extract(const Mesh& mesh, std::int32_t n_ring, TileSurface& surface);

  /// Of the mesh extracted last: error and RMSE at the source's own posts with west <= X < east, south <= Y < north,
  /// each counted once (docs/format.md 5). `at_pole`: nothing lies north of the tile, so the posts on its north side
  /// count, too.
  void measure(const Mesh& mesh, const TilePosts& posts, const FaceScanner& scanner, double side, bool at_pole,
               TileStats& stats);

 private:
  struct Errors {
    double largest = 0, sum = 0;
    std::uint64_t n = 0;
    void add(double error) {
      largest = error > largest ? error : largest;
      sum += error * error;
      ++n;
    }
  };
  void measure_window(const Mesh& mesh, const TilePosts& posts, const PostWindow& w, const FaceScanner& scanner,
                      double side, bool at_pole, Errors& errors);
  Errors measure_one_by_one(const Mesh& mesh, const TilePosts& posts, const PostWindow& w, const FaceScanner& scanner,
                            std::int64_t n_rows, std::int64_t n_cols);
  void measure_points(const Mesh& mesh, const TilePosts& posts, const FaceScanner& scanner, double side, bool at_pole,
                      Errors& errors);

  std::vector<LocalVertex> interior_;
  std::vector<Triangle> turned_;
  std::vector<std::uint32_t> order_, index_, first_;  // of the interior; per vertex: local order, next triangle
  std::vector<std::int32_t> faces_;                   // in the order of the triangles: near ones lie together
  std::vector<bool> seen_;                            // per post
};

/// Indices of points in Morton order of (x, y); of equal ones the first comes first. 0 <= x, y.
void morton_order(const std::vector<LocalVertex>& points, std::vector<std::uint32_t>& order);

}  // namespace tind
