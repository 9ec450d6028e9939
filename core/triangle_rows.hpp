// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

namespace tind {

/// floor and ceil of numbers below 2^63 in magnitude, without a call into libm.
inline std::int64_t floor_of(double v) {
  const auto whole = static_cast<std::int64_t>(v);
  return whole - (static_cast<double>(whole) > v ? 1 : 0);
}
inline std::int64_t ceil_of(double v) {
  const auto whole = static_cast<std::int64_t>(v);
  return whole + (static_cast<double>(whole) < v ? 1 : 0);
}

/// One instruction each, where std::min and std::max of references are often a branch. Of equal ones and NaN the
/// second.
inline double lesser(double a, double b) { return a < b ? a : b; }
inline double greater(double a, double b) { return a > b ? a : b; }

/// Where rows of a grid cut a triangle; all in post spacings. An edge is cut at the same number for both of its
/// triangles.
class TriangleRows {
 public:
  /// Corners (u[i], v[i]): column and row, real numbers. Without a branch: which corner is the lowest cannot be
  /// foretold.
  TriangleRows(const double (&u)[3], const double (&v)[3]) : u_{u[0], u[1], u[2]}, v_{v[0], v[1], v[2]} {
    order(0, 1);
    order(1, 2);
    order(0, 1);
    using Two = double __attribute__((vector_size(16)));
    const Two rise = {v_[1] - v_[0], v_[2] - v_[1]}, none = {0, 0};
    const Two slopes = Two{u_[1] - u_[0], u_[2] - u_[1]} / rise, kept = rise > none ? slopes : none;
    low_slope_ = kept[0];
    high_slope_ = kept[1];
    long_slope_ = v_[2] > v_[0] ? (u_[2] - u_[0]) / (v_[2] - v_[0]) : 0;
  }

  /// Corners by row, the lowest first, and the columns by which the edges lean from one row to the next: from corner 0
  /// to 2, 0 to 1 and 1 to 2.
  double u(int i) const { return u_[i]; }
  double v(int i) const { return v_[i]; }
  double long_slope() const { return long_slope_; }
  double low_slope() const { return low_slope_; }
  double high_slope() const { return high_slope_; }

  double south() const { return v_[0]; }
  double north() const { return v_[2]; }

  /// The western and the eastern cut of a row in [south, north].
  std::pair<double, double> cuts(double row) const {
    const double a = u_[0] + long_slope_ * (row - v_[0]);
    const double b = row < v_[1] ? u_[0] + low_slope_ * (row - v_[0]) : u_[1] + high_slope_ * (row - v_[1]);
    return {lesser(a, b), greater(a, b)};
  }

 private:
  void order(int i, int j) {
    using Two = double __attribute__((vector_size(16)));
    const Two a = {u_[i], v_[i]}, b = {u_[j], v_[j]}, a_row = {v_[i], v_[i]}, b_row = {v_[j], v_[j]};
    const auto swap = a_row > b_row;
    const Two low = swap ? b : a, high = swap ? a : b;
    u_[i] = low[0];
    v_[i] = low[1];
    u_[j] = high[0];
    v_[j] = high[1];
  }

  double u_[3], v_[3];  // by row, the lowest first
  double long_slope_, low_slope_, high_slope_;
};

/// How far from a triangle posts count as its own, in columns and rows.
struct Reach {
  double cols = 0, rows = 0;
};

/// The same rows of a triangle together with all that is within reach of it on both axes: its cuts leave out nothing of
/// that, and are a little wider beside corners.
class WidenedRows {
 public:
  WidenedRows(const TriangleRows& rows, const Reach& reach)
      : rows_(rows),
        reach_rows_(reach.rows),
        west_(lesser(lesser(rows.u(0), rows.u(1)), rows.u(2)) - reach.cols),
        east_(greater(greater(rows.u(0), rows.u(1)), rows.u(2)) + reach.cols),
        beside_long_(std::abs(rows.long_slope()) * reach.rows + reach.cols),
        beside_low_(std::abs(rows.low_slope()) * reach.rows + reach.cols),
        beside_high_(std::abs(rows.high_slope()) * reach.rows + reach.cols) {}

  const TriangleRows& rows() const { return rows_; }
  double reach_rows() const { return reach_rows_; }
  /// Columns by which cuts of an edge move outwards.
  double beside_long() const { return beside_long_; }
  double beside_low() const { return beside_low_; }
  double beside_high() const { return beside_high_; }
  /// Around the middle corner both edges that end there count.
  double beside_corner() const { return greater(beside_low_, beside_high_); }

  double south() const { return rows_.south() - reach_rows_; }
  double north() const { return rows_.north() + reach_rows_; }
  double west() const { return west_; }
  double east() const { return east_; }

  /// The western and the eastern cut of a row in [south, north].
  std::pair<double, double> cuts(double row) const {
    const TriangleRows& t = rows_;
    const double at = lesser(greater(row, t.south()), t.north());
    const double a = t.u(0) + t.long_slope() * (at - t.v(0));
    const bool is_low = at < t.v(1);
    const double b = is_low ? t.u(0) + t.low_slope() * (at - t.v(0)) : t.u(1) + t.high_slope() * (at - t.v(1));
    const double beside = std::abs(at - t.v(1)) <= reach_rows_ ? beside_corner() : is_low ? beside_low_ : beside_high_;
    return {greater(lesser(a - beside_long_, b - beside), west_), lesser(greater(a + beside_long_, b + beside), east_)};
  }

  /// Between these are the cuts of all rows from `first` to `last`, but for rounding.
  std::pair<double, double> cuts_between(double first, double last) const {
    const TriangleRows& t = rows_;
    const double low = lesser(greater(first, t.south()), t.north()), high = lesser(greater(last, t.south()), t.north());
    double west = HUGE_VAL, east = -HUGE_VAL;
    const auto include = [&](double col, double beside) {
      west = lesser(west, col - beside);
      east = greater(east, col + beside);
    };
    for (const double at : {low, high}) {
      include(t.u(0) + t.long_slope() * (at - t.v(0)), beside_long_);
      include(at < t.v(1) ? t.u(0) + t.low_slope() * (at - t.v(0)) : t.u(1) + t.high_slope() * (at - t.v(1)),
              beside_corner());
    }
    if (low <= t.v(1) && t.v(1) <= high) include(t.u(1), beside_corner());
    return {greater(west, west_), lesser(east, east_)};
  }

 private:
  TriangleRows rows_;
  double reach_rows_, west_, east_, beside_long_, beside_low_, beside_high_;
};

}  // namespace tind
