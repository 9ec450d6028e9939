// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/noding.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numeric>
#include <string>
#include <tuple>

#include <fmt/format.h>
#include <geos_c.h>

#include "storage/readers/segment_grid.hpp"

namespace tind {
namespace {

/// A GEOS context (one per call: contexts must not be shared by threads) and its last message.
class Geos {
 public:
  Geos() : handle_(GEOS_init_r()) { GEOSContext_setErrorMessageHandler_r(handle_, &Geos::keep, &message_); }
  ~Geos() { GEOS_finish_r(handle_); }
  Geos(const Geos&) = delete;
  Geos& operator=(const Geos&) = delete;

  GEOSContextHandle_t get() const { return handle_; }
  const std::string& message() const { return message_; }

 private:
  static void keep(const char* text, void* message) { *static_cast<std::string*>(message) = text; }
  GEOSContextHandle_t handle_;
  std::string message_;
};

struct GeometryDeleter {
  GEOSContextHandle_t handle;
  void operator()(GEOSGeometry* g) const { GEOSGeom_destroy_r(handle, g); }
};
using Geometry = std::unique_ptr<GEOSGeometry, GeometryDeleter>;

using Points = std::vector<LatticeXy>;

/// The same points for either direction of a line; a ring also starts at its smallest point.
void make_canonical(Points& line) {
  if (line.front() == line.back()) {
    line.pop_back();
    std::rotate(line.begin(), std::min_element(line.begin(), line.end()), line.end());
    line.push_back(line.front());
  }
  if (std::lexicographical_compare(line.rbegin(), line.rend(), line.begin(), line.end()))
    std::reverse(line.begin(), line.end());
}

GEOSGeometry* geos_line(const Geos& geos, const Points& line) {
  GEOSCoordSequence* points = GEOSCoordSeq_create_r(geos.get(), static_cast<unsigned>(line.size()), 2);
  if (points == nullptr) return nullptr;
  unsigned i = 0;
  for (const LatticeXy& p : line)
    GEOSCoordSeq_setXY_r(geos.get(), points, i++, static_cast<double>(p.x), static_cast<double>(p.y));
  return GEOSGeom_createLineString_r(geos.get(), points);
}

/// The noded and dissolved linework of `lines`, sorted; empty with geos.message() on failure.
std::vector<Points> dissolve(const Geos& geos, const std::vector<Points>& lines) {
  std::vector<GEOSGeometry*> parts;
  for (const Points& line : lines) {
    GEOSGeometry* part = geos_line(geos, line);
    if (part == nullptr) {
      for (GEOSGeometry* g : parts) GEOSGeom_destroy_r(geos.get(), g);
      return {};
    }
    parts.push_back(part);
  }
  const GeometryDeleter deleter{geos.get()};
  const Geometry all(
      GEOSGeom_createCollection_r(geos.get(), GEOS_MULTILINESTRING, parts.data(), static_cast<unsigned>(parts.size())),
      deleter);
  if (!all) return {};
  const Geometry noded(GEOSUnaryUnionPrec_r(geos.get(), all.get(), 1.0), deleter);
  if (!noded) return {};
  std::vector<Points> pieces;
  const int n_pieces = GEOSGetNumGeometries_r(geos.get(), noded.get());
  for (int i = 0; i < n_pieces; ++i) {
    const GEOSCoordSequence* points =
        GEOSGeom_getCoordSeq_r(geos.get(), GEOSGetGeometryN_r(geos.get(), noded.get(), i));
    unsigned n_points = 0;
    if (points == nullptr || GEOSCoordSeq_getSize_r(geos.get(), points, &n_points) == 0) return {};
    Points& piece = pieces.emplace_back();
    for (unsigned j = 0; j < n_points; ++j) {
      double x = 0, y = 0;
      GEOSCoordSeq_getXY_r(geos.get(), points, j, &x, &y);
      piece.push_back({std::llround(x), std::llround(y)});
    }
  }
  return pieces;
}

/// Whether no other piece ends where this ring does, so that it may start anywhere. `ends`: of all pieces, sorted.
bool is_free_ring(const LatticeLine& piece, const std::vector<LatticeXy>& ends) {
  const LatticeXy first{piece.front().x, piece.front().y}, last{piece.back().x, piece.back().y};
  if (first != last) return false;
  const auto [from, to] = std::equal_range(ends.begin(), ends.end(), first);
  return to - from == 2;
}

/// What passes a lattice point: segments of the grid, with the lowest height that they have there.
struct Passing {
  std::vector<std::uint32_t> segments;
  double height_m = std::numeric_limits<double>::quiet_NaN();
};

/// Relates noded pieces to the lines that they came from.
class Attribution {
 public:
  explicit Attribution(std::span<const LatticeLine> lines) : lines_(lines), grid_(lines) {}

  Result<void> check_crossings() const {
    if (grid_.count_crossings(kMaxCrossings) < kMaxCrossings) return {};
    return fail(
        ErrorKind::kInvalidInput,
        fmt::format("the break lines cross each other more than {} times; give fewer or simpler lines", kMaxCrossings));
  }

