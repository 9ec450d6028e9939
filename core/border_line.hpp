// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "core/height_field.hpp"
#include "core/line_pyramid.hpp"
#include "core/virtual_node.hpp"

namespace tind {

/// A vertex of a border line: `t` is the absolute lattice coordinate along the line, `entry` the level at which the
/// vertex entered it.
struct LineVertex {
  std::int64_t t = 0;
  std::int32_t z = 0;
  std::uint8_t entry = 0;
  friend bool operator==(const LineVertex&, const LineVertex&) = default;
};

/// A stretch of a border line as long as one tile side of the level at which the line is first used. All finer edges on
/// this stretch are cut out of it.
struct RootEdge {
  bool vertical = false;   ///< A meridian (t runs north) or a parallel (t runs east).
  int level = 0;           ///< l0: the level at which the line is first a tile side.
  std::int64_t at = 0;     ///< The line's own lattice coordinate: X of a meridian, Y of a parallel.
  std::int64_t start = 0;  ///< t of the first corner; the stretch ends one tile side of `level` later.
};

/// What refinement works to, index = level.
struct RefinementSpec {
  std::vector<double>
      tolerance_m;                 ///< Refinement tolerance: E_L less the margins that keep the promise after rounding.
  std::vector<int> seed_segments;  ///< Seeds a tile side, a power of two.
  std::vector<double> height_step_m;  ///< Quantized-mesh rounds border heights to multiples of this power of two.

  int bottom_level() const { return static_cast<int>(tolerance_m.size()) - 1; }
};

/// Nested one-dimensional greedy refinement (DESIGN "Seams"): the polylines P_L of one stretch for every level from its
/// own down to the deepest stored, P_L a subset of P_{L+1}, each within the tolerance of every border sample. Border
/// samples are the crossings with post rows (meridian) or columns (parallel), and the level's own grid where the base
/// height is. `pins`: lattice coordinates on the line where the parent tile has vertices. `crossings`: where break
/// lines meet the stretch, ascending in t, each a vertex from its entry level on. `is_split(level, start)`: whether a
/// tile beside the edge of `level` that starts at `start` has stored children. Returns all vertices, ascending in t,
/// both ends included. Pure; thread safe.
std::vector<LineVertex> refine_root_edge(const HeightField& field, const RefinementSpec& spec, const RootEdge& root,
                                         std::span<const std::int64_t> pins, std::span<const LineCrossing> crossings,
                                         const std::function<bool(int level, std::int64_t start)>& is_split);

/// The part of a refined root edge that lies in [start, end], both included.
std::span<const LineVertex> line_between(std::span<const LineVertex> line, std::int64_t start, std::int64_t end);

/// The edge record of `level` for a part of a line that starts and ends in corners of that level.
EdgeChain edge_of_level(std::span<const LineVertex> part, int level);

/// Upper and lower bound, over all levels g >= L, of the polylines B_g at lattice coordinate t; linear between knots.
/// Heights in metres.
struct EnvelopeKnot {
  double t = 0;
  double high_m = 0;
  double low_m = 0;
  double own_m = 0;  ///< B_L itself.
};

/// Envelope of a part of a line for a tile of `level`: one knot per vertex of any level >= `level`.
std::vector<EnvelopeKnot> envelope_of(std::span<const LineVertex> part, int level, const Lattice& lattice);

}  // namespace tind
