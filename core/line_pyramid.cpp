// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/line_pyramid.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numbers>
#include <tuple>
#include <unordered_map>
#include <utility>

namespace tind {
namespace {

__extension__ using Int128 = __int128;
constexpr std::uint8_t kNone = 255;

// Sign of the area of (a, b, c), exact.
int orientation(std::int64_t ax, std::int64_t ay, std::int64_t bx, std::int64_t by, std::int64_t cx, std::int64_t cy) {
  const Int128 area = Int128{bx - ax} * (cy - ay) - Int128{by - ay} * (cx - ax);
  return area > 0 ? 1 : area < 0 ? -1 : 0;
}

// The coarsest level that has a border line at lattice coordinate `at`, kNone if none up to `bottom` has.
std::uint8_t border_level(std::int64_t at, int lattice_level, int bottom) {
  if (at == 0) return 0;
  const int level = kLatticeBits + lattice_level - std::countr_zero(static_cast<std::uint64_t>(at));
  return level > bottom ? kNone : static_cast<std::uint8_t>(std::max(level, 0));
}

}  // namespace

// Makes a pyramid level by level: what it needs beside the result lives here.
class LinePyramidBuilder {
 public:
  // `done(k)` is called when chain k is not needed any more.
  template <class Done>
  LinePyramidBuilder(LinePyramid& out, const Lattice& lattice, std::span<const BreakChain> input,
                     std::span<const LineDetail> detail, const ScratchAllocator& scratch, Done&& done)
      : out_(out), scratch_(scratch), lattice_(lattice), detail_(detail), bottom_(static_cast<int>(detail.size()) - 1) {
    out_.width_ = lattice.width();
    for (int level = 0; level <= bottom_; ++level) out_.side_.push_back(lattice.tile_side(level));
    load(input, scratch, done);
    out_.vertex_filter_ = PinnedPoints::make_filter(out_.vertices_);
    entry_.assign(out_.vertices_.size(), kNone);
    find_border_levels();
    out_.levels_.resize(detail.size());
    for (int level = 0; level <= bottom_; ++level) draw(level);
    collect_crossings();
  }

 private:
  using Id = std::uint32_t;
  using Place = std::uint32_t;  // position in a line's ids

  struct Chain {
    std::vector<Id> ids;
    int first_level = 0;
    double weight = 0;
    std::size_t given = 0;  // index of the chain it came from
    bool in_valley = false;
  };

  // A line as a level draws it: chains joined where nothing else meets them.
  struct Line {
    std::vector<Id> ids;
    std::vector<Place> drawn;  // in ids, of the vertices that are kept, ascending
    double weight = -1;
    std::size_t chain = 0;  // given chain of that weight
    bool in_valley = false;
  };

  // Two neighbouring kept vertices of a line.
  struct Segment {
    std::uint32_t line = 0;
    Place from = 0, to = 0;
    bool dropped = false;
  };

  // ---- vertices ----------------------------------------------------------------------------------------------------

  // Calls f(points) for the stretches of a chain between poles, its crossings with border lines among them, x as given.
  // A pole is one point with one height: no line goes there.
  template <class F>
  void for_stretches(const BreakChain& chain, F&& f) {
    std::vector<LatticePoint>& points = stretch_;
    const auto finish = [&] {
      if (points.size() >= 2) f(std::span<LatticePoint>(points));
      points.clear();
    };
    const BreakVertex* before = nullptr;
    for (const BreakVertex& v : chain.points()) {
      if (v.y <= 0 || v.y >= lattice_.height()) {
        finish();
        before = nullptr;
        continue;
      }
      if (before != nullptr) add_crossings(*before, v, points);
      push(points, v.x, v.y, v.height_m);
      before = &v;
    }
    finish();
  }

