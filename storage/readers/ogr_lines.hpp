// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/break_line.hpp"
#include "core/height_field.hpp"
#include "core/lattice.hpp"
#include "core/result.hpp"

namespace tind {

/// One --breaklines or --lakes of the user: FILE or FILE:LAYER, any OGR source, lines or polygons.
struct BreakLineFile {
  std::string spec;
  bool lakes = false;  ///< Each polygon's rings get one height.
};

struct BreakLineOptions {
  Lattice lattice;
  double dx = 0, dy = 0;  ///< Lattice steps between posts, > 0: a line gets a vertex at least that often.
  /// Lattice positions of the covered area's sides; lines are cut there. With `wraps` east_x - west_x is the lattice's
  /// width.
  std::int64_t west_x = 0, south_y = 0, east_x = 0, north_y = 0;
  bool wraps = false;
  /// Height of the surface at a lattice point, in metres.
  std::function<double(std::int64_t, std::int64_t)> surface_m;
  double max_change_m = 0;                ///< A line's vertex is at most this far from the surface, >= 0.
  double weight = 1e12;                   ///< Of all chains; heavier than streams, which weigh their accumulation.
  std::optional<double> metres_per_unit;  ///< Of Z; default: the unit of the CRS's vertical part, else 1.
  /// Added to each Z, in metres, at longitude and latitude in degrees: what turns the lines' heights into the
  /// surface's (a geoid). May be empty.
  std::function<double(double, double)> shift_m;
};

/// Options for lines on `field`, cut at the bounding box of its posts that are data (source, filled or interpolated).
/// `field` must outlive the options.
BreakLineOptions break_line_options(const HeightField& field, double max_change_m);

struct BreakLineCounts {
  std::int64_t features = 0;    ///< Read, in all files.
  std::int64_t points = 0;      ///< Point geometries, left out.
  std::int64_t outside = 0;     ///< Lines wholly outside the covered area.
  std::int64_t cut = 0;         ///< Lines cut at its side.
  std::int64_t repeated = 0;    ///< Vertices dropped because they fell on the lattice point of the one before.
  std::int64_t meetings = 0;    ///< Places where lines met elsewhere than in their ends.
  std::int64_t shared = 0;      ///< Stretches that several lines had.
  std::int64_t limited = 0;     ///< Vertices whose height was moved towards the surface.
  double largest_change_m = 0;  ///< Of those.
  std::int64_t vertices = 0;    ///< Of the result.
};

struct BreakLineSource {
  std::string name;    ///< File name without folders, with :LAYER where one was named.
  std::string sha256;  ///< Of the ids, coordinates and heights read, lower-case hex.
  std::int64_t features = 0;
  bool lakes = false;
};

struct BreakLines {
  std::vector<BreakChain> chains;        ///< Ascending by their points; first_level 0. Meet in end vertices alone.
  std::vector<bool> is_shore;            ///< Per chain: part of a lake's ring.
  std::vector<BreakLineSource> sources;  ///< As given.
  BreakLineCounts counts;
  std::vector<std::string> notes;  ///< Lines for the user: what was left out, cut, moved, by feature id.
};

/// Reads the user's break lines and lakes and makes them fit for a TIN: cut at the covered area, on lattice points, cut
/// at each other, a vertex at least at every post spacing, heights within the promise. What a file's features have
/// wrong is repaired or left out, and noted. The chains do not depend on the order of files or features.
/// docs/decisions/0009-break-lines.md states the rules. Errors: those of read_line_file and node_lines; kInvalidInput:
/// all lines of a file lie outside.
Result<BreakLines> read_break_lines(std::span<const BreakLineFile> files, const BreakLineOptions& options);

}  // namespace tind
