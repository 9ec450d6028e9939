// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <optional>
#include <vector>

#include "core/result.hpp"

namespace tind {

/// How the bottom level follows from the source's spacing (Zheng et al. 2016, 2.1, with the inequality of eq. 2 turned
/// round).
enum class LevelMode {
  kNonStandard,  ///< L_bottom = n + 1, its spacing the source's own (the paper's Table 1).
  kStandard,     ///< L_bottom the nearer of n and n + 1, its spacing D_top / 2^L_bottom.
};

/// What shapes the level table.
struct LevelOptions {
  LevelMode mode = LevelMode::kNonStandard;
  double metres_per_degree = 0;       ///< Turns the spacing in longitude into metres; > 0.
  std::optional<int> max_level;       ///< Stop at this level; E keeps the value it would have had there.
  std::optional<double> tolerance_m;  ///< E of the bottom level instead of the 4/5 rule.
  /// With tolerance_m: E of the levels above the bottom, upwards; each larger than the one before. Levels above the
  /// last double it.
  std::vector<double> coarser_tolerances_m;
  std::optional<double> finest_m;  ///< Go on below L_bottom, halving E, until E <= this.
  bool irregular_posts = false;    ///< Posts may lie far closer to each other than the spacing.
};

/// One level's spacing and vertical tolerance.
struct LevelSpec {
  double spacing_m = 0;
  double tolerance_m = 0;  ///< E_L
};

/// The level table, index = level, and the lattice that carries it.
struct LevelTable {
  std::vector<LevelSpec> levels;
  int rule_bottom_level = 0;  ///< L_bottom as the mode gives it, before --max-level and --finest.
  int lattice_level = 0;      ///< A tile of this level has 2^16 lattice steps a side.
  int height_exponent = 0;    ///< Heights are integers of 2^-k m.

  int bottom_level() const { return static_cast<int>(levels.size()) - 1; }
};

/// Spacing of level 0 in degrees: 360 / (nRootCountX * 256) (paper, eq. 1).
double top_spacing_deg();

/// The n of eq. 2: D_top / 2^(n+1) < spacing <= D_top / 2^n. Precondition: spacing_deg > 0. May be negative for
/// spacings coarser than D_top.
int level_of_spacing(double spacing_deg);

/// Levels for a source with the given spacing between posts. kInvalidInput when the options contradict each other or
/// ask for more than kMaxLevel levels.
Result<LevelTable> make_level_table(double lon_spacing_deg, double lat_spacing_deg, const LevelOptions& options);

/// Segments a side of the dyadic lattice of seeds at `level` (DESIGN "Seams": 16, 8, 8, 4, 4, 2, 2, then 1; more where
/// that would let a chord of the globe sink below the tolerance). A power of two. `radius_m`: of the globe.
int seed_segments(int level, double tolerance_m, double radius_m);

}  // namespace tind