  // Each chain is `done(k)` with when its points are known.
  template <class Done>
  void load(std::span<const BreakChain> input, const ScratchAllocator& scratch, Done&& done) {
    const std::int64_t width = lattice_.width();
    const auto wrap = [&](std::int64_t x) { return ((x % width) + width) % width; };
    std::size_t n = 0;
    for (const BreakChain& chain : input) {
      for_stretches(chain, [&](std::span<const LatticePoint> points) { n += points.size(); });
    }
    if (n == 0) return;
    out_.allocate_vertices(n, scratch);
    std::size_t at = 0;
    for (const BreakChain& chain : input) {
      for_stretches(chain, [&](std::span<const LatticePoint> points) {
        for (const LatticePoint& p : points) out_.vertices_[at++] = {wrap(p.x), p.y, p.z};
      });
    }
    // Where chains meet they have one height; if the input says two, the lower wins: water runs on.
    std::sort(out_.vertices_.begin(), out_.vertices_.end(), [](const LatticePoint& a, const LatticePoint& b) {
      return std::tie(a.y, a.x, a.z) < std::tie(b.y, b.x, b.z);
    });
    const auto end = std::unique(out_.vertices_.begin(), out_.vertices_.end(),
                                 [](const LatticePoint& a, const LatticePoint& b) { return a.x == b.x && a.y == b.y; });
    out_.vertices_ = out_.vertices_.first(static_cast<std::size_t>(end - out_.vertices_.begin()));
    const auto id_of = [&](const LatticePoint& p) {
      const auto found = std::lower_bound(out_.vertices_.begin(), out_.vertices_.end(), std::tuple(p.y, wrap(p.x)),
                                          [](const LatticePoint& q, const std::tuple<std::int64_t, std::int64_t>& key) {
                                            return std::tie(q.y, q.x) < key;
                                          });
      return static_cast<Id>(found - out_.vertices_.begin());
    };
    for (std::size_t k = 0; k < input.size(); ++k) {
      for_stretches(input[k], [&](std::span<const LatticePoint> points) {
        Chain chain{{}, std::clamp(input[k].first_level, 0, bottom_), input[k].weight, k, input[k].in_valley};
        chain.ids.reserve(points.size());
        for (const LatticePoint& p : points) chain.ids.push_back(id_of(p));
        chains_.push_back(std::move(chain));
      });
      done(k);
    }
  }

  void push(std::vector<LatticePoint>& points, std::int64_t x, std::int64_t y, double height_m) const {
    if (!points.empty() && points.back().x == x && points.back().y == y) return;
    points.push_back({x, y, lattice_.height_from_m(height_m)});
  }

  // The lattice points where a -> b crosses border lines of the bottom level, in order.
  void add_crossings(const BreakVertex& a, const BreakVertex& b, std::vector<LatticePoint>& points) const {
    const std::int64_t side = lattice_.tile_side(bottom_);
    std::vector<std::pair<double, BreakVertex>> found;
    const auto cross = [&](std::int64_t from, std::int64_t to, bool vertical) {
      const std::int64_t low = std::min(from, to), high = std::max(from, to);
      // The first line above `low`; x may be negative.
      std::int64_t line = (low >= 0 ? low / side : -((-low + side - 1) / side)) * side + side;
      for (; line < high; line += side) {
        const double w = static_cast<double>(line - from) / static_cast<double>(to - from);
        BreakVertex v;
        v.x = vertical ? line : std::llround(static_cast<double>(a.x) + w * static_cast<double>(b.x - a.x));
        v.y = vertical ? std::llround(static_cast<double>(a.y) + w * static_cast<double>(b.y - a.y)) : line;
        v.height_m = a.height_m + w * (b.height_m - a.height_m);
        found.emplace_back(w, v);
      }
    };
    cross(a.x, b.x, true);
    cross(a.y, b.y, false);
    std::sort(found.begin(), found.end(), [](const auto& p, const auto& q) {
      return std::tie(p.first, p.second.x, p.second.y) < std::tie(q.first, q.second.x, q.second.y);
    });
    for (const auto& [w, v] : found) {
      if (v.y > 0 && v.y < lattice_.height()) push(points, v.x, v.y, v.height_m);
    }
  }

  const LatticePoint& point(Id id) const { return out_.vertices_[id]; }

  // x of `to` as seen from `from`, the short way around the globe.
  std::int64_t unwrapped_x(Id from, Id to) const {
    std::int64_t x = point(to).x;
    const std::int64_t d = x - point(from).x;
    if (d > out_.width_ / 2) x -= out_.width_;
    if (d < -out_.width_ / 2) x += out_.width_;
    return x;
  }

