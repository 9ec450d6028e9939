// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/post_strip.hpp"

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include <gtest/gtest.h>

namespace tind::test {
namespace {

constexpr std::int64_t kRows = 40, kCols = 31;

// Those that this processor has.
std::vector<Registers> all_registers() {
  std::vector<Registers> all;
  for (int k = 0; k <= static_cast<int>(kBestRegisters); ++k) all.push_back(static_cast<Registers>(k));
  return all;
}

// Posts of a window, a triangle over them and a plane, all by chance; some heights are alike, so that errors tie.
class StripTest : public ::testing::Test {
 protected:
  StripTest() : heights_(static_cast<std::size_t>(kRows * kCols)) { next(); }

  void next() {
    std::uniform_real_distribution<double> row(-3, kRows + 3), col(-3, kCols + 3), slope(-4, 4);
    std::uniform_int_distribution<int> height(0, 3);
    for (float& h : heights_) h = static_cast<float>(height(random_));
    for (int k = 0; k < 3; ++k) {
      u_[k] = col(random_);
      v_[k] = row(random_);
      if (height(random_) == 0) v_[k] = std::round(v_[k]);
      if (height(random_) == 0) u_[k] = std::round(u_[k]);
    }
    if (height(random_) == 0) v_[1] = v_[0];
    const bool level = height(random_) == 0;
    plane_ = {slope(random_), level ? 0 : slope(random_), 10, 0.5, 7, level ? 0 : slope(random_)};
    std::uniform_int_distribution<std::int64_t> first_col(0, kCols - 1), first_row(0, kRows - 1);
    std::uniform_int_distribution<std::int64_t> n_cols(1, PostStrip::kColumns), n_rows(1, 12);
    strip_.col = first_col(random_);
    strip_.n_cols = std::min(n_cols(random_), kCols - strip_.col);
    strip_.first_read = std::min(strip_.col, kCols - PostStrip::kColumns);
    strip_.row = first_row(random_);
    strip_.n_rows = std::min(n_rows(random_), kRows - strip_.row);
    strip_.stride = kCols;
    strip_.heights = heights_.data() + strip_.row * kCols + strip_.first_read;
  }

  double error_at(std::int64_t r, std::int64_t c) const {
    const double z = plane_.z + plane_.slope_y * ((plane_.y0 + static_cast<double>(r) * plane_.dy) - plane_.y_a);
    const double height = static_cast<double>(heights_[static_cast<std::size_t>(r * kCols + c)]);
    return std::abs(z + plane_.per_col * static_cast<double>(c) - height);
  }

  StripWorst worst_one_by_one(const Reach& reach, double least) const {
    const WidenedRows rows(TriangleRows(u_, v_), reach);
    StripWorst found{least, 0, -1};
    for (std::int64_t r = strip_.row; r < strip_.row + strip_.n_rows; ++r) {
      const auto [west, east] = rows.cuts(static_cast<double>(r));
      for (std::int64_t c = strip_.col; c < strip_.col + strip_.n_cols; ++c) {
        if (static_cast<double>(c) < west || static_cast<double>(c) > east) continue;
        if (error_at(r, c) > found.error_m) found = {error_at(r, c), r, c};
      }
    }
    return found;
  }

  StripErrors errors_one_by_one() const {
    const TriangleRows rows(u_, v_);
    StripErrors all;
    for (std::int64_t r = strip_.row; r < strip_.row + strip_.n_rows; ++r) {
      const auto [west, east] = rows.cuts(std::clamp(static_cast<double>(r), rows.south(), rows.north()));
      for (std::int64_t c = strip_.col; c < strip_.col + strip_.n_cols; ++c) {
        if (static_cast<double>(c) < west || static_cast<double>(c) >= east) continue;
        const double error = error_at(r, c);
        all.largest_m = std::max(all.largest_m, error);
        all.n_quanta += quantum_.square(error);
        ++all.n;
      }
    }
    return all;
  }

