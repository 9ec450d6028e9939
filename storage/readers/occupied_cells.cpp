// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/occupied_cells.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/tile_key.hpp"

namespace tind {
namespace {

/// Ascending cells at a level one coarser, each once.
void halve(std::vector<std::uint64_t>& cells) {
  for (std::uint64_t& cell : cells) cell >>= 2;
  cells.erase(std::unique(cells.begin(), cells.end()), cells.end());
}

}  // namespace

void OccupiedCells::add(double lon_deg, double lat_deg) {
  const double per_degree = std::exp2(kFinest) / 360.0;
  const auto column = static_cast<std::uint32_t>((lon_deg + 180.0) * per_degree);
  const auto row = static_cast<std::uint32_t>((lat_deg + 90.0) * per_degree);
  const std::uint64_t cell = morton_code(column, row) >> 2 * (kFinest - level_);
  // Neighbours in a file are neighbours on the ground.
  if (!pending_.empty() && pending_.back() == cell) return;
  pending_.push_back(cell);
  if (pending_.size() == kMaxCells) merge();
}

void OccupiedCells::merge() {
  const auto n = static_cast<std::ptrdiff_t>(cells_.size());
  std::sort(pending_.begin(), pending_.end());
  cells_.insert(cells_.end(), pending_.begin(), pending_.end());
  pending_.clear();
  std::inplace_merge(cells_.begin(), cells_.begin() + n, cells_.end());
  cells_.erase(std::unique(cells_.begin(), cells_.end()), cells_.end());
  for (; cells_.size() > kMaxCells; --level_) halve(cells_);
}

double OccupiedCells::area_m2(std::uint64_t n_points, double metres_per_degree) {
  merge();
  std::vector<std::uint64_t> cells = cells_;
  int level = level_;
  for (; level > 0 && n_points < kPointsPerCell * cells.size(); --level) halve(cells);
  const double side_deg = 360.0 / std::exp2(level), side_m = side_deg * metres_per_degree;
  double area = 0;
  for (const std::uint64_t cell : cells) {
    const double lat_deg = (static_cast<double>(morton_decode_even(cell >> 1)) + 0.5) * side_deg - 90.0;
    area += side_m * side_m * std::max(0.0, std::cos(lat_deg * std::numbers::pi / 180.0));
  }
  return area;
}

}  // namespace tind