  void find_border_levels() {
    meridian_level_.reserve(out_.vertices_.size());
    parallel_level_.reserve(out_.vertices_.size());
    for (const LatticePoint& p : out_.vertices_) {
      meridian_level_.push_back(border_level(p.x, lattice_.level, bottom_));
      parallel_level_.push_back(border_level(p.y, lattice_.level, bottom_));
    }
  }

  // ---- one level ---------------------------------------------------------------------------------------------------

  void draw(int level) {
    std::vector<Line> lines = join(level);
    for (Line& line : lines) generalise(level, line);
    std::vector<Segment> segments = part_crossings(level, lines);
    LinePyramid::Level& out = out_.levels_[static_cast<std::size_t>(level)];
    for (const Line& line : lines) {
      for (const Place at : line.drawn)
        entry_[line.ids[at]] = std::min<std::uint8_t>(entry_[line.ids[at]], static_cast<std::uint8_t>(level));
    }
    store(level, lines, segments, out);
  }

  // Joins the chains that the level draws where exactly two of them meet.
  std::vector<Line> join(int level) const {
    struct End {
      std::size_t chain;
      bool at_end;
    };
    std::unordered_map<Id, std::vector<End>> nodes;
    for (std::size_t k = 0; k < chains_.size(); ++k) {
      if (chains_[k].first_level > level) continue;
      nodes[chains_[k].ids.front()].push_back({k, false});
      nodes[chains_[k].ids.back()].push_back({k, true});
    }
    // Streams go on downstream only: two that end in one post stay two.
    const auto joins = [&](Id node) {
      const std::vector<End>& ends = nodes.at(node);
      if (ends.size() != 2) return false;
      return ends[0].at_end != ends[1].at_end || !chains_[ends[0].chain].in_valley || !chains_[ends[1].chain].in_valley;
    };
    std::vector<bool> used(chains_.size(), false);
    std::vector<Line> lines;
    const auto follow = [&](std::size_t start, bool forward) {
      Line line;
      std::size_t k = start;
      for (;;) {
        used[k] = true;
        const Chain& chain = chains_[k];
        if (chain.weight > line.weight) {
          line.weight = chain.weight;
          line.chain = chain.given;
        }
        line.in_valley = line.in_valley || chain.in_valley;
        const auto append = [&](auto first, auto last) {
          for (; first != last; ++first) {
            if (line.ids.empty() || line.ids.back() != *first) line.ids.push_back(*first);
          }
        };
        if (forward) {
          append(chain.ids.begin(), chain.ids.end());
        } else {
          append(chain.ids.rbegin(), chain.ids.rend());
        }
        if (!joins(line.ids.back())) break;
        const std::vector<End>& ends = nodes.at(line.ids.back());
        const End& next = ends[0].chain == k && ends[0].at_end == forward ? ends[1] : ends[0];
        if (used[next.chain]) break;
        k = next.chain;
        forward = !next.at_end;
      }
      lines.push_back(std::move(line));
    };
    for (std::size_t k = 0; k < chains_.size(); ++k) {
      if (chains_[k].first_level > level || used[k]) continue;
      if (!joins(chains_[k].ids.front())) {
        follow(k, true);
      } else if (!joins(chains_[k].ids.back())) {
        follow(k, false);
      }
    }
    for (std::size_t k = 0; k < chains_.size(); ++k) {
      if (chains_[k].first_level <= level && !used[k]) follow(k, true);  // rings
    }
    return lines;
  }

  bool on_one_border(Id a, Id b, int level) const {
    return (point(a).x == point(b).x && meridian_level_[a] <= level) ||
           (point(a).y == point(b).y && parallel_level_[a] <= level);
  }

  // True iff a -> b -> c stays on one border line. From a meridian to a parallel it does not: b is a corner then, and
  // what runs along a line for many tiles must not leave it between two corners.
  bool along_one_border(Id a, Id b, Id c, int level) const {
    return (point(a).x == point(b).x && point(b).x == point(c).x && meridian_level_[b] <= level) ||
           (point(a).y == point(b).y && point(b).y == point(c).y && parallel_level_[b] <= level);
  }

