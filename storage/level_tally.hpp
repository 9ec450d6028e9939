// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <map>
#include <utility>

#include "core/virtual_node.hpp"
#include "storage/manifest.hpp"

namespace tind {

/// What of a level is given, not counted: level, tolerance_m, spacing_m and height_step_m; the rest is zero.
LevelInfo uncounted(const LevelInfo& level);

/// Counts the pieces of one level, in storage order, into what the manifest says of it. What is written tile by tile,
/// taken over from an earlier file or merged from shards is counted by the same sums in the same order.
class LevelTally {
 public:
  /// `info`: as uncounted() makes it. `semi_major_m`: of the ellipsoid.
  LevelTally(LevelInfo info, double semi_major_m);

  void add_corner(std::size_t n_bytes);
  void add_edge(std::size_t n_inner, std::size_t n_bytes);
  void add_body(const TileKey& key, const TileStats& stats, std::uint64_t n_interior, std::uint64_t n_triangles,
                std::size_t n_bytes);
  /// All that was added.
  LevelInfo finish();

 private:
  LevelInfo info_;
  std::uint64_t seeds_per_axis_;
  double squares_ = 0;
  std::map<std::pair<std::uint32_t, std::uint32_t>, TileCoverage> coverage_;  // by y, x
};

}  // namespace tind
