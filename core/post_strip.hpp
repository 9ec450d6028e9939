// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>

#include "core/registers.hpp"
#include "core/triangle_rows.hpp"

namespace tind {

/// A plane over the posts of a window, with the roundings of FacePlane::at: at column c of row r it is
/// (z + slope_y * ((y0 + r * dy) - y_a)) + per_col * c.
struct PlaneOverPosts {
  double z, slope_y, y0, dy, y_a, per_col;
};

/// A narrow strip of a window of posts: most triangles have so few that a loop over each of their rows would spend its
/// time in beginning and ending. Columns and rows are the window's. Reads heights it does not own.
struct PostStrip {
  static constexpr std::int64_t kColumns = 8;
  static constexpr std::int64_t kMostRows = 1024;  ///< Of a strip whose errors are summed up: 64 bits hold them.

  const float* heights = nullptr;  ///< Of post (row, first_read); kColumns of every row may be read from there on.
  std::int64_t stride = 0;         ///< Posts from one row to the next.
  std::int64_t first_read = 0;
  std::int64_t row = 0, n_rows = 0;
  std::int64_t col = 0, n_cols = 0;  ///< Those that count: first_read <= col, col + n_cols <= first_read + kColumns.
};

/// The worst post of a triangle in a strip.
struct StripWorst {
  double error_m = 0;
  std::int64_t r = 0, c = -1;  ///< c < 0: none is above the bound.
};

/// Of the posts of a strip in a widened triangle, borders included, the one with the largest |plane - height| above
/// `least_m`; of equal ones the southern, then the western one. Precondition: the strip's rows are among the widened
/// triangle's; the processor has the registers. Thread safe.
StripWorst worst_in_strip(const PostStrip& strip, const WidenedRows& triangle, const PlaneOverPosts& plane,
                          double least_m, Registers registers = kBestRegisters);

/// A whole number of quanta: sums of as many posts as there are.
__extension__ using Quanta = unsigned __int128;

/// Squares of errors as whole numbers of a quantum, a power of two in square metres: sums of them are exact, so they do
/// not depend on the order in which posts come.
class SquareQuantum {
 public:
  /// 2^-44 of the square of the next power of two above `scale_m` > 0.
  static SquareQuantum of_scale(double scale_m) {
    int exponent = 0;
    std::frexp(scale_m, &exponent);
    return SquareQuantum(exponent);
  }

  double quantum_m2() const { return quantum_m2_; }
  /// Whether errors up to this one can be squared, and are not so small that rounding shows.
  bool fits(double largest_m) const { return largest_m == 0 || (largest_m >= least_m_ && largest_m < most_m_); }
  /// The square of an error in quanta, rounded, if it fits: at most 2^50. Of one too large anything.
  std::uint64_t square(double error_m) const {
    return std::bit_cast<std::uint64_t>(error_m * error_m + anchor_) - std::bit_cast<std::uint64_t>(anchor_);
  }
  /// Added to a square, it leaves its quanta in the lower bits.
  double anchor() const { return anchor_; }
  /// Quanta of a sum of squares.
  Quanta count(double sum_m2) const { return static_cast<Quanta>(lesser(sum_m2 / quantum_m2_ + 0.5, 0x1p120)); }
  double sum_m2(Quanta quanta) const { return static_cast<double>(quanta) * quantum_m2_; }

 private:
  explicit SquareQuantum(int exponent)
      : quantum_m2_(std::ldexp(1.0, 2 * exponent - 44)),
        anchor_(0x1.8p52 * quantum_m2_),
        least_m_(std::ldexp(1.0, exponent - 9)),
        most_m_(std::ldexp(1.0, exponent + 3)) {}
  double quantum_m2_, anchor_, least_m_, most_m_;
};

/// Errors of the posts of a strip from a triangle's western cut up to, not including, its eastern one. Precondition:
/// the strip has at most kMostRows rows.
struct StripErrors {
  double largest_m = 0;
  std::uint64_t n_quanta = 0;  ///< Of the squares, if `largest_m` fits; else anything.
  std::uint64_t n = 0;
};
StripErrors errors_in_strip(const PostStrip& strip, const TriangleRows& triangle, const PlaneOverPosts& plane,
                            const SquareQuantum& quantum, Registers registers = kBestRegisters);

}  // namespace tind
