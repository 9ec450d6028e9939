// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/height_field.hpp"
#include "core/result.hpp"
#include "core/virtual_node.hpp"
#include "storage/report/pyramid_file.hpp"

namespace tind {

/// How far a surface is from the posts that it was measured at. Metres.
struct SurfaceErrors {
  std::uint64_t n_posts = 0;
  double squares_m2 = 0;  ///< Sum of the squared errors.
  double max_m = 0;

  double rmse_m() const;
  /// The same in the same order gives the same bits.
  void add(double error_m);
  void add(const SurfaceErrors& other);
};

/// Where heights of a mesh are asked for: real positions, in lattice steps from the tile's SW corner.
struct MeshPosition {
  double x = 0, y = 0;
};

/// Heights in metres of the assembled tile's surface at the rectangular grid xs x ys (both ascending, in lattice steps
/// from the SW corner), row-major with xs fastest; NaN outside the tile. Planes are evaluated between their edges only,
/// so nothing is extrapolated. Pure, thread safe.
std::vector<double> sample_mesh(const VirtualNode& tile, double height_unit_m, std::span<const double> xs,
                                std::span<const double> ys);
/// The same at scattered positions.
std::vector<double> sample_mesh(const VirtualNode& tile, double height_unit_m, std::span<const MeshPosition> at);

/// The surface of one level at the posts of a height field.
struct LevelSurface {
  SurfaceErrors errors;  ///< At the posts that carry the promise: source posts, or the irregular ones if there are any.
  std::uint64_t n_missed = 0;  ///< Of those, posts in no tile (a damaged file).
};

/// Samples level `level` of the file at all posts of the grid that are source, interpolated or filled and measures the
/// error. `heights_m`, if not null: n_rows * n_cols floats of the field's grid that are set there and left alone
/// elsewhere. The result does not depend on `threads`. kCorrupt when a tile cannot be read.
Result<LevelSurface> sample_level(const PyramidFile& file, int level, const HeightField& field, int threads,
                                  float* heights_m);

/// Vertices of one level, each border vertex counted once, by the grid post nearest to them.
struct VertexCounts {
  std::uint64_t data = 0;     ///< Nearest to a post of the source.
  std::uint64_t voids = 0;    ///< Nearest to a filled post of an interior void.
  std::uint64_t outside = 0;  ///< Beyond the data.
};

/// kCorrupt when a piece cannot be read.
Result<VertexCounts> count_vertices(const PyramidFile& file, int level, const HeightField& field);

}  // namespace tind
