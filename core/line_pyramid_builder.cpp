// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/line_pyramid_builder.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numbers>
#include <tuple>

namespace tind {

LinePyramidBuilder::LinePyramidBuilder(LinePyramid& out, const Lattice& lattice, std::span<const LineDetail> detail,
                                       const ScratchAllocator& kept, const ScratchAllocator& working)
    : out_(out),
      kept_(kept),
      working_(working),
      lattice_(lattice),
      detail_(detail),
      bottom_(static_cast<int>(detail.size()) - 1) {
  out_.width_ = lattice.width();
  for (int level = 0; level <= bottom_; ++level) out_.side_.push_back(lattice.tile_side(level));
}

void LinePyramidBuilder::build(std::vector<BreakChain> input) {
  load(input);
  std::vector<BreakChain>().swap(input);
  // A bottom tile has some 200 x 200 posts: a cell is as long as a stretch of stream with a dozen vertices.
  constexpr std::uint64_t kFilterCells = 8;
  const std::uint64_t cell_side = static_cast<std::uint64_t>(out_.side_.back()) / kFilterCells;
  out_.vertex_filter_ = PinFilter(out_.vertices(), std::max(0, static_cast<int>(std::bit_width(cell_side)) - 1));
  out_.levels_.resize(detail_.size());
  if (out_.empty()) return;
  entry_ = ScratchArray<std::uint8_t>(out_.vertices_.size(), working_);
  std::fill(entry_.values().begin(), entry_.values().end(), kNoLevel);
  line_ids_ = ScratchArray<Id>(chain_ids_.size(), working_);
  for (int level = 0; level <= bottom_; ++level) draw(level);
  collect_crossings();
}

// ---- vertices ------------------------------------------------------------------------------------------------------

// Calls f(points) for the stretches of a chain between poles, its crossings with border lines among them, x as given.
// A pole is one point with one height: no line goes there.
template <class F>
void LinePyramidBuilder::for_stretches(const BreakChain& chain, F&& f) {
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

// Each chain's vertices are freed when they are known.
void LinePyramidBuilder::load(std::vector<BreakChain>& input) {
  const std::int64_t width = lattice_.width();
  const auto wrap = [&](std::int64_t x) { return ((x % width) + width) % width; };
  std::size_t n = 0, n_chains = 0;
  for (const BreakChain& chain : input) {
    for_stretches(chain, [&](std::span<const LatticePoint> points) {
      n += points.size();
      ++n_chains;
    });
  }
  if (n == 0) return;
  out_.vertices_ = ScratchArray<LatticePoint>(n, kept_);
  const std::span<LatticePoint> vertices = out_.vertices_.values();
  std::size_t at = 0;
  for (const BreakChain& chain : input) {
    for_stretches(chain, [&](std::span<const LatticePoint> points) {
      for (const LatticePoint& p : points) vertices[at++] = {wrap(p.x), p.y, p.z};
    });
  }
  // Where chains meet they have one height; if the input says two, the lower wins: water runs on.
  std::sort(vertices.begin(), vertices.end(), [](const LatticePoint& a, const LatticePoint& b) {
    return std::tie(a.y, a.x, a.z) < std::tie(b.y, b.x, b.z);
  });
  const auto end = std::unique(vertices.begin(), vertices.end(),
                               [](const LatticePoint& a, const LatticePoint& b) { return a.x == b.x && a.y == b.y; });
  out_.vertices_.keep_first(static_cast<std::size_t>(end - vertices.begin()));
  const auto id_of = [&](const LatticePoint& p) {
    const auto found = std::lower_bound(vertices.begin(), end, std::tuple(p.y, wrap(p.x)),
                                        [](const LatticePoint& q, const std::tuple<std::int64_t, std::int64_t>& key) {
                                          return std::tie(q.y, q.x) < key;
                                        });
    return static_cast<Id>(found - vertices.begin());
  };
  chain_ids_ = ScratchArray<Id>(n, working_);
  chains_.reserve(n_chains + 1);
  at = 0;
  for (std::size_t k = 0; k < input.size(); ++k) {
    for_stretches(input[k], [&](std::span<const LatticePoint> points) {
      chains_.push_back({at, input[k].weight, static_cast<std::uint32_t>(k),
                         static_cast<std::uint8_t>(std::clamp(input[k].first_level, 0, bottom_)), input[k].in_valley});
      for (const LatticePoint& p : points) chain_ids_[at++] = id_of(p);
    });
    std::vector<BreakVertex>().swap(input[k].vertices);
  }
  chains_.push_back({at, 0, 0, 0, false});
}

void LinePyramidBuilder::push(std::vector<LatticePoint>& points, std::int64_t x, std::int64_t y,
                              double height_m) const {
  if (!points.empty() && points.back().x == x && points.back().y == y) return;
  points.push_back({x, y, lattice_.height_from_m(height_m)});
}

// The lattice points where a -> b crosses border lines of the bottom level, in order.
void LinePyramidBuilder::add_crossings(const BreakVertex& a, const BreakVertex& b,
                                       std::vector<LatticePoint>& points) const {
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

std::int64_t LinePyramidBuilder::unwrapped_x(Id from, Id to) const {
  std::int64_t x = point(to).x;
  const std::int64_t d = x - point(from).x;
  if (d > out_.width_ / 2) x -= out_.width_;
  if (d < -out_.width_ / 2) x += out_.width_;
  return x;
}

std::uint8_t LinePyramidBuilder::border_level(std::int64_t at) const {
  if (at == 0) return 0;
  const int level = kLatticeBits + lattice_.level - std::countr_zero(static_cast<std::uint64_t>(at));
  return level > bottom_ ? kNoLevel : static_cast<std::uint8_t>(std::max(level, 0));
}

void LinePyramidBuilder::collect_crossings() {
  const auto for_crossings = [&](auto&& f) {
    for (std::size_t id = 0; id < entry_.size(); ++id) {
      if (entry_[id] == kNoLevel) continue;
      const LatticePoint& p = out_.vertices_[id];
      const std::uint8_t meridian = border_level(p.x), parallel = border_level(p.y);
      if (meridian != kNoLevel) f(LineCrossing{true, p.x, p.y, std::max(entry_[id], meridian)});
      if (parallel != kNoLevel) f(LineCrossing{false, p.y, p.x, std::max(entry_[id], parallel)});
    }
  };
  std::size_t n = 0;
  for_crossings([&](const LineCrossing&) { ++n; });
  out_.crossings_ = ScratchArray<LineCrossing>(n, kept_);
  const std::span<LineCrossing> crossings = out_.crossings_.values();
  n = 0;
  for_crossings([&](const LineCrossing& c) { crossings[n++] = c; });
  std::sort(crossings.begin(), crossings.end(), [](const LineCrossing& a, const LineCrossing& b) {
    return std::tie(a.vertical, a.at, a.t) < std::tie(b.vertical, b.at, b.t);
  });
}

// ---- a level's lines -----------------------------------------------------------------------------------------------

void LinePyramidBuilder::draw(int level) {
  join(level);
  drawn_.assign(n_line_ids_, false);
  for (std::size_t l = 0; l < lines_.size(); ++l) generalise(level, l);
  std::vector<Segment> segments = part_crossings(level);
  for (Place k = 0; k < n_line_ids_; ++k) {
    if (drawn_[k]) entry_[id(k)] = std::min(entry_[id(k)], static_cast<std::uint8_t>(level));
  }
  store(level, std::move(segments));
}

// Ends of chains are 2 k (its first vertex) and 2 k + 1 (its last). For each the end that it is joined to: where
// exactly two meet of those that the level draws.
std::vector<std::uint32_t> LinePyramidBuilder::joined_ends(int level) const {
  struct End {
    Id node;
    std::uint32_t end;
    bool operator<(const End& other) const { return std::tie(node, end) < std::tie(other.node, other.end); }
  };
  const std::size_t n_chains = chains_.size() - 1;
  std::vector<End> ends;
  ends.reserve(2 * n_chains);
  for (std::size_t k = 0; k < n_chains; ++k) {
    if (chains_[k].first_level > level) continue;
    ends.push_back({chain_ids_[chains_[k].first], static_cast<std::uint32_t>(2 * k)});
    ends.push_back({chain_ids_[chains_[k + 1].first - 1], static_cast<std::uint32_t>(2 * k + 1)});
  }
  std::sort(ends.begin(), ends.end());
  std::vector<std::uint32_t> joined(2 * n_chains, std::numeric_limits<std::uint32_t>::max());
  for (std::size_t first = 0; first < ends.size();) {
    std::size_t next = first;
    while (next < ends.size() && ends[next].node == ends[first].node) ++next;
    if (next - first == 2) {
      const std::uint32_t a = ends[first].end, b = ends[first + 1].end;
      // Streams go on downstream only: two that end in one post stay two.
      if (a % 2 != b % 2 || !chains_[a / 2].in_valley || !chains_[b / 2].in_valley) {
        joined[a] = b;
        joined[b] = a;
      }
    }
    first = next;
  }
  return joined;
}

// Joins the chains that the level draws.
void LinePyramidBuilder::join(int level) {
  const std::vector<std::uint32_t> joined = joined_ends(level);
  const auto joins = [&](std::size_t end) { return joined[end] != std::numeric_limits<std::uint32_t>::max(); };
  const std::size_t n_chains = chains_.size() - 1;
  std::vector<bool> used(n_chains, false);
  lines_.clear();
  n_line_ids_ = 0;
  const auto follow = [&](std::size_t start, bool forward) {
    Line line{n_line_ids_, static_cast<std::uint32_t>(start), false};
    const auto append = [&](Id id) {
      if (n_line_ids_ == line.first || line_ids_[n_line_ids_ - 1] != id) line_ids_[n_line_ids_++] = id;
    };
    for (std::size_t k = start;;) {
      used[k] = true;
      const Chain& chain = chains_[k];
      if (chain.weight > weight(line)) line.chain = static_cast<std::uint32_t>(k);
      line.in_valley = line.in_valley || chain.in_valley;
      const std::size_t first = chain.first, end = chains_[k + 1].first;
      if (forward) {
        for (std::size_t i = first; i < end; ++i) append(chain_ids_[i]);
      } else {
        for (std::size_t i = end; i > first; --i) append(chain_ids_[i - 1]);
      }
      const std::size_t last = 2 * k + (forward ? 1 : 0);
      if (!joins(last) || used[joined[last] / 2]) break;
      k = joined[last] / 2;
      forward = joined[last] % 2 == 0;
    }
    lines_.push_back(line);
  };
  for (std::size_t k = 0; k < n_chains; ++k) {
    if (chains_[k].first_level > level || used[k]) continue;
    if (!joins(2 * k)) {
      follow(k, true);
    } else if (!joins(2 * k + 1)) {
      follow(k, false);
    }
  }
  for (std::size_t k = 0; k < n_chains; ++k) {
    if (chains_[k].first_level <= level && !used[k]) follow(k, true);  // rings
  }
}

std::size_t LinePyramidBuilder::line_of(Place at) const {
  const auto after =
      std::upper_bound(lines_.begin(), lines_.end(), at, [](Place p, const Line& line) { return p < line.first; });
  return static_cast<std::size_t>(after - lines_.begin()) - 1;
}

bool LinePyramidBuilder::on_one_border(Id a, Id b, int level) const {
  return (point(a).x == point(b).x && on_border(point(a).x, level)) ||
         (point(a).y == point(b).y && on_border(point(a).y, level));
}

// True iff a -> b -> c stays on one border line. From a meridian to a parallel it does not: b is a corner then, and
// what runs along a line for many tiles must not leave it between two corners.
bool LinePyramidBuilder::along_one_border(Id a, Id b, Id c, int level) const {
  return (point(a).x == point(b).x && point(b).x == point(c).x && on_border(point(b).x, level)) ||
         (point(a).y == point(b).y && point(b).y == point(c).y && on_border(point(b).y, level));
}

// Keeps the ends, what coarser levels keep, where the line meets a border line of the level, and what the detail asks
// for (Douglas and Peucker 1973).
void LinePyramidBuilder::generalise(int level, std::size_t l) {
  const bool in_valley = lines_[l].in_valley;
  const Place first = lines_[l].first, last = line_end(l) - 1;
  const auto pinned = [&](Place k) {
    if (k == first || k == last || entry_[id(k)] < level) return true;
    const LatticePoint& p = point(id(k));
    return (on_border(p.x, level) || on_border(p.y, level)) && !along_one_border(id(k - 1), id(k), id(k + 1), level);
  };
  drawn_[first] = true;
  std::size_t n_drawn = 1;
  Place before = first;
  for (Place k = first + 1; k <= last; ++k) {
    if (!pinned(k)) continue;
    drawn_[k] = true;
    n_drawn += 1 + simplify(in_valley, before, k, level);
    before = k;
  }
  // A ring that the detail leaves no three corners is none at this level.
  if (id(first) == id(last) && n_drawn < 4) {
    for (Place k = first; k <= last; ++k) drawn_[k] = false;
  }
}

// The vertex between two kept ones that strays farthest from the segment between them.
LinePyramidBuilder::Farthest LinePyramidBuilder::farthest(bool in_valley, Place from, Place to, int level) const {
  const LineDetail& detail = detail_[static_cast<std::size_t>(level)];
  const double plan_m = in_valley ? std::min(detail.plan_m, detail.valley_m) : detail.plan_m;
  const Id a = id(from), b = id(to);
  const double metres = lattice_.step_deg() * std::numbers::pi / 180 * lattice_.ellipsoid.semi_major_m;
  const double shrink = std::cos(lattice_.latitude_deg(point(a).y) * std::numbers::pi / 180);
  const auto x_of = [&](Id at) { return static_cast<double>(unwrapped_x(a, at) - point(a).x) * metres * shrink; };
  const auto y_of = [&](Id at) { return static_cast<double>(point(at).y - point(a).y) * metres; };
  const double bx = x_of(b), by = y_of(b), length2 = bx * bx + by * by;
  const double az = lattice_.height_m(point(a).z), bz = lattice_.height_m(point(b).z);
  Farthest worst;
  for (Place k = from + 1; k < to; ++k) {
    const double x = x_of(id(k)), y = y_of(id(k));
    const double w = length2 > 0 ? std::clamp((x * bx + y * by) / length2, 0.0, 1.0) : 0;
    const double plan = std::hypot(x - w * bx, y - w * by);
    const double height = std::abs(az + w * (bz - az) - lattice_.height_m(point(id(k)).z));
    const double share = std::max(plan / plan_m, height / detail.height_m);
    if (share > worst.share) worst = {k, share};
  }
  return worst;
}

// Keeps what the detail asks for between two kept vertices; returns how many.
std::size_t LinePyramidBuilder::simplify(bool in_valley, Place from, Place to, int level) {
  std::size_t n = 0;
  std::vector<std::pair<Place, Place>> open = {{from, to}};  // no recursion: a line may have any length
  while (!open.empty()) {
    const auto [a, b] = open.back();
    open.pop_back();
    if (b - a < 2) continue;
    const Farthest worst = farthest(in_valley, a, b, level);
    if (worst.share <= 1) continue;
    drawn_[worst.position] = true;
    ++n;
    open.emplace_back(a, worst.position);
    open.emplace_back(worst.position, b);
  }
  return n;
}

}  // namespace tind