  std::vector<bool> unsettled_lines() const { return grid_.unsettled_lines(); }

  /// A line that stays as it is; its ends may be other lines', too.
  NodedPiece as_piece(std::uint32_t line) const {
    NodedPiece piece{lines_[line], {line}};
    for (BreakVertex* v : {&piece.vertices.front(), &piece.vertices.back()}) v->height_m = pass({v->x, v->y}).height_m;
    return piece;
  }

  void attribute(const Points& points, NodedLines& out) const {
    NodedPiece piece;
    std::vector<std::uint32_t> along;  // segments along the piece's first segment
    Passing last;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const Passing here = pass(points[i]);
      piece.vertices.push_back({points[i].x, points[i].y, here.height_m});
      if (i > 0) {
        std::vector<std::uint32_t> common;
        std::set_intersection(here.segments.begin(), here.segments.end(), last.segments.begin(), last.segments.end(),
                              std::back_inserter(common));
        note_lines(common, piece.lines);
        if (i == 1) along = std::move(common);
      }
      last = here;
    }
    for (std::size_t i = 0; i < along.size(); ++i) {
      for (std::size_t j = i + 1; j < along.size(); ++j) {
        if (!runs_on(along[i], along[j])) out.meetings.push_back(meeting(points.front(), along[i], along[j], true));
      }
    }
    if (!along.empty() && runs_against(points, along.front()))
      std::reverse(piece.vertices.begin(), piece.vertices.end());
    out.pieces.push_back(std::move(piece));
  }

  /// Adds what meets at a node elsewhere than in line ends.
  void find_meetings(LatticeXy node, std::vector<LineMeeting>& out) const {
    // A line's neighbouring segments that touch the node pass it together.
    struct Pass {
      std::uint32_t segment;
      bool is_end;
    };
    std::vector<Pass> passes;
    const Passing here = pass(node);
    for (std::size_t i = 0; i < here.segments.size();) {
      const std::uint32_t first = here.segments[i], line = grid_.line(first);
      std::uint32_t last = first;
      while (++i < here.segments.size() && here.segments[i] == last + 1 && grid_.line(here.segments[i]) == line) ++last;
      const LatticeLine& vertices = lines_[line];
      const bool is_end = (grid_.is_first(first) && same(vertices.front(), node)) ||
                          (grid_.is_last(last) && same(vertices.back(), node));
      passes.push_back({first, is_end});
    }
    if (std::all_of(passes.begin(), passes.end(), [](const Pass& p) { return p.is_end; })) return;
    for (std::size_t i = 0; i < passes.size(); ++i) {
      for (std::size_t j = i + 1; j < passes.size(); ++j)
        out.push_back(meeting(node, passes[i].segment, passes[j].segment, false));
    }
  }

 private:
  static bool same(const BreakVertex& a, const LatticeXy& b) { return a.x == b.x && a.y == b.y; }

  LineMeeting meeting(LatticeXy at, std::uint32_t s, std::uint32_t t, bool shared) const {
    const std::uint32_t a = grid_.line(s), b = grid_.line(t);
    return {at.x, at.y, std::min(a, b), std::max(a, b), shared};
  }

  Passing pass(LatticeXy p) const {
    Passing out;
    grid_.segments_at(p, out.segments);
    for (const std::uint32_t s : out.segments) {
      const double height_m = grid_.height_at(s, p);
      if (!std::isnan(height_m) && !(height_m >= out.height_m)) out.height_m = height_m;
    }
    return out;
  }

  /// Keeps the lines that all segments of the piece have in common, or, where rounding leaves none, all seen.
  void note_lines(const std::vector<std::uint32_t>& segments, std::vector<std::uint32_t>& lines) const {
    std::vector<std::uint32_t> here, common;
    for (const std::uint32_t s : segments) here.push_back(grid_.line(s));
    here.erase(std::unique(here.begin(), here.end()), here.end());
    if (lines.empty()) {
      lines = std::move(here);
      return;
    }
    std::set_intersection(here.begin(), here.end(), lines.begin(), lines.end(), std::back_inserter(common));
    if (common.empty())
      std::set_union(here.begin(), here.end(), lines.begin(), lines.end(), std::back_inserter(common));
    lines = std::move(common);
  }

  /// Whether `t` is the next segment of the same line and no turn back.
  bool runs_on(std::uint32_t s, std::uint32_t t) const {
    if (t != s + 1 || grid_.line(s) != grid_.line(t)) return false;
    const auto [a, b] = grid_.ends(s);
    const auto [c, d] = grid_.ends(t);
    return static_cast<double>(b.x - a.x) * static_cast<double>(d.x - c.x) +
               static_cast<double>(b.y - a.y) * static_cast<double>(d.y - c.y) >=
           0;
  }

  bool runs_against(const Points& points, std::uint32_t segment) const {
    const auto [a, b] = grid_.ends(segment);
    const double dx = static_cast<double>(points[1].x - points[0].x),
                 dy = static_cast<double>(points[1].y - points[0].y);
    return dx * static_cast<double>(b.x - a.x) + dy * static_cast<double>(b.y - a.y) < 0;
  }