  // Keeps the ends, what coarser levels keep, where the line meets a border line of the level, and what the detail asks
  // for (Douglas and Peucker 1973).
  void generalise(int level, Line& line) const {
    const auto last = static_cast<Place>(line.ids.size() - 1);
    std::vector<Place> pins;
    for (Place k = 0; k <= last; ++k) {
      const Id id = line.ids[k];
      bool pinned = k == 0 || k == last || entry_[id] < level;
      if (!pinned && (meridian_level_[id] <= level || parallel_level_[id] <= level)) {
        pinned = !along_one_border(line.ids[k - 1], id, line.ids[k + 1], level);
      }
      if (pinned) pins.push_back(k);
    }
    for (std::size_t k = 0; k + 1 < pins.size(); ++k) {
      line.drawn.push_back(pins[k]);
      simplify(line, pins[k], pins[k + 1], level);
    }
    line.drawn.push_back(pins.back());
    std::sort(line.drawn.begin(), line.drawn.end());
    // A ring that the detail leaves no three corners is none at this level.
    if (line.ids.front() == line.ids.back() && line.drawn.size() < 4) line.drawn.clear();
  }

  struct Farthest {
    Place position = 0;
    double share = -1;  // of what the detail allows
  };

  // The vertex between two kept ones that strays farthest from the segment between them.
  Farthest farthest(const Line& line, Place from, Place to, int level) const {
    const LineDetail& detail = detail_[static_cast<std::size_t>(level)];
    const double plan_m = line.in_valley ? std::min(detail.plan_m, detail.valley_m) : detail.plan_m;
    const Id a = line.ids[from], b = line.ids[to];
    const double metres = lattice_.step_deg() * std::numbers::pi / 180 * lattice_.ellipsoid.semi_major_m;
    const double shrink = std::cos(lattice_.latitude_deg(point(a).y) * std::numbers::pi / 180);
    const auto x_of = [&](Id id) { return static_cast<double>(unwrapped_x(a, id) - point(a).x) * metres * shrink; };
    const auto y_of = [&](Id id) { return static_cast<double>(point(id).y - point(a).y) * metres; };
    const double bx = x_of(b), by = y_of(b), length2 = bx * bx + by * by;
    const double az = lattice_.height_m(point(a).z), bz = lattice_.height_m(point(b).z);
    Farthest worst;
    for (Place k = from + 1; k < to; ++k) {
      const double x = x_of(line.ids[k]), y = y_of(line.ids[k]);
      const double w = length2 > 0 ? std::clamp((x * bx + y * by) / length2, 0.0, 1.0) : 0;
      const double plan = std::hypot(x - w * bx, y - w * by);
      const double height = std::abs(az + w * (bz - az) - lattice_.height_m(point(line.ids[k]).z));
      const double share = std::max(plan / plan_m, height / detail.height_m);
      if (share > worst.share) worst = {k, share};
    }
    return worst;
  }

  // Adds to `drawn`, unordered, what the detail asks for between two kept vertices.
  void simplify(Line& line, Place from, Place to, int level) const {
    std::vector<std::pair<Place, Place>> open = {{from, to}};  // no recursion: a line may have any length
    while (!open.empty()) {
      const auto [a, b] = open.back();
      open.pop_back();
      if (b - a < 2) continue;
      const Farthest worst = farthest(line, a, b, level);
      if (worst.share <= 1) continue;
      line.drawn.push_back(worst.position);
      open.emplace_back(a, worst.position);
      open.emplace_back(worst.position, b);
    }
  }

  // ---- crossings of lines with each other --------------------------------------------------------------------------

  static std::vector<Segment> segments_of(const std::vector<Line>& lines) {
    std::vector<Segment> segments;
    for (std::size_t l = 0; l < lines.size(); ++l) {
      for (std::size_t k = 0; k + 1 < lines[l].drawn.size(); ++k) {
        segments.push_back({static_cast<std::uint32_t>(l), lines[l].drawn[k], lines[l].drawn[k + 1]});
      }
    }
    return segments;
  }

