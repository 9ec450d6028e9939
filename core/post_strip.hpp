// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>

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

  const float* heights = nullptr;  ///< Of post (row, first_read); kColumns of every row may be read from there on.
  std::int64_t stride = 0;         ///< Posts from one row to the next.
  std::int64_t first_read = 0;
  std::int64_t row = 0, n_rows = 0;
  std::int64_t col = 0, n_cols = 0;  ///< Those that count: first_read <= col, col + n_cols <= first_read + kColumns.
};

/// The registers that a loop uses: all give the same bytes.
enum class Registers { kNarrow, kWidest };

/// The worst post of a triangle in a strip.
struct StripWorst {
  double error_m = 0;
  std::int64_t r = 0, c = -1;  ///< c < 0: none is above the bound.
};

/// Of the posts of a strip in a widened triangle, borders included, the one with the largest |plane - height| above
/// `least_m`; of equal ones the southern, then the western one. Precondition: the strip's rows are among the widened
/// triangle's. Thread safe.
StripWorst worst_in_strip(const PostStrip& strip, const WidenedRows& triangle, const PlaneOverPosts& plane,
                          double least_m, Registers registers = Registers::kWidest);

/// Errors of the posts of a strip from a triangle's western cut up to, not including, its eastern one.
struct StripErrors {
  double largest_m = 0, sum_m2 = 0;
  std::uint64_t n = 0;
};
StripErrors errors_in_strip(const PostStrip& strip, const TriangleRows& triangle, const PlaneOverPosts& plane,
                            Registers registers = Registers::kWidest);

}  // namespace tind
