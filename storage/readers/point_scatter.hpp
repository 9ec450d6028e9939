// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/height_field.hpp"
#include "core/result.hpp"
#include "storage/readers/cancel.hpp"
#include "storage/readers/point_source.hpp"
#include "storage/readers/scratch_map.hpp"

namespace tind {

/// Where the blocks lie (as PointBlocks) and what sorting may take.
struct ScatterOptions {
  Lattice lattice;
  double x_turn = 0;      ///< Added to every x: 0 or the lattice's width.
  double x0 = 0, y0 = 0;  ///< Halves of odd numbers, so that no point and its rounded position lie in two blocks.
  double side = 1;        ///< A whole number.
  std::int64_t n_rows = 0, n_cols = 0;
  std::string scratch_dir;
  std::uint64_t memory_bytes = 0;
  CancelFlag cancel = nullptr;
};

/// The points of a source sorted into blocks: of the points that round to one lattice position only the lowest. Ties go
/// to the southern, then the western one.
struct ScatteredPoints {
  ScratchMap map;
  std::vector<std::uint64_t> first;  ///< n_rows * n_cols + 1 offsets.
  std::uint64_t n_duplicates = 0;

  const PointPost* posts() const { return static_cast<const PointPost*>(map.data()); }
};

/// Counting sort through two scratch files: the points in the source's order, then by block. Order and bytes of the
/// result do not depend on the source's order or on memory_bytes. Precondition: all points lie in the blocks.
/// kInterrupted: options.cancel.
Result<ScatteredPoints> scatter_points(const PointSource& source, const ScatterOptions& options,
                                       const std::function<void(double)>& progress);

/// Lattice position of a point: real, not rounded.
inline double lattice_x(const Lattice& lattice, double lon_deg) { return (lon_deg + 180.0) / lattice.step_deg(); }
inline double lattice_y(const Lattice& lattice, double lat_deg) { return (lat_deg + 90.0) / lattice.step_deg(); }

}  // namespace tind
