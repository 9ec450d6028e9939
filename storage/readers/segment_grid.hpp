// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "core/break_line.hpp"

namespace tind {

struct LatticeXy {
  std::int64_t x = 0, y = 0;
  friend bool operator==(const LatticeXy&, const LatticeXy&) = default;
  friend bool operator<(const LatticeXy& a, const LatticeXy& b) { return a.x != b.x ? a.x < b.x : a.y < b.y; }
};

/// Finds the segments of lines near a lattice point: a grid of square cells over the lines' bounds, each with the
/// segments whose surroundings (kSettledSteps) reach into it. Segments are numbered line by line. Predicates are
/// exact. Const access is thread safe.
class SegmentGrid {
 public:
  /// `lines` must outlive the grid; each has at least 2 vertices.
  explicit SegmentGrid(std::span<const std::vector<BreakVertex>> lines);

  /// Segments that touch the unit square around `p` (its pixel, borders included), ascending.
  void segments_at(LatticeXy p, std::vector<std::uint32_t>& out) const;
  /// Pairs of segments that cross properly, but at most `limit`; gives up looking (for a lower bound) after some 10^8
  /// pairs.
  std::int64_t count_crossings(std::int64_t limit) const;

  /// Per line whether noding could change it. False: neither this line nor any that it is joined to, directly or
  /// through others, comes within kSettledSteps of another line or of itself but for ends that are joined, so that
  /// cutting and rounding the rest cannot touch it.
  std::vector<bool> unsettled_lines() const;
  static constexpr double kSettledSteps = 2;

  std::uint32_t line(std::uint32_t segment) const { return line_of_[segment]; }
  bool is_first(std::uint32_t segment) const { return segment == first_of_[line(segment)]; }
  bool is_last(std::uint32_t segment) const { return segment + 1 == first_of_[line(segment) + 1]; }
  std::pair<LatticeXy, LatticeXy> ends(std::uint32_t segment) const;
  /// Height of the segment where it passes `p`: a vertex's own at the vertex, linear in between, NaN unless both are
  /// known.
  double height_at(std::uint32_t segment, LatticeXy p) const;

 private:
  /// first_in_.size(): outside the grid.
  std::size_t cell_at(LatticeXy p) const;
  /// Cells that the segment touches, in rows; calls visit(cell index).
  template <class Visit>
  void visit_cells(std::uint32_t segment, const Visit& visit) const;
  enum class Contact { kNone, kJoined, kUnsettled };
  Contact contact(std::uint32_t s, std::uint32_t t) const;
  bool is_line_end(std::uint32_t segment, LatticeXy p) const;
  std::pair<const BreakVertex*, const BreakVertex*> vertices(std::uint32_t segment) const;

  std::span<const std::vector<BreakVertex>> lines_;
  std::vector<std::uint32_t> line_of_;   ///< Per segment.
  std::vector<std::uint32_t> first_of_;  ///< Per line, and one past the last: the first segment.
  LatticeXy origin_;
  double cell_ = 1;  ///< Lattice steps along a cell.
  std::int64_t n_rows_ = 0, n_cols_ = 0;
  std::vector<std::uint64_t> first_in_;  ///< Per cell, and one past the last: offset into segments_.
  std::vector<std::uint32_t> segments_;
};

}  // namespace tind
