// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/mesh.hpp"
#include "core/post_strip.hpp"
#include "core/triangulator.hpp"
#include "core/triangulator_posts.hpp"
#include "core/triangulator_scan.hpp"
#include "core/virtual_node.hpp"

namespace tind {

/// Errors of a tile's finished mesh at the source's own posts with west <= X < east, south <= Y < north, each counted
/// once (docs/format.md 5). Reads what it is given, which must outlive it.
class TileErrors {
 public:
  /// `vertices`: the triangles' corners by their index, local lattice steps; `side`: of the tile. `at_pole`: nothing
  /// lies north of the tile, so the posts on its north side count, too. `quantum`: that of
  /// the tile's tolerance.
  TileErrors(const TilePosts& posts, const FaceScanner& scanner, std::span<const Mesh::Vertex> vertices,
             std::span<const Triangle> triangles, double side, bool at_pole, const SquareQuantum& quantum)
      : posts_(posts),
        scanner_(scanner),
        vertices_(vertices),
        triangles_(triangles),
        side_(side),
        at_pole_(at_pole),
        quantum_(quantum) {}

  /// Errors of cells under the same mesh, to be taken over where no post has changed.
  struct Known {
    std::span<const CellErrors> cells;
    std::vector<bool> is_changed;
  };

  /// Sets the surface's cells, and of its figures n_posts, max_error_m (never less than it is) and rmse_m, which are
  /// made of the cells. Those of one cell depend on the mesh and the cell's own posts alone. Works on `threads` >= 1
  /// threads; the result does not depend on them. 0 <= n_cell_levels <= kMostCellLevels; `known` may be null.
  void measure(int n_cell_levels, int threads, const Known* known, TileSurface& surface) const;

 private:
  struct Sums {
    double largest_m = 0;
    std::uint64_t n = 0;
    Quanta n_quanta = 0;
    void add(const Sums& s) {
      largest_m = greater(s.largest_m, largest_m);
      n += s.n;
      n_quanta += s.n_quanta;
    }
  };
  // The posts of a cell in a window.
  struct Cell {
    const PostWindow& window;
    PostBlocks::Extent posts;
    bool all_source = false;
  };
  // The first row and the first column of each row and column of cells in a window, and their end.
  struct CellLines {
    std::vector<std::int64_t> rows, cols;
  };
  class OfTriangle;
  class Buckets;

  CellLines cell_lines(const PostWindow& w, int n_cell_levels) const;
  void add_window(const PostWindow& w, const CellLines& lines, int threads, const std::vector<bool>& wanted,
                  std::vector<CellErrors>& cells) const;
  Sums of_triangles(const Cell& cell, std::span<const std::uint32_t> triangles, const SquareQuantum& quantum) const;
  Sums one_by_one(const Cell& cell, const SquareQuantum& quantum) const;
  Sums of_points(const SquareQuantum& quantum) const;
  template <class Measure>
  void add_with_fitting_quantum(Sums sums, Measure again, CellErrors& to) const;
  PlanTriangle moved_plan_of(const Triangle& t) const;
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
  const SquareQuantum quantum_;
};

}  // namespace tind