  // True iff the segments meet in a point inside both.
  bool cross(const Line& l, const Segment& s, const Line& m, const Segment& t) const {
    const Id a = l.ids[s.from], b = l.ids[s.to], c = m.ids[t.from], d = m.ids[t.to];
    if (a == c || a == d || b == c || b == d) return false;
    const std::int64_t ax = point(a).x, bx = unwrapped_x(a, b), cx = unwrapped_x(a, c);
    const std::int64_t dx = cx + unwrapped_x(c, d) - point(c).x;
    const std::int64_t ay = point(a).y, by = point(b).y, cy = point(c).y, dy = point(d).y;
    if (std::max(ax, bx) < std::min(cx, dx) || std::max(cx, dx) < std::min(ax, bx) ||
        std::max(ay, by) < std::min(cy, dy) || std::max(cy, dy) < std::min(ay, by)) {
      return false;
    }
    return orientation(ax, ay, bx, by, cx, cy) * orientation(ax, ay, bx, by, dx, dy) < 0 &&
           orientation(cx, cy, dx, dy, ax, ay) * orientation(cx, cy, dx, dy, bx, by) < 0;
  }

  // Pairs of segments that cross, in order.
  std::vector<std::pair<std::size_t, std::size_t>> crossing_pairs(int level, const std::vector<Line>& lines,
                                                                  const std::vector<Segment>& segments) const {
    // Segments stay within a tile (or run along a border), so cells that divide a tile's side need no turn of
    // longitude. Cells as large as two segments hold few, and few are met by one.
    double extent = 0, n_drawn = 0;
    for (const Segment& s : segments) {
      if (s.dropped) continue;
      const Id a = lines[s.line].ids[s.from], b = lines[s.line].ids[s.to];
      extent +=
          static_cast<double>(std::max(std::abs(unwrapped_x(a, b) - point(a).x), std::abs(point(b).y - point(a).y)));
      n_drawn += 1;
    }
    const double wanted = 2 * extent / std::max(n_drawn, 1.0);
    std::int64_t cell = out_.side_[static_cast<std::size_t>(level)];
    while (cell > 1 && static_cast<double>(cell) > wanted) cell /= 2;
    // Cells are at least a lattice step wide and the lattice has fewer than 2^64 points.
    std::vector<std::pair<std::uint64_t, std::uint32_t>> cells;
    for (std::size_t k = 0; k < segments.size(); ++k) {
      const Segment& s = segments[k];
      if (s.dropped) continue;
      const Id a = lines[s.line].ids[s.from], b = lines[s.line].ids[s.to];
      const std::int64_t ax = point(a).x, bx = unwrapped_x(a, b), n = out_.width_ / cell;
      const auto floor_cell = [&](std::int64_t v) { return (v >= 0 ? v : v - cell + 1) / cell; };
      const std::int64_t x0 = floor_cell(std::min(ax, bx)), x1 = floor_cell(std::max(ax, bx));
      const std::int64_t y0 = std::min(point(a).y, point(b).y) / cell, y1 = std::max(point(a).y, point(b).y) / cell;
      const std::int64_t ay = point(a).y, dy = point(b).y - ay;
      const double slope = dy == 0 ? 0 : static_cast<double>(bx - ax) / static_cast<double>(dy);
      for (std::int64_t y = y0; y <= y1; ++y) {
        // A long line meets few of the cells around it: in each row those under it and a step to either side.
        std::int64_t first = x0, last = x1;
        if (y0 < y1) {
          const auto x_at = [&](std::int64_t at) {
            const std::int64_t on = std::clamp(at, std::min(ay, ay + dy), std::max(ay, ay + dy));
            return ax + std::llround(slope * static_cast<double>(on - ay));
          };
          const auto [low, high] = std::minmax({x_at(y * cell), x_at((y + 1) * cell)});
          first = std::max(x0, floor_cell(low - 1));
          last = std::min(x1, floor_cell(high + 1));
        }
        for (std::int64_t x = first; x <= last; ++x) {
          cells.emplace_back(static_cast<std::uint64_t>(y * n + ((x % n) + n) % n), static_cast<std::uint32_t>(k));
        }
      }
    }
    std::sort(cells.begin(), cells.end());
    std::vector<std::pair<std::size_t, std::size_t>> pairs;
    for (std::size_t first = 0; first < cells.size();) {
      std::size_t end = first;
      while (end < cells.size() && cells[end].first == cells[first].first) ++end;
      for (std::size_t i = first; i < end; ++i) {
        for (std::size_t j = i + 1; j < end; ++j) {
          const Segment &s = segments[cells[i].second], &t = segments[cells[j].second];
          if (cross(lines[s.line], s, lines[t.line], t)) pairs.emplace_back(cells[i].second, cells[j].second);
        }
      }
      first = end;
    }
    std::sort(pairs.begin(), pairs.end());
    pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
    return pairs;
  }

