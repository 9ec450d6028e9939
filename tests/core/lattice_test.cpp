// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/lattice.hpp"

#include <cmath>

#include <gtest/gtest.h>

namespace tind {
namespace {

void expect_position(const std::array<double, 3>& p, double x, double y, double z, double within_m = 1e-3) {
  EXPECT_NEAR(p[0], x, within_m);
  EXPECT_NEAR(p[1], y, within_m);
  EXPECT_NEAR(p[2], z, within_m);
}

TEST(Lattice, PutsTheAxesOfTheEarthWhereTheyAre) {
  Lattice lattice;
  lattice.level = 3;
  const std::int64_t w = lattice.width(), h = lattice.height();
  EXPECT_EQ(w, 2 * h);
  EXPECT_EQ(h, std::int64_t{1} << 19);
  expect_position(lattice.globe_position({w / 2, h / 2, 0}), 6378137, 0, 0);
  expect_position(lattice.globe_position({0, h / 2, 0}), -6378137, 0, 0);
  expect_position(lattice.globe_position({w * 3 / 4, h / 2, 0}), 0, 6378137, 0);
  expect_position(lattice.globe_position({123, h, 0}), 0, 0, 6356752.3142);
  expect_position(lattice.globe_position({w / 2, 0, 0}), 0, 0, -6356752.3142);
}

// gdaltransform (PROJ 9.1) -s_srs EPSG:4979 -t_srs EPSG:4978.
TEST(Lattice, AgreesWithProjAwayFromTheAxes) {
  const Lattice lattice;
  expect_position(lattice.geodetic_to_ecef(-105.4858, 37.5775, 4372), -1352253.5795, -4880765.8165, 3871050.8195);
  expect_position(lattice.geodetic_to_ecef(86.925, 27.9881, 8848.86), 302769.9343, 5636026.2255, 2979493.4909);
  expect_position(lattice.geodetic_to_ecef(-70.6693, -33.4489, -12.5), 1763405.1140, -5026858.3454, -3495599.8302);
}

TEST(Lattice, TakesTheEllipsoidFromTheManifest) {
  Lattice lattice;
  lattice.ellipsoid = {"Mars 2000", 3396190, 169.894447223612};
  expect_position(lattice.geodetic_to_ecef(0, 90, 1000), 0, 0, 3376200 + 1000);
  expect_position(lattice.geodetic_to_ecef(180, 0, -8000), -3388190, 0, 0);
}

TEST(Lattice, CountsHeightsInPowersOfTwoOfAMetre) {
  Lattice lattice;
  lattice.height_exponent = 4;
  EXPECT_EQ(lattice.height_from_m(10), 160);
  EXPECT_EQ(lattice.height_from_m(-0.04), -1);
  EXPECT_EQ(lattice.height_from_m(0.03125), 1);  // halves away from zero
  EXPECT_EQ(lattice.height_from_m(-0.03125), -1);
  EXPECT_EQ(lattice.height_m(-7), -0.4375);
  for (int k = 0; k <= 16; ++k) {
    lattice.height_exponent = k;
    EXPECT_EQ(lattice.height_unit_m(), std::ldexp(1.0, -k));
    for (double metres = -12; metres < 12; metres += 0.0009765625 * 5) {
      for (const double at : {std::nextafter(metres, -99.0), metres, std::nextafter(metres, 99.0)}) {
        ASSERT_EQ(lattice.height_from_m(at), std::lround(std::ldexp(at, k))) << at << " in units of 2^-" << k;
      }
    }
  }
}

TEST(Lattice, IsTheSameForAllLevels) {
  Lattice lattice;
  lattice.level = 12;
  EXPECT_EQ(lattice.tile_side(12), 65536);
  for (int level = 0; level < 12; ++level) EXPECT_EQ(lattice.tile_side(level), 2 * lattice.tile_side(level + 1));
  EXPECT_DOUBLE_EQ(lattice.longitude_deg(lattice.tile_side(12) * 3), -180 + 3 * 180.0 / 4096);
  EXPECT_DOUBLE_EQ(lattice.latitude_deg(lattice.height()), 90);
}

}  // namespace
}  // namespace tind
