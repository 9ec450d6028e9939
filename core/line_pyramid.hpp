// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "core/break_line.hpp"
#include "core/drainage/flow_run.hpp"
#include "core/lattice.hpp"
#include "core/pinned_points.hpp"
#include "core/scratch_array.hpp"
#include "core/tile_key.hpp"

namespace tind {

/// How much detail the lines of a level keep.
struct LineDetail {
  double plan_m = 0;    ///< Largest horizontal distance of a dropped vertex from the drawn line, metres.
  double height_m = 0;  ///< Largest height difference of a dropped vertex to the drawn line.
  double valley_m = std::numeric_limits<double>::infinity();  ///< As plan_m, for lines in a valley: the smaller counts.
};

/// A vertex of a line that lies on a border line: `t` along it, from `entry` on.
struct LineCrossing {
  bool vertical = false;  ///< On a meridian (t runs north) or a parallel (t runs east).
  std::int64_t at = 0;    ///< The border line's lattice coordinate.
  std::int64_t t = 0;
  std::uint8_t entry = 0;  ///< The coarsest level at which it is a vertex of the border line.
};

/// A piece of a drawn line inside one tile (ends may lie on its border).
struct LineSegment {
  LatticePoint a, b;
};

/// A line as a level draws it: chains joined where nothing else meets them, with the level's vertices.
struct DrawnLine {
  std::vector<LatticePoint> vertices;
  std::size_t chain = 0;  ///< The heaviest of the chains in it, as given to the pyramid.
};

/// Break lines for all levels: generalised per level with nested vertices and cut at the level's border lines, so that
/// each tile finds its own pieces (DESIGN "Drainage"; Zheng et al. 2016, step 3). Immutable; thread safe.
class LinePyramid {
 public:
  LinePyramid() = default;
  /// `detail`: index = level. Chains may cross each other or themselves outside their nodes: then both keep more
  /// vertices, and where even that does not part them the lighter one has a gap. Deterministic in the order of
  /// `chains`.
  LinePyramid(const Lattice& lattice, std::vector<BreakChain> chains, std::span<const LineDetail> detail);
  /// The same. Frees each chain's vertices when it has read them. Takes what it keeps (some 40 bytes a vertex) from
  /// `kept`, memory that must outlive this object, and what it needs meanwhile and grows with the vertices (some 15
  /// bytes each) from `working`, memory of this call; from the heap where they give none or are empty. Its heap holds
  /// some 50 bytes a chain beside that and 8 for each drawn vertex of a level.
  LinePyramid(const Lattice& lattice, std::vector<BreakChain> chains, std::span<const LineDetail> detail,
              const ScratchAllocator& kept, const ScratchAllocator& working);
  LinePyramid(LinePyramid&&) noexcept = default;
  LinePyramid& operator=(LinePyramid&&) noexcept = default;

  bool empty() const { return vertices_.size() == 0; }
  /// All vertices of all chains and their crossings with border lines, ascending by (y, x), x in [0, width): the
  /// heights that vertices at these lattice points get on every level.
  std::span<const LatticePoint> vertices() const { return vertices_.values(); }
  /// The same, to be asked for one at a time. Valid as long as this object.
  PinnedPoints pinned() const { return PinnedPoints(vertices(), &vertex_filter_); }
  /// The vertices that lie inside the stretch (start, end) of a border line, ascending in t, of any entry level.
  std::span<const LineCrossing> crossings(bool vertical, std::int64_t at, std::int64_t start, std::int64_t end) const;
  /// The pieces inside a tile, heaviest first.
  std::vector<LineSegment> segments(const TileKey& tile) const;
  /// Number of vertices of the level's lines, and of their pieces inside tiles.
  std::uint64_t n_vertices(int level) const {
    return empty() ? 0 : levels_[static_cast<std::size_t>(level)].line_vertices.size();
  }
  std::uint64_t n_segments(int level) const { return levels_[static_cast<std::size_t>(level)].pieces.size(); }
  /// Pieces of the level that are not drawn because they cross a heavier line.
  std::uint64_t n_dropped(int level) const { return levels_[static_cast<std::size_t>(level)].n_dropped; }

  /// Lines as drawn at a level, for output.
  std::vector<DrawnLine> drawn(int level) const;

 private:
  struct Piece {
    std::uint64_t tile = 0;      // Morton code
    std::uint32_t a = 0, b = 0;  // indices of vertices_
  };
  struct Level {
    ScratchArray<Piece> pieces;                 // by tile, heaviest first
    ScratchArray<std::uint32_t> line_vertices;  // polylines one after another
    ScratchArray<std::uint64_t> line_first;
    ScratchArray<std::uint32_t> line_chain;  // parallel, without the last: the heaviest of the chains, as given
    std::uint64_t n_dropped = 0;
  };
  friend class LinePyramidBuilder;

  std::int64_t width_ = 0;
  std::vector<std::int64_t> side_;  // of a tile, per level
  ScratchArray<LatticePoint> vertices_;
  PinFilter vertex_filter_;
  ScratchArray<LineCrossing> crossings_;  // by (vertical, at, t)
  std::vector<Level> levels_;
};

}  // namespace tind
