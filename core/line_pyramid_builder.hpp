// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "core/break_line.hpp"
#include "core/drainage/flow_run.hpp"
#include "core/lattice.hpp"
#include "core/line_pyramid.hpp"
#include "core/scratch_array.hpp"

namespace tind {

/// Makes a line pyramid level by level: what it needs beside the result lives here. What is as long as all vertices
/// together is in flat arrays of working memory; a level's lines are stretches of one of them. Fewer than 2^32
/// vertices of chains.
class LinePyramidBuilder {
 public:
  LinePyramidBuilder(LinePyramid& out, const Lattice& lattice, std::span<const LineDetail> detail,
                     const ScratchAllocator& kept, const ScratchAllocator& working);
  void build(std::vector<BreakChain> input);

 private:
  using Id = std::uint32_t;     // index of a vertex of the pyramid
  using Place = std::uint32_t;  // position in line_ids_
  static constexpr std::uint8_t kNoLevel = 255;

  struct Chain {
    std::size_t first = 0;  // in chain_ids_; the next chain's first is its end
    double weight = 0;
    std::uint32_t given = 0;  // index of the chain it came from
    std::uint8_t first_level = 0;
    bool in_valley = false;
  };

  // A line as a level draws it: chains joined where nothing else meets them. Its vertices lie in line_ids_ up to the
  // next line's first.
  struct Line {
    Place first = 0;
    std::uint32_t chain = 0;  // the heaviest of its chains
    bool in_valley = false;
  };

  // Two neighbouring kept vertices of a line; one and the same: dropped.
  struct Segment {
    Place from = 0, to = 0;
    bool dropped() const { return from == to; }
  };
  using Pair = std::pair<std::size_t, std::size_t>;  // of segments

  struct Farthest {
    Place position = 0;
    double share = -1;  // of what the detail allows
  };

  // Vertices (line_pyramid_builder.cpp).
  template <class F>
  void for_stretches(const BreakChain& chain, F&& f);
  void load(std::vector<BreakChain>& input);
  void push(std::vector<LatticePoint>& points, std::int64_t x, std::int64_t y, double height_m) const;
  void add_crossings(const BreakVertex& a, const BreakVertex& b, std::vector<LatticePoint>& points) const;
  void collect_crossings();

  // A level's lines (line_pyramid_builder.cpp).
  void draw(int level);
  std::vector<std::uint32_t> joined_ends(int level) const;
  void join(int level);
  bool on_one_border(Id a, Id b, int level) const;
  bool along_one_border(Id a, Id b, Id c, int level) const;
  void generalise(int level, std::size_t line);
  Farthest farthest(bool in_valley, Place from, Place to, int level) const;
  std::size_t simplify(bool in_valley, Place from, Place to, int level);

  // Lines that cross each other (line_pyramid_crossings.cpp).
  std::vector<Segment> segments() const;
  bool cross(const Segment& s, const Segment& t) const;
  template <class F>
  void for_cells(const Segment& s, std::int64_t cell, std::int64_t row_begin, std::int64_t row_end, F&& f) const;
  std::int64_t cell_side(int level, const std::vector<Segment>& segments) const;
  std::vector<Pair> crossing_pairs(int level, const std::vector<Segment>& segments) const;
  std::vector<Segment> part_crossings(int level);

  // Results (line_pyramid_store.cpp).
  void store(int level, std::vector<Segment> segments);
  void store_lines(LinePyramid::Level& out, const std::vector<Segment>& segments) const;
  void store_pieces(int level, LinePyramid::Level& out, const std::vector<Segment>& segments) const;

  const LatticePoint& point(Id id) const { return out_.vertices_[id]; }
  Id id(Place at) const { return line_ids_[at]; }
  // x of `to` as seen from `from`, the short way around the globe.
  std::int64_t unwrapped_x(Id from, Id to) const;
  // The coarsest level that has a border line at a lattice coordinate, kNoLevel if none has.
  std::uint8_t border_level(std::int64_t at) const;
  bool on_border(std::int64_t at, int level) const { return border_level(at) <= level; }
  double weight(const Line& line) const { return chains_[line.chain].weight; }
  // The line that has a position.
  std::size_t line_of(Place at) const;
  Place line_end(std::size_t line) const { return line + 1 < lines_.size() ? lines_[line + 1].first : n_line_ids_; }

  LinePyramid& out_;
  const ScratchAllocator& kept_;
  const ScratchAllocator& working_;
  const Lattice& lattice_;
  const std::span<const LineDetail> detail_;
  const int bottom_;
  std::vector<LatticePoint> stretch_;
  std::vector<Chain> chains_;  // and one more, whose first is the end
  ScratchArray<Id> chain_ids_;
  ScratchArray<std::uint8_t> entry_;  // coarsest level that keeps the vertex

  // Of the level that is drawn now:
  std::vector<Line> lines_;
  ScratchArray<Id> line_ids_;
  Place n_line_ids_ = 0;
  std::vector<bool> drawn_;  // by place: the vertex is kept
};

}  // namespace tind
