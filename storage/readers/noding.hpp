// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/break_line.hpp"
#include "core/result.hpp"

namespace tind {

/// A line on the lattice, before noding. height_m NaN: the vertex has no height of its own.
using LatticeLine = std::vector<BreakVertex>;

/// What lies between two nodes of the noded lines.
struct NodedPiece {
  /// At least 2, neighbours differ in (x, y); a ring repeats its first at the end. Runs in the direction of lines[0].
  /// The height is the lowest of all input lines that pass the lattice point and have one there (theirs at their own
  /// vertices, linear between them), else NaN; a node has the same height in all its pieces.
  LatticeLine vertices;
  std::vector<std::uint32_t> lines;  ///< The input lines that run along here, ascending; at least one.
};

/// A node at which input lines meet elsewhere than in their ends (a ring's is its first vertex), or a piece that is
/// part of more than one line.
struct LineMeeting {
  std::int64_t x = 0, y = 0;   ///< The node, or one end of the shared piece.
  std::uint32_t a = 0, b = 0;  ///< Input lines, a <= b; a == b: the line meets itself.
  bool shared_piece = false;   ///< The lines run along each other from here on.
};

struct NodedLines {
  std::vector<NodedPiece> pieces;     ///< Ascending by their vertices; no two pieces join the same points the same way.
  std::vector<LineMeeting> meetings;  ///< Ascending by (shared_piece, y, x, a, b), each once.
};

/// Cuts lines at each other by snap rounding (Hobby 1999; Guibas, Marimont 1998) on the lattice's integers: afterwards
/// no two segments have a point in common but end vertices, and pieces share vertices in their ends alone. Every input
/// vertex is an output vertex; between vertices a line moves by less than a lattice step. What lies on top of each
/// other is kept once. The pieces depend on the set of lines alone, not on their order or direction (`lines` does, of
/// course). Precondition: each line has at least 2 vertices, neighbours differ in (x, y), |x| and |y| <= 2^50.
/// Near-linear in vertices and crossings. kInvalidInput: more than kMaxCrossings crossings. kUnsupported: GEOS fails,
/// with its message.
Result<NodedLines> node_lines(std::span<const LatticeLine> lines);

inline constexpr std::int64_t kMaxCrossings = 4'000'000;  ///< About a gigabyte of memory.

}  // namespace tind
