// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace tind {

/// A vertex of a line that the surface follows: a lattice point (x may run past the lattice's width where the height
/// field does) and the height that the TIN's vertex there gets.
struct BreakVertex {
  std::int64_t x = 0;
  std::int64_t y = 0;
  double height_m = 0;
  friend bool operator==(const BreakVertex&, const BreakVertex&) = default;
};

/// A line that the surface follows (stream, lake shore, road edge...) at full detail. Streams run downstream. Chains
/// meet in their end vertices alone ("nodes"): what crosses or touches elsewhere was cut there first.
struct BreakChain {
  std::vector<BreakVertex> vertices;  ///< At least 2; neighbours differ in (x, y). A ring repeats its first at the end.
  int first_level = 0;                ///< The coarsest level that draws the chain; every finer level does, too.
  double weight = 0;                  ///< Where two lines cannot both be drawn the heavier stays.
  bool in_valley = false;             ///< A stream: drawn off its valley's floor it would be none.
  std::span<const BreakVertex> kept{};  ///< The vertices where there are none in `vertices`; memory of somebody else.

  std::span<const BreakVertex> points() const { return vertices.empty() ? kept : vertices; }
};

}  // namespace tind
