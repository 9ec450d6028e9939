// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/level_spec.hpp"

#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "core/lattice.hpp"

namespace tind {
namespace {

constexpr double kMetresPerDegree = 6378137.0 * std::numbers::pi / 180;

LevelOptions at_equator() {
  LevelOptions options;
  options.metres_per_degree = kMetresPerDegree;
  return options;
}

LevelTable table_of(double spacing_deg, const LevelOptions& options = at_equator()) {
  const auto table = make_level_table(spacing_deg, spacing_deg, options);
  EXPECT_TRUE(table) << (table ? "" : table.error().message);
  return table.value_or(LevelTable{});
}

double tolerance(const LevelTable& t, int level) { return t.levels.at(static_cast<std::size_t>(level)).tolerance_m; }

// The worked examples of the paper's Table 1 and the design.
TEST(LevelSpec, Gives10MetrePostsEightMetresAndDoublesUpwards) {
  const LevelTable t = table_of(10 / kMetresPerDegree);
  const int bottom = t.bottom_level();
  EXPECT_NEAR(tolerance(t, bottom), 8, 1e-9);
  EXPECT_NEAR(tolerance(t, bottom - 1), 16, 1e-9);
  EXPECT_NEAR(tolerance(t, bottom - 2), 32, 1e-9);
  EXPECT_NEAR(tolerance(t, bottom - 3), 64, 1e-9);
  for (int level = 0; level < bottom; ++level) {
    EXPECT_EQ(tolerance(t, level), 2 * tolerance(t, level + 1));
    EXPECT_EQ(t.levels[static_cast<std::size_t>(level)].spacing_m,
              2 * t.levels[static_cast<std::size_t>(level) + 1].spacing_m);
  }
}

TEST(LevelSpec, EndsOneArcSecondAtLevel12With24Point7Metres) {
  const LevelTable t = table_of(1.0 / 3600);
  EXPECT_EQ(t.bottom_level(), 12);
  EXPECT_NEAR(tolerance(t, 12), 24.7, 0.05);
}

TEST(LevelSpec, EndsHalfAMetreAtLevel18With40Centimetres) {
  const LevelTable t = table_of(0.5 / kMetresPerDegree);
  EXPECT_EQ(t.bottom_level(), 18);
  EXPECT_NEAR(tolerance(t, 18), 0.4, 1e-9);
}

TEST(LevelSpec, FindsNByTheTurnedInequality) {
  const double top = top_spacing_deg();
  EXPECT_DOUBLE_EQ(top, 360.0 / 512);
  for (int n = 0; n < 20; ++n) {
    EXPECT_EQ(level_of_spacing(std::ldexp(top, -n)), n);
    EXPECT_EQ(level_of_spacing(std::ldexp(top, -n) * 0.501), n);
    EXPECT_EQ(level_of_spacing(std::ldexp(top, -n) * 0.499), n + 1);
    // A spacing that a file rounds stays on its side.
    EXPECT_EQ(level_of_spacing(std::nextafter(std::ldexp(top, -n), 1)), n);
  }
}

TEST(LevelSpec, TakesTheNearerLevelInStandardMode) {
  LevelOptions options = at_equator();
  options.mode = LevelMode::kStandard;
  const double level9 = std::ldexp(top_spacing_deg(), -9);
  for (const auto& [share, bottom] : {std::pair{1.0, 9}, {0.76, 9}, {0.75, 9}, {0.74, 10}, {0.51, 10}}) {
    const LevelTable t = table_of(level9 * share, options);
    EXPECT_EQ(t.bottom_level(), bottom) << share;
    EXPECT_NEAR(t.levels.back().spacing_m, std::ldexp(top_spacing_deg(), -bottom) * kMetresPerDegree, 1e-9);
    EXPECT_DOUBLE_EQ(t.levels.back().tolerance_m, 0.8 * t.levels.back().spacing_m);
  }
}

TEST(LevelSpec, KeepsALevelsToleranceWhereMaxLevelStopsEarlier) {
  LevelOptions options = at_equator();
  const LevelTable whole = table_of(1.0 / 3600, options);
  options.max_level = 7;
  const LevelTable t = table_of(1.0 / 3600, options);
  EXPECT_EQ(t.bottom_level(), 7);
  for (int level = 0; level <= 7; ++level) EXPECT_EQ(tolerance(t, level), tolerance(whole, level));
  EXPECT_EQ(t.lattice_level, whole.lattice_level);  // posts are rounded as finely as before
  options.max_level = 20;
  EXPECT_EQ(table_of(1.0 / 3600, options).bottom_level(), 12);
}

TEST(LevelSpec, GoesOnHalvingDownToFinest) {
  LevelOptions options = at_equator();
  options.finest_m = 20;
  const LevelTable t = table_of(1.0 / 1200, options);  // 74 m by the rule
  EXPECT_EQ(t.rule_bottom_level, 10);
  EXPECT_EQ(t.bottom_level(), 12);
  EXPECT_NEAR(tolerance(t, 12), 0.8 * kMetresPerDegree / 1200 / 4, 1e-9);
  EXPECT_EQ(t.lattice_level, 12);
  options.finest_m = 100;
  EXPECT_EQ(table_of(1.0 / 1200, options).bottom_level(), 10);
}

TEST(LevelSpec, TakesToleranceForTheBottomLevel) {
  LevelOptions options = at_equator();
  options.tolerance_m = 5;
  const LevelTable t = table_of(1.0 / 1200, options);
  EXPECT_EQ(t.bottom_level(), 10);
  EXPECT_EQ(tolerance(t, 10), 5);
  EXPECT_EQ(tolerance(t, 8), 20);
  // 74 m by the rule: posts are rounded as much more finely, and never more coarsely.
  EXPECT_EQ(t.lattice_level, 14);
  options.tolerance_m = 500;
  EXPECT_EQ(table_of(1.0 / 1200, options).lattice_level, 10);
  options.tolerance_m = 1e-9;
  EXPECT_FALSE(make_level_table(1.0 / 1200, 1.0 / 1200, options));
}

TEST(LevelSpec, RoundsHeightsAndPostsFinelyEnough) {
  for (const double spacing_m : {0.5, 1.0, 3.3, 10.0, 30.9, 92.7, 1000.0, 20000.0}) {
    for (const double ratio : {1.0, 0.5, 3.0}) {  // latitude against longitude
      const double lon = spacing_m / kMetresPerDegree, lat = lon * ratio;
      const auto t = make_level_table(lon, lat, at_equator());
      ASSERT_TRUE(t);
      Lattice lattice;
      lattice.level = t->lattice_level;
      lattice.height_exponent = t->height_exponent;
      // zq <= E_bottom / 256, but never coarser than a metre; not finer than needed.
      EXPECT_LE(lattice.height_unit_m(), std::min(1.0, t->levels.back().tolerance_m / 256)) << spacing_m;
      if (t->height_exponent > 0) {
        EXPECT_GT(2 * lattice.height_unit_m(), t->levels.back().tolerance_m / 256);
      }
      // A post moves by at most half a lattice step: 1/512 of a spacing.
      EXPECT_LE(lattice.step_deg(), std::min(lon, lat) / 256) << spacing_m << ' ' << ratio;
      EXPECT_GE(lattice.level, t->bottom_level());
    }
  }
}

TEST(LevelSpec, TakesATableOfTolerancesFromTheBottomUp) {
  LevelOptions options = at_equator();
  options.tolerance_m = 8;
  options.coarser_tolerances_m = {20, 36};
  const auto t = make_level_table(1.0 / 3600, 1.0 / 3600, options);
  ASSERT_TRUE(t) << t.error().message;
  const int bottom = t->bottom_level();
  const std::vector<double> upwards = {8, 20, 36, 72, 144};
  for (int k = 0; k < 5; ++k) {
    EXPECT_EQ(t->levels[static_cast<std::size_t>(bottom - k)].tolerance_m, upwards[static_cast<std::size_t>(k)]) << k;
  }
  options.max_level = bottom - 1;
  EXPECT_EQ(make_level_table(1.0 / 3600, 1.0 / 3600, options)->levels.back().tolerance_m, 20);
  options = at_equator();
  options.coarser_tolerances_m = {20};  // of what?
  EXPECT_FALSE(make_level_table(1.0 / 3600, 1.0 / 3600, options));
  options.tolerance_m = 20;
  EXPECT_FALSE(make_level_table(1.0 / 3600, 1.0 / 3600, options));
}

TEST(LevelSpec, GivesIrregularPostsAFinerLattice) {
  LevelOptions options = at_equator();
  const auto grid = make_level_table(1e-5, 1e-5, options);
  options.irregular_posts = true;
  const auto points = make_level_table(1e-5, 1e-5, options);
  ASSERT_TRUE(grid && points);
  EXPECT_EQ(points->lattice_level, grid->lattice_level + 3);
  EXPECT_EQ(points->levels.back().tolerance_m, grid->levels.back().tolerance_m);
}

TEST(LevelSpec, RefusesContradictionsInOneLine) {
  const auto kind_of = [](double lon, double lat, const LevelOptions& options) {
    const auto t = make_level_table(lon, lat, options);
    return t ? -1 : static_cast<int>(t.error().kind);
  };
  const int invalid = static_cast<int>(ErrorKind::kInvalidInput);
  EXPECT_EQ(kind_of(0, 0.1, at_equator()), invalid);
  EXPECT_EQ(kind_of(0.1, -1, at_equator()), invalid);
  EXPECT_EQ(kind_of(std::nan(""), 0.1, at_equator()), invalid);
  LevelOptions options = at_equator();
  options.tolerance_m = 0;
  EXPECT_EQ(kind_of(0.1, 0.1, options), invalid);
  options.tolerance_m = 5;
  options.finest_m = 3;
  EXPECT_EQ(kind_of(0.1, 0.1, options), invalid);
  options = at_equator();
  options.max_level = -1;
  EXPECT_EQ(kind_of(0.1, 0.1, options), invalid);
  options = at_equator();
  options.finest_m = 1e-9;
  EXPECT_EQ(kind_of(0.1, 0.1, options), invalid);
  EXPECT_EQ(kind_of(1e-12, 1e-12, at_equator()), invalid);
}

TEST(LevelSpec, GivesASourceCoarserThanTheTopOneLevel) {
  const LevelTable t = table_of(2.5);
  EXPECT_EQ(t.bottom_level(), 0);
  EXPECT_NEAR(t.levels[0].spacing_m, 2.5 * kMetresPerDegree, 1e-6);
}

TEST(Seeds, FollowTheTableAndKeepChordsAboveTheTolerance) {
  constexpr double kRadius = 6378137;
  const std::vector<int> table = {16, 8, 8, 4, 4, 2, 2, 1, 1, 1};
  for (int level = 0; level < 10; ++level) {
    // SRTM's tolerances: the table is enough.
    EXPECT_EQ(seed_segments(level, std::ldexp(24.7, 12 - level), kRadius), table[static_cast<std::size_t>(level)])
        << level;
  }
  for (int level = 0; level < 10; ++level) {
    const double tolerance_m = std::ldexp(0.4, 18 - level) / 16;
    const int segments = seed_segments(level, tolerance_m, kRadius);
    EXPECT_EQ(segments & (segments - 1), 0);
    const double angle = std::numbers::pi / std::ldexp(segments, level);
    EXPECT_TRUE(kRadius * (1 - std::cos(angle / 2)) <= tolerance_m || segments == 256) << level;
  }
}

}  // namespace
}  // namespace tind
