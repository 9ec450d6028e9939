// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/lattice.hpp"
#include "core/result.hpp"

namespace tind {

/// Lines for the user: each kind of finding once, with its count and the first few examples.
class FindingList {
 public:
  static constexpr std::size_t kMaxExamples = 5;
  /// `what` reads on from a count, for example "vertices that are no numbers were left out". Repeated examples are
  /// named once.
  void add(const std::string& what, const std::string& example, std::int64_t count = 1);
  /// "12 vertices that are no numbers were left out: feature 3, feature 9", in the order of first mention.
  std::vector<std::string> lines() const;

 private:
  struct Finding {
    std::string what;
    std::int64_t count = 0;
    std::vector<std::string> examples;
    bool more = false;
  };
  std::vector<Finding> findings_;
};

/// A position of a source line on the lattice, not rounded. NaN height: none of its own.
struct SourceVertex {
  double x = 0, y = 0;
  double height_m = 0;
};

/// An unbroken line of a feature, or one ring of it.
struct SourceLine {
  std::int64_t feature = 0;            ///< OGR's feature id.
  std::optional<std::size_t> polygon;  ///< Which polygon of the file, counted from 0; none for a line.
  std::vector<SourceVertex> vertices;  ///< At least 1. x is continuous: it may run below 0 or past the width.
};

struct LineFile {
  std::string name;  ///< File name without folders, with :LAYER where one was named.
  std::vector<SourceLine> lines;
  std::int64_t n_features = 0;
  std::int64_t n_points = 0;  ///< Point geometries, left out.
  bool has_heights = false;
  std::string sha256;  ///< Of what was read: ids, coordinates and heights, in the file's order.
  std::vector<std::string> notes;
};

/// What turns a file's coordinates into lattice positions and heights.
struct LineFrame {
  Lattice lattice;
  double dx = 0, dy = 0;                  ///< Lattice steps between posts: bounds the bend of a segment.
  std::optional<double> metres_per_unit;  ///< Of Z; default: the unit of the CRS's vertical part, else 1.
  /// Added to each Z, in metres, at longitude and latitude in degrees (a geoid, where the surface has one); may be
  /// empty.
  std::function<double(double, double)> shift_m;
};

/// A segment that is straight in its own CRS gets vertices until it is straight on the lattice within this share of a
/// post spacing.
inline constexpr double kMaxBendPosts = 1.0 / 16;
/// Lines with more vertices than this are refused: a gigabyte of memory.
inline constexpr std::int64_t kMaxLineVertices = 20'000'000;

/// Reads all lines and rings of one layer. `spec`: FILE or FILE:LAYER, any OGR source; a .zip is looked into. A name
/// that exists as it stands has no layer. kNotFound: no such file. kInvalidInput: not vector data, no such layer,
/// several layers and none named, no lines, no CRS and coordinates beyond degrees, a CRS without relation to the globe,
/// too many vertices. kIo: reading broke off. Bad vertices and features are left out and noted.
Result<LineFile> read_line_file(const std::string& spec, const LineFrame& frame);

}  // namespace tind