  // Gives lines that cross more vertices until they do not; what has none left to give is dropped, the lighter one.
  std::vector<Segment> part_crossings(int level, std::vector<Line>& lines) {
    std::vector<Segment> segments = segments_of(lines);
    for (;;) {
      const auto pairs = crossing_pairs(level, lines, segments);
      if (pairs.empty()) return segments;
      std::vector<bool> touched(segments.size(), false);
      std::vector<Segment> added;
      const auto refine = [&](std::size_t k) {
        Segment& s = segments[k];
        if (touched[k] || s.to - s.from < 2) return touched[k] == true;
        const Place middle = farthest(lines[s.line], s.from, s.to, level).position;
        auto& drawn = lines[s.line].drawn;
        drawn.insert(std::lower_bound(drawn.begin(), drawn.end(), middle), middle);
        added.push_back({s.line, middle, s.to});
        s.to = middle;
        touched[k] = true;
        return true;
      };
      for (const auto& [i, j] : pairs) {
        const bool first = refine(i), second = refine(j);
        if (first || second) continue;
        const bool drop_first = lines[segments[i].line].weight < lines[segments[j].line].weight;
        segments[drop_first ? i : j].dropped = true;
      }
      segments.insert(segments.end(), added.begin(), added.end());
    }
  }

  // ---- results -----------------------------------------------------------------------------------------------------

  void store(int level, const std::vector<Line>& lines, std::vector<Segment>& segments, LinePyramid::Level& out) {
    std::sort(segments.begin(), segments.end(),
              [](const Segment& a, const Segment& b) { return std::tie(a.line, a.from) < std::tie(b.line, b.from); });
    const std::int64_t side = out_.side_[static_cast<std::size_t>(level)];
    struct Ordered {
      LinePyramid::Piece piece;
      double weight;
    };
    std::vector<Ordered> pieces;
    std::vector<Id> line_vertices;
    std::vector<std::uint64_t> line_first;
    std::size_t open_line = std::numeric_limits<std::size_t>::max(), open_at = 0;
    for (const Segment& s : segments) {
      const Line& line = lines[s.line];
      const Id a = line.ids[s.from], b = line.ids[s.to];
      if (s.dropped) {
        ++out.n_dropped;
        continue;
      }
      if (open_line != s.line || open_at != s.from) {
        line_first.push_back(line_vertices.size());
        out.line_chain.push_back(line.chain);
        line_vertices.push_back(a);
      }
      line_vertices.push_back(b);
      open_line = s.line;
      open_at = s.to;
      if (on_one_border(a, b, level)) continue;  // the border line itself is drawn there
      std::int64_t x2 = point(a).x + unwrapped_x(a, b);
      if (x2 < 0) x2 += 2 * out_.width_;
      const auto x = static_cast<std::uint32_t>(x2 / (2 * side)) % TileKey::count_x(level);
      const auto y = static_cast<std::uint32_t>((point(a).y + point(b).y) / (2 * side));
      pieces.push_back({{morton_code(x, y), a, b}, line.weight});
    }
    line_first.push_back(line_vertices.size());
    std::stable_sort(pieces.begin(), pieces.end(), [](const Ordered& p, const Ordered& q) {
      return p.piece.tile != q.piece.tile ? p.piece.tile < q.piece.tile : p.weight > q.weight;
    });
    std::vector<LinePyramid::Piece> in_order;
    in_order.reserve(pieces.size());
    for (const Ordered& p : pieces) in_order.push_back(p.piece);
    std::vector<Ordered>().swap(pieces);
    out.pieces.settle(std::move(in_order), scratch_);
    out.line_vertices.settle(std::move(line_vertices), scratch_);
    out.line_first.settle(std::move(line_first), scratch_);
  }

