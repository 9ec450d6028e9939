// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/occupied_cells.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

namespace tind {
namespace {

constexpr std::uint64_t kLow32 = 0xffffffff;

/// The cell of twice the side that holds a cell (column in the high half, row in the low one).
std::uint64_t parent(std::uint64_t cell) { return (cell >> 33 << 32) | ((cell & kLow32) >> 1); }

}  // namespace

void OccupiedCells::add(double lon_deg, double lat_deg) {
  const double per_degree = std::exp2(kFinest) / 360.0;
  const auto column = static_cast<std::uint64_t>((lon_deg + 180.0) * per_degree);
  const auto row = static_cast<std::uint64_t>((lat_deg + 90.0) * per_degree);
  cells_.insert((column >> (kFinest - level_)) << 32 | row >> (kFinest - level_));
  while (cells_.size() > kMaxCells) {
    std::unordered_set<std::uint64_t> coarser;
    for (const std::uint64_t cell : cells_) coarser.insert(parent(cell));
    cells_ = std::move(coarser);
    --level_;
  }
}

double OccupiedCells::area_m2(std::uint64_t n_points, double metres_per_degree) const {
  std::vector<std::uint64_t> cells(cells_.begin(), cells_.end());
  std::sort(cells.begin(), cells.end());
  int level = level_;
  while (level > 0 && n_points < kPointsPerCell * cells.size()) {
    for (std::uint64_t& cell : cells) cell = parent(cell);
    std::sort(cells.begin(), cells.end());
    cells.erase(std::unique(cells.begin(), cells.end()), cells.end());
    --level;
  }
  const double side_deg = 360.0 / std::exp2(level), side_m = side_deg * metres_per_degree;
  double area = 0;
  for (const std::uint64_t cell : cells) {
    const double lat_deg = (static_cast<double>(cell & kLow32) + 0.5) * side_deg - 90.0;
    area += side_m * side_m * std::max(0.0, std::cos(lat_deg * std::numbers::pi / 180.0));
  }
  return area;
}

}  // namespace tind
