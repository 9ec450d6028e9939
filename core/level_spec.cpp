// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/level_spec.hpp"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <numbers>
#include <string>

#include "core/tile_key.hpp"

namespace tind {
namespace {

// A spacing like 1/1200 degree read from a file is off by rounding: it must not fall on the other side of a power of
// two.
constexpr double kSpacingSlack = 1e-9;
constexpr double kToleranceRule = 0.8;            // 4/5 of the spacing
constexpr double kHeightStepsPerTolerance = 256;  // zq <= E_bottom / 256
constexpr int kMaxHeightExponent = 16;
// Irregular posts may lie side by side on a wall: a lattice 8 times finer moves them by less than 1/4096 spacing.
constexpr int kIrregularLatticeLevels = 3;

}  // namespace

double top_spacing_deg() { return 360.0 / (kRootCountX * static_cast<double>(kCellsPerTile)); }

int level_of_spacing(double spacing_deg) {
  assert(spacing_deg > 0);
  return static_cast<int>(std::floor(std::log2(top_spacing_deg() / spacing_deg) + kSpacingSlack));
}

Result<LevelTable> make_level_table(double lon_spacing_deg, double lat_spacing_deg, const LevelOptions& options) {
  const auto refuse = [](std::string why) { return fail(ErrorKind::kInvalidInput, std::move(why)); };
  if (!(lon_spacing_deg > 0) || !(lat_spacing_deg > 0)) return refuse("the spacing between posts must be positive");
  if (options.tolerance_m && !(*options.tolerance_m > 0)) return refuse("--tolerance must be above 0 m");
  if (options.finest_m && !(*options.finest_m > 0)) return refuse("--finest must be above 0 m");
  if (options.tolerance_m && options.finest_m) {
    return refuse("--tolerance sets E of the bottom level and --finest adds levels below it: give one of them");
  }
  for (std::size_t k = 0; k < options.coarser_tolerances_m.size(); ++k) {
    const double finer = k ? options.coarser_tolerances_m[k - 1] : options.tolerance_m.value_or(0);
    if (!options.tolerance_m || !(options.coarser_tolerances_m[k] > finer)) {
      return refuse("--tolerance takes E of the bottom level first, then of each coarser level, always larger");
    }
  }
  const int n = level_of_spacing(lon_spacing_deg);
  int bottom = n + 1;
  double spacing_deg = lon_spacing_deg;
  if (options.mode == LevelMode::kStandard) {
    if (lon_spacing_deg >= 0.75 * std::ldexp(top_spacing_deg(), -n)) bottom = n;
    spacing_deg = std::ldexp(top_spacing_deg(), -bottom);
  }
  if (bottom < 0) {  // a source coarser than the top level: one level, spacing its own
    bottom = 0;
  }
  LevelTable table;
  table.rule_bottom_level = bottom;
  double spacing_m = spacing_deg * options.metres_per_degree;
  const int table_level = bottom;  // the tolerance's own level
  const double table_m = options.tolerance_m.value_or(kToleranceRule * spacing_m);
  const auto tolerance_of = [&](int level) {
    const auto& coarser = options.coarser_tolerances_m;
    const int above = table_level - level, listed = static_cast<int>(coarser.size());
    if (above <= 0 || listed == 0) return std::ldexp(table_m, above);
    return above <= listed ? coarser[static_cast<std::size_t>(above) - 1] : std::ldexp(coarser.back(), above - listed);
  };
  const auto shift = [&](int levels) {  // negative: coarser
    bottom += levels;
    spacing_m = std::ldexp(spacing_m, -levels);
  };
  if (options.finest_m) {
    while (tolerance_of(bottom) > *options.finest_m && bottom <= kMaxLevel) shift(1);
  }
  if (options.max_level) {
    if (*options.max_level < 0) return refuse("--max-level must not be negative");
    if (*options.max_level < bottom) shift(*options.max_level - bottom);
  }
  // A post may be rounded by at most 1/512 of the finer spacing, also where --max-level stops early. On a slope that
  // moves it off the terrain, so a tolerance below the rule's takes a lattice that is finer in proportion.
  table.lattice_level = std::max({bottom, n + 1, level_of_spacing(lat_spacing_deg) + 1, 0});
  const double tolerance_m = tolerance_of(bottom);
  const double times_tighter = kToleranceRule * spacing_m / tolerance_m;
  if (times_tighter > 1) table.lattice_level += static_cast<int>(std::ceil(std::log2(times_tighter) - kSpacingSlack));
  if (options.irregular_posts) table.lattice_level += kIrregularLatticeLevels;
  if (table.lattice_level > kMaxLevel) {
    return refuse("that takes level " + std::to_string(table.lattice_level) + "; the deepest possible is " +
                  std::to_string(kMaxLevel) + ": give a coarser --finest, --tolerance or --max-level");
  }
  // Never coarser than a metre, so that integer metres stay exact.
  const double exponent = std::ceil(std::log2(kHeightStepsPerTolerance / tolerance_m));
  table.height_exponent = static_cast<int>(std::clamp(exponent, 0.0, static_cast<double>(kMaxHeightExponent)));
  for (int level = 0; level <= bottom; ++level) {
    table.levels.push_back({std::ldexp(spacing_m, bottom - level), tolerance_of(level)});
  }
  return table;
}

int seed_segments(int level, double tolerance_m, double radius_m) {
  constexpr std::array<int, 7> kSegments = {16, 8, 8, 4, 4, 2, 2};
  int segments = static_cast<std::size_t>(level) < kSegments.size() ? kSegments[static_cast<std::size_t>(level)] : 1;
  const double tile_rad = std::numbers::pi / std::ldexp(1.0, level);
  // Sagitta of a chord over one segment.
  while (radius_m * (1 - std::cos(tile_rad / segments / 2)) > tolerance_m && segments < 256) segments *= 2;
  return segments;
}

}  // namespace tind