  void collect_crossings() {
    std::vector<LineCrossing> crossings;
    for (Id id = 0; id < static_cast<Id>(out_.vertices_.size()); ++id) {
      if (entry_[id] == kNone) continue;
      const LatticePoint& p = point(id);
      if (meridian_level_[id] != kNone) {
        crossings.push_back({true, p.x, p.y, std::max(entry_[id], meridian_level_[id])});
      }
      if (parallel_level_[id] != kNone) {
        crossings.push_back({false, p.y, p.x, std::max(entry_[id], parallel_level_[id])});
      }
    }
    std::sort(crossings.begin(), crossings.end(), [](const LineCrossing& a, const LineCrossing& b) {
      return std::tie(a.vertical, a.at, a.t) < std::tie(b.vertical, b.at, b.t);
    });
    out_.crossings_.settle(std::move(crossings), scratch_);
  }

  LinePyramid& out_;
  const ScratchAllocator& scratch_;
  const Lattice& lattice_;
  const std::span<const LineDetail> detail_;
  const int bottom_;
  std::vector<Chain> chains_;
  std::vector<LatticePoint> stretch_;
  std::vector<std::uint8_t> entry_;                            // coarsest level that keeps the vertex
  std::vector<std::uint8_t> meridian_level_, parallel_level_;  // coarsest border line through the vertex
};

LinePyramid::LinePyramid(const Lattice& lattice, std::span<const BreakChain> chains,
                         std::span<const LineDetail> detail) {
  LinePyramidBuilder(*this, lattice, chains, detail, {}, [](std::size_t) {});
}

LinePyramid::LinePyramid(const Lattice& lattice, std::span<BreakChain> chains, std::span<const LineDetail> detail,
                         const ScratchAllocator& scratch) {
  LinePyramidBuilder(*this, lattice, chains, detail, scratch,
                     [&](std::size_t k) { std::vector<BreakVertex>().swap(chains[k].vertices); });
}

void LinePyramid::allocate_vertices(std::size_t n, const ScratchAllocator& scratch) {
  void* const memory = scratch ? scratch(n * sizeof(LatticePoint)) : nullptr;
  if (memory == nullptr) {
    owned_vertices_.resize(n);
    vertices_ = owned_vertices_;
  } else {
    vertices_ = {static_cast<LatticePoint*>(memory), n};
  }
}

std::span<const LineCrossing> LinePyramid::crossings(bool vertical, std::int64_t at, std::int64_t start,
                                                     std::int64_t end) const {
  const auto before = [](const LineCrossing& c, const std::tuple<bool, std::int64_t, std::int64_t>& key) {
    return std::tie(c.vertical, c.at, c.t) < key;
  };
  const auto first =
      std::lower_bound(crossings_.view.begin(), crossings_.view.end(), std::tuple(vertical, at, start + 1), before);
  const auto last = std::lower_bound(first, crossings_.view.end(), std::tuple(vertical, at, end), before);
  return {first, last};
}

std::vector<LineSegment> LinePyramid::segments(const TileKey& tile) const {
  std::vector<LineSegment> found;
  if (empty()) return found;
  const Level& level = levels_[tile.level];
  const std::uint64_t code = morton_code(tile.x, tile.y);
  const auto first = std::lower_bound(level.pieces.view.begin(), level.pieces.view.end(), code,
                                      [](const Piece& p, std::uint64_t c) { return p.tile < c; });
  const std::int64_t west = side_[tile.level] * tile.x;
  for (auto piece = first; piece != level.pieces.view.end() && piece->tile == code; ++piece) {
    LineSegment s{vertices_[piece->a], vertices_[piece->b]};
    if (s.a.x < west) s.a.x += width_;  // longitude +180
    if (s.b.x < west) s.b.x += width_;
    found.push_back(s);
  }
  return found;
}

std::vector<DrawnLine> LinePyramid::drawn(int level) const {
  std::vector<DrawnLine> lines;
  if (empty()) return lines;
  const Level& in = levels_[static_cast<std::size_t>(level)];
  for (std::size_t l = 0; l + 1 < in.line_first.view.size(); ++l) {
    DrawnLine line{{}, in.line_chain[l]};
    for (std::uint64_t k = in.line_first.view[l]; k < in.line_first.view[l + 1]; ++k) {
      line.vertices.push_back(vertices_[in.line_vertices.view[k]]);
    }
    lines.push_back(std::move(line));
  }
  return lines;
}

}  // namespace tind
