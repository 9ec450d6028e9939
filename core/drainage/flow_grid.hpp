// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <vector>

#include "core/drainage/flow_run.hpp"
#include "core/height_field.hpp"

namespace tind {

/// Directions of flow, counter-clockwise from east (row 0 is the southernmost, so north is one row up): 0 E, 1 NE, 2 N,
/// 3 NW, 4 W, 5 SW, 6 S, 7 SE. TauDEM's D8 code is one more.
inline constexpr std::array<std::int64_t, 8> kStepRows = {0, 1, 1, 1, 0, -1, -1, -1};
inline constexpr std::array<std::int64_t, 8> kStepCols = {1, 1, 0, -1, -1, -1, 0, 1};
/// The order in which equal choices are taken: E, N, W, S, then NE, NW, SW, SE.
inline constexpr std::array<int, 8> kTieOrder = {0, 2, 4, 6, 1, 3, 5, 7};
inline constexpr std::uint8_t kLeaves = 8;      ///< Direction of an outlet: the water leaves here.
inline constexpr std::uint8_t kNoFlow = 15;     ///< Direction of a post that takes no part.
inline constexpr std::uint8_t kDirection = 15;  ///< Bits of a direction byte that hold the direction.

// Bits of a post's mark.
inline constexpr std::uint8_t kInside = 1;  ///< Takes part: water falls on it and flows on.
inline constexpr std::uint8_t kClosed = 2;  ///< Takes no part, and no water leaves over it either (a pole's row).
inline constexpr std::uint8_t kOutlet = 4;  ///< Water may leave here: the rim of what takes part, and the sea.
inline constexpr std::uint8_t kVoid = 8;    ///< An interior void: water passes, no stream is drawn.
inline constexpr std::uint8_t kSea = 16;    ///< Water ends here.
inline constexpr std::uint8_t kLake = 32;   ///< Water passes, no stream is drawn.
inline constexpr std::uint8_t kBasin = 64;  ///< A deep and wide depression: water passes over it, no stream is drawn.
inline constexpr std::uint8_t kInFlat =
    128;  ///< No neighbour is lower on the filled surface; water does not leave here.

/// Once directions are known: filled too deep to be conditioned (see StreamOptions).
inline constexpr std::uint8_t kDeep = kInFlat;

/// The first index in [begin, end) whose mark has one of the bits of `bits`, else `end`.
inline std::int64_t next_marked(const std::uint8_t* marks, std::int64_t begin, std::int64_t end, std::uint8_t bits) {
  const std::uint64_t every = 0x0101010101010101u * bits;
  for (; begin + 8 <= end; begin += 8) {
    std::uint64_t eight = 0;
    std::memcpy(&eight, marks + begin, 8);
    if (eight & every) break;
  }
  while (begin < end && !(marks[begin] & bits)) ++begin;
  return begin;
}

/// What water flows over: a grid of posts (row-major, row 0 southernmost, column 0 westernmost) with its marks and its
/// measures in metres. Does not own the two arrays.
struct FlowGrid {
  std::int64_t n_rows = 0, n_cols = 0;
  bool wraps = false;                               ///< Column n_cols - 1 is the western neighbour of column 0.
  bool closed_south = false, closed_north = false;  ///< No water leaves over that side (a pole lies there).
  const float* heights_m = nullptr;                 ///< n_rows * n_cols; finite where kInside.
  std::uint8_t* marks = nullptr;                    ///< n_rows * n_cols, the bits above.
  std::vector<double> east_m;                       ///< n_rows: metres from a post to its eastern neighbour; > 0.
  std::vector<double> north_m;  ///< n_rows: metres from row r to row r + 1 (the last entry continues the row before).
  /// n_rows: a post's share of area, in 1 / kCell of the area of a post at `cell_area_m2`; >= 1.
  std::vector<std::uint64_t> share;
  double cell_area_m2 = 0;  ///< Area that counts as one cell.

  std::int64_t size() const { return n_rows * n_cols; }
  double area_m2(std::int64_t row) const {
    return east_m[static_cast<std::size_t>(row)] * north_m[static_cast<std::size_t>(row)];
  }
  /// Index of the neighbour of (r, c) in direction d, -1 beyond the grid.
  std::int64_t neighbour(std::int64_t r, std::int64_t c, int d) const {
    const auto k = static_cast<std::size_t>(d);
    const std::int64_t rr = r + kStepRows[k];
    std::int64_t cc = c + kStepCols[k];
    if (rr < 0 || rr >= n_rows) return -1;
    if (cc < 0 || cc >= n_cols) {
      if (!wraps) return -1;
      cc = cc < 0 ? n_cols - 1 : 0;
    }
    return rr * n_cols + cc;
  }
  /// Metres from row r to its neighbour in direction d.
  double step_m(std::int64_t r, int d) const;
};

/// Fixed point of accumulation: one cell in its units. Sums of integers do not depend on their order.
inline constexpr std::uint64_t kCell = std::uint64_t{1} << 20;

/// The grid of a height field: posts of the source, interpolated posts and interior voids take part; falloff and base
/// do not. A row on a pole is kClosed, so is the side of a pole: no water crosses a pole. One cell is the area of a
/// post at the middle latitude of the posts that take part. `marks` (n_rows * n_cols) is filled here, kOutlet excepted.
FlowGrid make_flow_grid(const HeightField& field, std::uint8_t* marks, const FlowRun& run = {});

/// A plain grid: posts with a finite height take part, all posts have one size. `marks` is filled here, kOutlet
/// excepted.
FlowGrid make_flow_grid(const float* heights_m, std::int64_t n_rows, std::int64_t n_cols, double east_m, double north_m,
                        std::uint8_t* marks);

/// Sets kOutlet on the sea and on the rim: posts beside one that takes no part (kClosed excepted) or beside the grid's
/// end. Where there is none at all (a whole globe without a sea) the lowest post is the outlet, of several the first.
void mark_outlets(const FlowGrid& grid, const FlowRun& run = {});

}  // namespace tind
