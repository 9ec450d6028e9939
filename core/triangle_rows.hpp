// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
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

}  // namespace tind