  const SquareQuantum quantum_ = SquareQuantum::of_scale(50);
  std::mt19937 random_{20161};
  std::vector<float> heights_;
  double u_[3] = {}, v_[3] = {};
  PlaneOverPosts plane_{};
  PostStrip strip_;
};

// Whatever lies within reach of the triangle is between the cuts, and nothing far beyond is.
TEST_F(StripTest, WidenedRowsHaveAllWithinReach) {
  std::uniform_real_distribution<double> share(0, 1), aside(-1, 1), size(0, 0.9);
  double most_beyond = 0;
  for (int k = 0; k < 200'000; ++k, next()) {
    const Reach reach{size(random_), size(random_)};
    const TriangleRows rows(u_, v_);
    const WidenedRows wide(rows, reach);
    if (rows.south() == rows.north()) continue;  // no triangle
    double a = share(random_), b = share(random_);
    if (a + b > 1) a = 1 - a, b = 1 - b;
    if (k % 2) b = k % 4 == 1 ? 0 : 1 - a;  // on an edge
    const double col = u_[0] + a * (u_[1] - u_[0]) + b * (u_[2] - u_[0]) + aside(random_) * reach.cols;
    const double row = v_[0] + a * (v_[1] - v_[0]) + b * (v_[2] - v_[0]) + aside(random_) * reach.rows;
    ASSERT_GE(row, wide.south() - 1e-9) << k;
    ASSERT_LE(row, wide.north() + 1e-9) << k;
    const auto [west, east] = wide.cuts(row);
    ASSERT_GE(col, west - 1e-9) << k;
    ASSERT_LE(col, east + 1e-9) << k;
    const auto [own_west, own_east] = rows.cuts(std::clamp(row, rows.south(), rows.north()));
    const double lean =
        std::max({std::abs(rows.long_slope()), std::abs(rows.low_slope()), std::abs(rows.high_slope())});
    ASSERT_LE(std::max(own_west - west, east - own_east), reach.cols + lean * reach.rows + 1e-9) << k;
    most_beyond = std::max(most_beyond, own_west - west);
  }
  EXPECT_GT(most_beyond, 1);
}

TEST_F(StripTest, CutsOfSeveralRowsLieBetweenTheirBounds) {
  std::uniform_real_distribution<double> some(0, 20);
  for (int k = 0; k < 50'000; ++k, next()) {
    const Reach reach{some(random_) / 10, some(random_) / 10};
    const WidenedRows rows(TriangleRows(u_, v_), reach);
    const double first = std::floor(rows.south() + some(random_) - 10), last = first + std::floor(some(random_));
    const auto [west, east] = rows.cuts_between(first, last);
    for (double row = first; row <= last; ++row) {
      if (row < rows.south() || row > rows.north()) continue;
      const auto [row_west, row_east] = rows.cuts(row);
      if (row_west > row_east) continue;
      ASSERT_LE(west, row_west + 1e-9) << k;
      ASSERT_GE(east, row_east - 1e-9) << k;
    }
  }
}

TEST_F(StripTest, WorstIsThatOfAPlainLoop) {
  std::uniform_real_distribution<double> least(0, 60);
  int n_found = 0, n_none = 0;
  for (int k = 0; k < 200'000; ++k, next()) {
    const double above = k % 2 ? 0 : least(random_);
    const Reach reach = k % 3 == 0 ? Reach{} : k % 3 == 1 ? Reach{1e-9, 1e-9} : Reach{least(random_) / 40, 0.3};
    const StripWorst expected = worst_one_by_one(reach, above);
    (expected.c < 0 ? n_none : n_found) += 1;
    for (const Registers registers : all_registers()) {
      const StripWorst found =
          worst_in_strip(strip_, WidenedRows(TriangleRows(u_, v_), reach), plane_, above, registers);
      ASSERT_EQ(found.c, expected.c) << k;
      if (expected.c < 0) continue;
      ASSERT_EQ(found.r, expected.r) << k;
      ASSERT_EQ(found.error_m, expected.error_m) << k;
    }
  }
  EXPECT_GT(n_found, 20'000);
  EXPECT_GT(n_none, 20'000);
}

TEST(SquareQuantum, CountsSquaresInWholeQuanta) {
  const SquareQuantum quantum = SquareQuantum::of_scale(10);
  EXPECT_EQ(quantum.quantum_m2(), 0x1p-36);
  EXPECT_EQ(quantum.square(3), std::uint64_t{9} << 36);
  EXPECT_EQ(quantum.square(0), 0u);
  EXPECT_EQ(quantum.square(0.1), static_cast<std::uint64_t>(std::llround(0.01 * 0x1p36)));
  EXPECT_EQ(quantum.square(127.9), static_cast<std::uint64_t>(std::llround(127.9 * 127.9 * 0x1p36)));
  EXPECT_EQ(quantum.count(9), Quanta{9} << 36);
  EXPECT_EQ(quantum.sum_m2(Quanta{9} << 36), 9);
  for (const double scale_m : {1e-4, 0.3, 1.0, 10.0, 2e4}) {
    const SquareQuantum own = SquareQuantum::of_scale(scale_m);
    EXPECT_TRUE(own.fits(scale_m) && own.fits(0) && own.fits(scale_m / 200) && own.fits(scale_m * 7)) << scale_m;
    EXPECT_FALSE(own.fits(scale_m / 1100) || own.fits(scale_m * 17)) << scale_m;
  }
}

TEST_F(StripTest, ErrorsAreThoseOfAPlainLoop) {
  std::uint64_t n = 0;
  for (int k = 0; k < 200'000; ++k, next()) {
    const StripErrors expected = errors_one_by_one();
    for (const Registers registers : all_registers()) {
      const StripErrors found = errors_in_strip(strip_, TriangleRows(u_, v_), plane_, quantum_, registers);
      ASSERT_EQ(found.n, expected.n) << k;
      ASSERT_EQ(found.largest_m, expected.largest_m) << k;
      ASSERT_EQ(found.n_quanta, expected.n_quanta) << k;  // exact sums, so their order does not matter
    }
    n += expected.n;
  }
  EXPECT_GT(n, 500'000u);
}

}  // namespace
}  // namespace tind::test
