// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/height_field.hpp"

#include <vector>

#include <gtest/gtest.h>

namespace tind {
namespace {

/// A field with its arrays: every post is a source post.
struct Owned {
  std::vector<float> heights;
  std::vector<PostOrigin> origins;
  HeightField field;

  Owned(std::int64_t n_rows, std::int64_t n_cols, std::vector<float> values)
      : heights(std::move(values)), origins(heights.size(), PostOrigin::kSource) {
    field.lattice.level = 2;
    field.lattice.height_exponent = 4;
    field.n_rows = n_rows;
    field.n_cols = n_cols;
    field.heights_m = heights.data();
    field.origins = origins.data();
  }
};

Owned small_field() {
  Owned o(2, 3, {10, 20, 40, 50, 60, 80});
  o.field.x0 = 1000.3;
  o.field.y0 = 500.4;
  o.field.dx = o.field.dy = 100.6;
  o.field.base_height_m = -7;
  return o;
}

TEST(HeightField, IsBilinearBetweenPosts) {
  const Owned o = small_field();
  const HeightField& f = o.field;
  EXPECT_DOUBLE_EQ(f.sample_m(f.post_x(1), f.post_y(0)), 20);
  EXPECT_NEAR(f.sample_m(f.post_x(0) + 50.3, f.post_y(0)), 15, 1e-9);
  EXPECT_NEAR(f.sample_m(f.post_x(1) + 50.3, f.post_y(0) + 50.3), 50, 1e-9);
}

TEST(HeightField, IsTheBaseOutsideTheGrid) {
  const Owned o = small_field();
  const HeightField& f = o.field;
  EXPECT_EQ(f.sample_m(f.x0 - 1, f.y0), -7);
  EXPECT_EQ(f.sample_m(f.post_x(2) + 1, f.y0), -7);
  EXPECT_EQ(f.sample_m(f.x0, f.y0 - 1), -7);
  EXPECT_EQ(f.sample_m(f.x0, f.post_y(1) + 1), -7);
  EXPECT_EQ(f.lattice_height(0, 0), -7 * 16);
}

TEST(HeightField, LatticePointHasTheHeightOfThePostThatRoundsToIt) {
  const Owned o = small_field();
  const HeightField& f = o.field;
  for (std::int64_t r = 0; r < 2; ++r) {
    for (std::int64_t c = 0; c < 3; ++c) {
      EXPECT_EQ(f.lattice_height(std::llround(f.post_x(c)), std::llround(f.post_y(r))),
                16 * std::lround(f.height_at(r, c)));
    }
  }
}

TEST(HeightField, LatticePointThatRoundsOntoARowIsSampledOnIt) {
  const Owned o = small_field();
  const HeightField& f = o.field;
  const std::int64_t x = 1050, y = std::llround(f.post_y(1));
  EXPECT_EQ(f.lattice_height(x, y), f.lattice.height_from_m(f.sample_m(static_cast<double>(x), f.post_y(1))));
  // One step off the row it is an ordinary sample.
  EXPECT_EQ(f.lattice_height(x, y - 1),
            f.lattice.height_from_m(f.sample_m(static_cast<double>(x), static_cast<double>(y - 1))));
}

TEST(HeightField, IsPeriodicAroundTheGlobe) {
  Owned o = small_field();
  HeightField& f = o.field;
  const std::int64_t width = f.lattice.width();
  f.x0 = static_cast<double>(width) - 60.2;  // posts 1 and 2 lie beyond longitude 180
  const std::int64_t y = std::llround(f.post_y(0)), x = std::llround(f.post_x(1)) - width;
  ASSERT_GE(x, 0);
  EXPECT_EQ(f.lattice_height(x, y), 20 * 16);
  for (const std::int64_t step : {-50, 0, 10, 77, 150}) {
    EXPECT_EQ(f.lattice_height(x + step, y), f.lattice_height(x + step + width, y)) << step;
    EXPECT_EQ(f.lattice_height(x + step, y), f.lattice_height(x + step - width, y)) << step;
  }
}

TEST(HeightField, WrappingGridInterpolatesAcrossItsSeam) {
  Owned o(2, 4, {0, 10, 20, 30, 0, 10, 20, 30});
  HeightField& f = o.field;
  f.wraps = true;
  f.dx = static_cast<double>(f.lattice.width()) / 4;
  f.x0 = 0.25 * f.dx;
  f.y0 = 1000;
  f.dy = 100;
  EXPECT_NEAR(f.sample_m(f.post_x(3) + 0.5 * f.dx, 1000), 15, 1e-9);
  EXPECT_NEAR(f.sample_m(0, 1000), 0.25 * 30, 1e-9);
  EXPECT_EQ(f.lattice_height(0, 1050), f.lattice_height(f.lattice.width(), 1050));
}

TEST(HeightField, RunsLinearlyToThePolesOneHeight) {
  Owned o(2, 2, {10, 30, 50, 70});
  HeightField& f = o.field;
  f.wraps = true;
  f.dx = static_cast<double>(f.lattice.width()) / 2;
  f.dy = 1000;
  f.y0 = 800;
  f.continues_south = true;
  f.south_pole_m = 20;
  EXPECT_NEAR(f.sample_m(0, 400), 15, 1e-9);
  EXPECT_NEAR(f.sample_m(f.dx, 200), 22.5, 1e-9);
  for (const std::int64_t x : {0, 17, 4000, 99999}) EXPECT_EQ(f.lattice_height(x, 0), 20 * 16) << x;
  // The same at the north, with the last row on the pole itself.
  f.y0 = static_cast<double>(f.lattice.height()) - 1000;
  f.continues_south = false;
  f.continues_north = true;
  o.heights[2] = o.heights[3] = 60;
  f.north_pole_m = 60;
  for (const std::int64_t x : {0, 17, 4000, 99999}) EXPECT_EQ(f.lattice_height(x, f.lattice.height()), 60 * 16) << x;
  EXPECT_NEAR(f.sample_m(0, f.y0 + 500), 35, 1e-9);
}

TEST(HeightField, PoleHasOneHeightEvenWhereTheGridDoesNotReach) {
  Owned o(2, 2, {10, 10, 10, 10});
  HeightField& f = o.field;
  f.dx = 1000;
  f.dy = 1000;
  f.y0 = 500;
  f.continues_south = true;
  f.south_pole_m = 10;
  f.base_height_m = 0;
  const std::int64_t far_x = f.lattice.width() / 2;
  EXPECT_EQ(f.lattice_height(far_x, 0), 160);
  EXPECT_NEAR(f.sample_m(static_cast<double>(far_x), 250), 5, 1e-9);
  EXPECT_EQ(f.lattice_height(far_x, 500), 0);
}

}  // namespace
}  // namespace tind
