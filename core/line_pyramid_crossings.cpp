// SPDX-License-Identifier: GPL-3.0-or-later
// Lines of a level that cross each other.
#include <algorithm>
#include <cmath>

#include "core/line_pyramid_builder.hpp"

namespace tind {
namespace {

__extension__ using Int128 = __int128;

// Segments that are looked at together, about: their cells stay in the processor's cache.
constexpr std::size_t kBandSegments = 16384;

// Sign of the area of (a, b, c), exact.
int orientation(std::int64_t ax, std::int64_t ay, std::int64_t bx, std::int64_t by, std::int64_t cx, std::int64_t cy) {
  const Int128 area = Int128{bx - ax} * (cy - ay) - Int128{by - ay} * (cx - ax);
  return area > 0 ? 1 : area < 0 ? -1 : 0;
}

// Rows of cells, as many together as have kBandSegments segments on average.
struct Bands {
  std::int64_t first_row = 0, n_rows = 1;  // of each band; the last may end before
  std::size_t n = 0;
  std::size_t of(std::int64_t row) const { return static_cast<std::size_t>((row - first_row) / n_rows); }
  std::int64_t row_begin(std::size_t band) const { return first_row + static_cast<std::int64_t>(band) * n_rows; }
};

}  // namespace

std::vector<LinePyramidBuilder::Segment> LinePyramidBuilder::segments() const {
  const auto for_segments = [&](auto&& f) {
    for (std::size_t l = 0; l < lines_.size(); ++l) {
      Place before = lines_[l].first;
      if (!drawn_[before]) continue;  // a line's ends are kept, or nothing of it
      for (Place k = before + 1; k < line_end(l); ++k) {
        if (!drawn_[k]) continue;
        f(Segment{before, k});
        before = k;
      }
    }
  };
  std::size_t n = 0;
  for_segments([&](const Segment&) { ++n; });
  std::vector<Segment> segments;
  segments.reserve(n);
  for_segments([&](const Segment& s) { segments.push_back(s); });
  return segments;
}

// True iff the segments meet in a point inside both.
bool LinePyramidBuilder::cross(const Segment& s, const Segment& t) const {
  const Id a = id(s.from), b = id(s.to), c = id(t.from), d = id(t.to);
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

// Segments stay within a tile (or run along a border), so cells that divide a tile's side need no turn of longitude.
// Cells as large as two segments hold few, and few are met by one.
std::int64_t LinePyramidBuilder::cell_side(int level, const std::vector<Segment>& segments) const {
  double extent = 0, n_drawn = 0;
  for (const Segment& s : segments) {
    if (s.dropped()) continue;
    const Id a = id(s.from), b = id(s.to);
    extent +=
        static_cast<double>(std::max(std::abs(unwrapped_x(a, b) - point(a).x), std::abs(point(b).y - point(a).y)));
    n_drawn += 1;
  }
  const double wanted = 2 * extent / std::max(n_drawn, 1.0);
  std::int64_t cell = out_.side_[static_cast<std::size_t>(level)];
  while (cell > 1 && static_cast<double>(cell) > wanted) cell /= 2;
  return cell;
}

// Calls f(cell) for the cells of rows [row_begin, row_end) that a segment meets, and some beside it. Cells are at least
// a lattice step wide and the lattice has fewer than 2^64 points.
template <class F>
void LinePyramidBuilder::for_cells(const Segment& s, std::int64_t cell, std::int64_t row_begin, std::int64_t row_end,
                                   F&& f) const {
  const Id a = id(s.from), b = id(s.to);
  const std::int64_t ax = point(a).x, bx = unwrapped_x(a, b), n = out_.width_ / cell;
  const auto floor_cell = [&](std::int64_t v) { return (v >= 0 ? v : v - cell + 1) / cell; };
  const std::int64_t x0 = floor_cell(std::min(ax, bx)), x1 = floor_cell(std::max(ax, bx));
  const std::int64_t y0 = std::min(point(a).y, point(b).y) / cell, y1 = std::max(point(a).y, point(b).y) / cell;
  const std::int64_t ay = point(a).y, dy = point(b).y - ay;
  const double slope = dy == 0 ? 0 : static_cast<double>(bx - ax) / static_cast<double>(dy);
  for (std::int64_t y = std::max(y0, row_begin); y <= y1 && y < row_end; ++y) {
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
    for (std::int64_t x = first; x <= last; ++x) f(static_cast<std::uint64_t>(y * n + ((x % n) + n) % n));
  }
}

// Pairs of segments that cross, in order. The cells of all segments would be several times larger than the segments, so
// they are made for a band of rows at a time.
std::vector<LinePyramidBuilder::Pair> LinePyramidBuilder::crossing_pairs(int level,
                                                                         const std::vector<Segment>& segments) const {
  const std::int64_t cell = cell_side(level, segments);
  const auto for_drawn = [&](auto&& f) {  // with the first and the last row
    for (std::size_t k = 0; k < segments.size(); ++k) {
      if (segments[k].dropped()) continue;
      const auto [low, high] = std::minmax(point(id(segments[k].from)).y, point(id(segments[k].to)).y);
      f(k, low / cell, high / cell);
    }
  };
  Bands bands;
  std::int64_t last_row = -1;
  bands.first_row = lattice_.height();
  for_drawn([&](std::size_t, std::int64_t low, std::int64_t high) {
    bands.first_row = std::min(bands.first_row, low);
    last_row = std::max(last_row, high);
  });
  if (last_row < 0) return {};
  const auto n_wanted = static_cast<std::int64_t>(segments.size() / kBandSegments + 1);
  bands.n_rows = (last_row - bands.first_row) / n_wanted + 1;
  bands.n = bands.of(last_row) + 1;

  std::vector<std::size_t> ends(bands.n + 1, 0);  // of a band's segments; first the places of its next one
  for_drawn([&](std::size_t, std::int64_t low, std::int64_t high) {
    for (std::size_t band = bands.of(low); band <= bands.of(high); ++band) ++ends[band + 1];
  });
  for (std::size_t band = 0; band < bands.n; ++band) ends[band + 1] += ends[band];
  std::vector<std::uint32_t> of_bands(ends.back());
  for_drawn([&](std::size_t k, std::int64_t low, std::int64_t high) {
    for (std::size_t band = bands.of(low); band <= bands.of(high); ++band) {
      of_bands[ends[band]++] = static_cast<std::uint32_t>(k);
    }
  });

  std::vector<Pair> pairs;
  std::vector<std::pair<std::uint64_t, std::uint32_t>> cells;
  for (std::size_t band = 0, at = 0; band < bands.n; ++band) {
    cells.clear();
    for (; at < ends[band]; ++at) {
      for_cells(segments[of_bands[at]], cell, bands.row_begin(band), bands.row_begin(band + 1),
                [&](std::uint64_t in) { cells.emplace_back(in, of_bands[at]); });
    }
    std::sort(cells.begin(), cells.end());
    for (std::size_t first = 0; first < cells.size();) {
      std::size_t end = first;
      while (end < cells.size() && cells[end].first == cells[first].first) ++end;
      for (std::size_t i = first; i < end; ++i) {
        for (std::size_t j = i + 1; j < end; ++j) {
          if (cross(segments[cells[i].second], segments[cells[j].second])) {
            pairs.emplace_back(cells[i].second, cells[j].second);
          }
        }
      }
      first = end;
    }
  }
  std::sort(pairs.begin(), pairs.end());
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
  return pairs;
}

// Gives lines that cross more vertices until they do not; what has none left to give is dropped, the lighter one.
std::vector<LinePyramidBuilder::Segment> LinePyramidBuilder::part_crossings(int level) {
  std::vector<Segment> all = segments();
  for (;;) {
    const std::vector<Pair> pairs = crossing_pairs(level, all);
    if (pairs.empty()) return all;
    std::vector<bool> touched(all.size(), false);
    std::vector<Segment> added;
    const auto refine = [&](std::size_t k) {
      Segment& s = all[k];
      if (touched[k]) return true;
      if (s.to - s.from < 2) return false;
      const Place middle = farthest(lines_[line_of(s.from)].in_valley, s.from, s.to, level).position;
      drawn_[middle] = true;
      added.push_back({middle, s.to});
      s.to = middle;
      touched[k] = true;
      return true;
    };
    for (const auto& [i, j] : pairs) {
      const bool first = refine(i), second = refine(j);
      if (first || second) continue;
      const bool drop_first = weight(lines_[line_of(all[i].from)]) < weight(lines_[line_of(all[j].from)]);
      Segment& lighter = all[drop_first ? i : j];
      lighter.to = lighter.from;
    }
    all.reserve(all.size() + added.size());  // no more: there may be millions
    all.insert(all.end(), added.begin(), added.end());
  }
}

}  // namespace tind