  std::span<const LatticeLine> lines_;
  SegmentGrid grid_;
};

/// All lines cut at each other, in no particular order.
Result<std::vector<Points>> cut_lines(const std::vector<LatticeLine>& lines) {
  if (lines.empty()) return std::vector<Points>{};
  // Small numbers for GEOS' doubles, and one order for one set of lines.
  LatticeXy origin{std::numeric_limits<std::int64_t>::max(), std::numeric_limits<std::int64_t>::max()};
  for (const LatticeLine& line : lines) {
    for (const BreakVertex& v : line) origin = {std::min(origin.x, v.x), std::min(origin.y, v.y)};
  }
  std::vector<Points> input;
  for (const LatticeLine& line : lines) {
    Points& points = input.emplace_back();
    for (const BreakVertex& v : line) points.push_back({v.x - origin.x, v.y - origin.y});
    make_canonical(points);
  }
  std::sort(input.begin(), input.end());
  input.erase(std::unique(input.begin(), input.end()), input.end());

  const Geos geos;
  std::vector<Points> pieces = dissolve(geos, input);
  if (pieces.empty()) {
    return fail(ErrorKind::kUnsupported, fmt::format("the break lines cannot be cut at each other (GEOS: {})",
                                                     geos.message().empty() ? "no message" : geos.message()));
  }
  for (Points& piece : pieces) {
    for (LatticeXy& p : piece) p = {p.x + origin.x, p.y + origin.y};
    if (std::lexicographical_compare(piece.rbegin(), piece.rend(), piece.begin(), piece.end()))
      std::reverse(piece.begin(), piece.end());
  }
  std::sort(pieces.begin(), pieces.end());
  return pieces;
}

/// Ascending by points, whichever way a piece runs; rings that nothing else meets start at their smallest point.
void sort_pieces(std::vector<NodedPiece>& pieces) {
  const auto before = [](const BreakVertex& a, const BreakVertex& b) {
    return std::tie(a.x, a.y) < std::tie(b.x, b.y);
  };
  std::vector<LatticeXy> ends;
  for (const NodedPiece& piece : pieces) {
    for (const BreakVertex& v : {piece.vertices.front(), piece.vertices.back()}) ends.push_back({v.x, v.y});
  }
  std::sort(ends.begin(), ends.end());
  std::vector<std::pair<Points, std::size_t>> order;
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    LatticeLine& v = pieces[i].vertices;
    if (is_free_ring(v, ends)) {
      v.pop_back();
      std::rotate(v.begin(), std::min_element(v.begin(), v.end(), before), v.end());
      v.push_back(v.front());
    }
    Points& points = order.emplace_back(Points{}, i).first;
    points.reserve(v.size());
    for (const BreakVertex& p : v) points.push_back({p.x, p.y});
    if (std::lexicographical_compare(points.rbegin(), points.rend(), points.begin(), points.end()))
      std::reverse(points.begin(), points.end());
  }
  std::sort(order.begin(), order.end());
  std::vector<NodedPiece> sorted;
  sorted.reserve(order.size());
  for (const auto& [points, i] : order) sorted.push_back(std::move(pieces[i]));
  pieces = std::move(sorted);
}

}  // namespace

Result<NodedLines> node_lines(std::span<const LatticeLine> lines) {
  NodedLines out;
  if (lines.empty()) return out;
  const Attribution attribution(lines);
  if (auto checked = attribution.check_crossings(); !checked) return tl::unexpected(checked.error());

  // Most lines of most files are well apart or meet in their ends alone, and GEOS is slow.
  const std::vector<bool> unsettled = attribution.unsettled_lines();
  std::vector<LatticeLine> rest;
  for (std::uint32_t l = 0; l < lines.size(); ++l) {
    if (unsettled[l])
      rest.push_back(lines[l]);
    else
      out.pieces.push_back(attribution.as_piece(l));
  }
  auto cut = cut_lines(rest);
  if (!cut) return tl::unexpected(cut.error());
  std::vector<LatticeXy> nodes;
  for (const Points& piece : *cut) {
    attribution.attribute(piece, out);
    nodes.push_back(piece.front());
    nodes.push_back(piece.back());
  }
  std::sort(nodes.begin(), nodes.end());
  nodes.erase(std::unique(nodes.begin(), nodes.end()), nodes.end());
  for (const LatticeXy& node : nodes) attribution.find_meetings(node, out.meetings);
  sort_pieces(out.pieces);
  const auto key = [](const LineMeeting& m) { return std::tie(m.shared_piece, m.y, m.x, m.a, m.b); };
  std::sort(out.meetings.begin(), out.meetings.end(), [&](const auto& m, const auto& n) { return key(m) < key(n); });
  out.meetings.erase(std::unique(out.meetings.begin(), out.meetings.end(),
                                 [&](const auto& m, const auto& n) { return key(m) == key(n); }),
                     out.meetings.end());
  return out;
}

}  // namespace tind
