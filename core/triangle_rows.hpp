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

/// Where rows of a grid cut a triangle; all in post spacings. An edge is cut at the same number for both of its
/// triangles.
class TriangleRows {
 public:
  /// Corners (u[i], v[i]): column and row, real numbers.
  TriangleRows(const double (&u)[3], const double (&v)[3]) : u_{u[0], u[1], u[2]}, v_{v[0], v[1], v[2]} {
    order(0, 1);
    order(1, 2);
    order(0, 1);
    long_slope_ = slope(0, 2);
    low_slope_ = slope(0, 1);
    high_slope_ = slope(1, 2);
  }

  double south() const { return v_[0]; }
  double north() const { return v_[2]; }

  /// The western and the eastern cut of a row in [south, north].
  std::pair<double, double> cuts(double row) const {
    const double a = u_[0] + long_slope_ * (row - v_[0]);
    const double b = row < v_[1] ? u_[0] + low_slope_ * (row - v_[0]) : u_[1] + high_slope_ * (row - v_[1]);
    return {std::min(a, b), std::max(a, b)};
  }

 private:
  void order(int i, int j) {
    if (v_[i] > v_[j]) {
      std::swap(u_[i], u_[j]);
      std::swap(v_[i], v_[j]);
    }
  }
  double slope(int i, int j) const { return v_[j] > v_[i] ? (u_[j] - u_[i]) / (v_[j] - v_[i]) : 0; }

  double u_[3], v_[3];  // by row, the lowest first
  double long_slope_, low_slope_, high_slope_;
};

}  // namespace tind
