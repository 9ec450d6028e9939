// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace tind {

/// The area that points on the globe cover, in one pass over any number of them and bounded memory: the square cells
/// (in degrees, 360 / 2^k a side) that hold a point. k is the largest up to 30 with at most kMaxCells of them, and for
/// the area the largest with kPointsPerCell points a cell on average. The result depends on the points alone, not on
/// their order.
class OccupiedCells {
 public:
  static constexpr std::size_t kMaxCells = std::size_t{1} << 20;
  static constexpr std::uint64_t kPointsPerCell = 8;

  /// -180 <= lon_deg < 180, -90 <= lat_deg <= 90.
  void add(double lon_deg, double lat_deg);
  /// Square metres; `n_points`: that were added.
  double area_m2(std::uint64_t n_points, double metres_per_degree);

 private:
  static constexpr int kFinest = 30;

  /// Brings pending cells in.
  void merge();

  int level_ = kFinest;                 ///< k
  std::vector<std::uint64_t> cells_;    ///< Morton codes at level_ (column in the even bits), ascending, each once.
  std::vector<std::uint64_t> pending_;  ///< Morton codes at level_, not yet among cells_.
};

}  // namespace tind
