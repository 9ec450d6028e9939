// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/segment_grid.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace tind {
namespace {

__extension__ using Int128 = __int128;

constexpr std::int64_t kMaxPairs = 100'000'000;

/// +1: c lies left of a -> b, -1: right, 0: on the line. Coordinates below 2^60.
int side(LatticeXy a, LatticeXy b, LatticeXy c) {
  const Int128 v = static_cast<Int128>(b.x - a.x) * (c.y - a.y) - static_cast<Int128>(b.y - a.y) * (c.x - a.x);
  return v > 0 ? 1 : v < 0 ? -1 : 0;
}

bool touches_pixel(LatticeXy a, LatticeXy b, LatticeXy p) {
  // In half steps, so that the pixel's corners are integers.
  a = {2 * a.x, 2 * a.y};
  b = {2 * b.x, 2 * b.y};
  p = {2 * p.x, 2 * p.y};
  if (std::max(a.x, b.x) < p.x - 1 || std::min(a.x, b.x) > p.x + 1) return false;
  if (std::max(a.y, b.y) < p.y - 1 || std::min(a.y, b.y) > p.y + 1) return false;
  int left = 0, right = 0;
  for (const int dx : {-1, 1}) {
    for (const int dy : {-1, 1}) {
      const int s = side(a, b, {p.x + dx, p.y + dy});
      left += s > 0 ? 1 : 0;
      right += s < 0 ? 1 : 0;
    }
  }
  return left < 4 && right < 4;
}

/// From p to the segment, in steps.
double distance(LatticeXy p, LatticeXy a, LatticeXy b) {
  const auto dx = static_cast<double>(b.x - a.x), dy = static_cast<double>(b.y - a.y);
  const auto px = static_cast<double>(p.x - a.x), py = static_cast<double>(p.y - a.y);
  const double t = std::clamp((px * dx + py * dy) / (dx * dx + dy * dy), 0.0, 1.0);
  return std::hypot(px - t * dx, py - t * dy);
}

/// Near enough where segments that cross do so.
LatticeXy crossing(LatticeXy a, LatticeXy b, LatticeXy c, LatticeXy d) {
  const auto ux = static_cast<double>(b.x - a.x), uy = static_cast<double>(b.y - a.y);
  const auto vx = static_cast<double>(d.x - c.x), vy = static_cast<double>(d.y - c.y);
  const double t = (static_cast<double>(c.x - a.x) * vy - static_cast<double>(c.y - a.y) * vx) / (ux * vy - uy * vx);
  return {a.x + std::llround(t * ux), a.y + std::llround(t * uy)};
}

}  // namespace

SegmentGrid::SegmentGrid(std::span<const std::vector<BreakVertex>> lines) : lines_(lines) {
  constexpr std::int64_t kLow = std::numeric_limits<std::int64_t>::min();
  LatticeXy low{-(kLow + 1), -(kLow + 1)}, high{kLow, kLow};
  double length = 0;
  first_of_.push_back(0);
  for (std::uint32_t i = 0; i < lines.size(); ++i) {
    for (std::size_t j = 0; j < lines[i].size(); ++j) {
      const BreakVertex& v = lines[i][j];
      low = {std::min(low.x, v.x), std::min(low.y, v.y)};
      high = {std::max(high.x, v.x), std::max(high.y, v.y)};
      if (j == 0) continue;
      const BreakVertex& u = lines[i][j - 1];
      length += static_cast<double>(std::max(std::abs(v.x - u.x), std::abs(v.y - u.y)));
      line_of_.push_back(i);
    }
    first_of_.push_back(static_cast<std::uint32_t>(line_of_.size()));
  }
  if (line_of_.empty()) return;
  // As many cells as segments, unless these are long.
  const auto n = static_cast<double>(line_of_.size());
  const double wide = static_cast<double>(high.x - low.x) + 3, tall = static_cast<double>(high.y - low.y) + 3;
  cell_ = std::max({4.0, std::sqrt(wide / n * tall), length / n, std::max(wide, tall) / (4 * n)});
  origin_ = {low.x - 1, low.y - 1};
  n_cols_ = static_cast<std::int64_t>(wide / cell_) + 1;
  n_rows_ = static_cast<std::int64_t>(tall / cell_) + 1;

  first_in_.assign(static_cast<std::size_t>(n_rows_ * n_cols_) + 1, 0);
  const auto n_segments = static_cast<std::uint32_t>(line_of_.size());
  for (std::uint32_t s = 0; s < n_segments; ++s) visit_cells(s, [&](std::size_t cell) { ++first_in_[cell + 1]; });
  for (std::size_t i = 1; i < first_in_.size(); ++i) first_in_[i] += first_in_[i - 1];
  segments_.resize(first_in_.back());
  std::vector<std::uint64_t> next(first_in_.begin(), first_in_.end() - 1);
  for (std::uint32_t s = 0; s < n_segments; ++s) visit_cells(s, [&](std::size_t cell) { segments_[next[cell]++] = s; });
}

std::pair<const BreakVertex*, const BreakVertex*> SegmentGrid::vertices(std::uint32_t segment) const {
  const std::uint32_t i = line(segment);
  const BreakVertex* v = &lines_[i][segment - first_of_[i]];
  return {v, v + 1};
}

std::pair<LatticeXy, LatticeXy> SegmentGrid::ends(std::uint32_t segment) const {
  const auto [a, b] = vertices(segment);
  return {{a->x, a->y}, {b->x, b->y}};
}

template <class Visit>
void SegmentGrid::visit_cells(std::uint32_t segment, const Visit& visit) const {
  auto [a, b] = ends(segment);
  if (a.y > b.y) std::swap(a, b);
  const double ax = static_cast<double>(a.x - origin_.x), ay = static_cast<double>(a.y - origin_.y);
  const double bx = static_cast<double>(b.x - origin_.x), by = static_cast<double>(b.y - origin_.y);
  const auto index = [this](double position, std::int64_t n) {
    return std::clamp(static_cast<std::int64_t>(std::floor(position / cell_)), std::int64_t{0}, n - 1);
  };
  const double per_y = by > ay ? (bx - ax) / (by - ay) : 0;
  // The part of the segment within a row of cells, longer at both ends and wider by the surroundings.
  const std::int64_t last_row = index(by + kSettledSteps, n_rows_);
  for (std::int64_t row = index(ay - kSettledSteps, n_rows_); row <= last_row; ++row) {
    const double from_y = std::clamp(static_cast<double>(row) * cell_ - kSettledSteps, ay, by);
    const double to_y = std::clamp(static_cast<double>(row + 1) * cell_ + kSettledSteps, ay, by);
    const double x1 = by > ay ? ax + (from_y - ay) * per_y : ax, x2 = by > ay ? ax + (to_y - ay) * per_y : bx;
    const std::int64_t last_col = index(std::max(x1, x2) + kSettledSteps, n_cols_);
    for (std::int64_t col = index(std::min(x1, x2) - kSettledSteps, n_cols_); col <= last_col; ++col)
      visit(static_cast<std::size_t>(row * n_cols_ + col));
  }
}

std::size_t SegmentGrid::cell_at(LatticeXy p) const {
  const auto col = static_cast<std::int64_t>(std::floor(static_cast<double>(p.x - origin_.x) / cell_));
  const auto row = static_cast<std::int64_t>(std::floor(static_cast<double>(p.y - origin_.y) / cell_));
  if (col < 0 || row < 0 || col >= n_cols_ || row >= n_rows_) return first_in_.size();
  return static_cast<std::size_t>(row * n_cols_ + col);
}

void SegmentGrid::segments_at(LatticeXy p, std::vector<std::uint32_t>& out) const {
  out.clear();
  const std::size_t cell = cell_at(p);
  if (cell + 1 >= first_in_.size()) return;
  for (std::uint64_t i = first_in_[cell]; i < first_in_[cell + 1]; ++i) {
    const auto [a, b] = ends(segments_[i]);
    if (touches_pixel(a, b, p)) out.push_back(segments_[i]);
  }
}

std::int64_t SegmentGrid::count_crossings(std::int64_t limit) const {
  std::int64_t n_crossings = 0, n_pairs = 0;
  for (std::size_t cell = 0; cell + 1 < first_in_.size(); ++cell) {
    for (std::uint64_t i = first_in_[cell]; i < first_in_[cell + 1]; ++i) {
      const auto [a, b] = ends(segments_[i]);
      n_pairs += static_cast<std::int64_t>(i - first_in_[cell]);
      if (n_crossings >= limit || n_pairs > kMaxPairs) return std::min(n_crossings, limit);
      for (std::uint64_t j = first_in_[cell]; j < i; ++j) {
        const auto [c, d] = ends(segments_[j]);
        if (side(a, b, c) * side(a, b, d) < 0 && side(c, d, a) * side(c, d, b) < 0 &&
            cell_at(crossing(a, b, c, d)) == cell)
          ++n_crossings;
      }
    }
  }
  return std::min(n_crossings, limit);
}

bool SegmentGrid::is_line_end(std::uint32_t segment, LatticeXy p) const {
  const auto [a, b] = ends(segment);
  return (is_first(segment) && p == a) || (is_last(segment) && p == b);
}

SegmentGrid::Contact SegmentGrid::contact(std::uint32_t s, std::uint32_t t) const {
  const auto [a, b] = ends(s);
  const auto [c, d] = ends(t);
  const auto far = static_cast<std::int64_t>(kSettledSteps);
  if (std::max(a.x, b.x) + far < std::min(c.x, d.x) || std::max(c.x, d.x) + far < std::min(a.x, b.x) ||
      std::max(a.y, b.y) + far < std::min(c.y, d.y) || std::max(c.y, d.y) + far < std::min(a.y, b.y))
    return Contact::kNone;
  const bool ac = a == c, ad = a == d, bc = b == c, bd = b == d;
  const int n_shared = int{ac} + int{ad} + int{bc} + int{bd};
  if (n_shared == 0) {
    const bool cross = side(a, b, c) * side(a, b, d) < 0 && side(c, d, a) * side(c, d, b) < 0;
    const bool apart = !cross && distance(a, c, d) > kSettledSteps && distance(b, c, d) > kSettledSteps &&
                       distance(c, a, b) > kSettledSteps && distance(d, a, b) > kSettledSteps;
    return apart ? Contact::kNone : Contact::kUnsettled;
  }
  if (n_shared > 1) return Contact::kUnsettled;
  const LatticeXy shared = ac || ad ? a : b;
  const bool neighbours = line(s) == line(t) && (s + 1 == t || t + 1 == s);
  if (!neighbours && !(is_line_end(s, shared) && is_line_end(t, shared))) return Contact::kUnsettled;
  const LatticeXy from = ac || ad ? b : a, to = ac || bc ? d : c;
  const bool apart = distance(from, c, d) > kSettledSteps && distance(to, a, b) > kSettledSteps;
  return apart ? Contact::kJoined : Contact::kUnsettled;
}

std::vector<bool> SegmentGrid::unsettled_lines() const {
  std::vector<bool> unsettled(lines_.size(), false);
  std::vector<std::uint32_t> joined_to(lines_.size());
  std::iota(joined_to.begin(), joined_to.end(), 0U);
  const auto root = [&](std::uint32_t l) {
    while (joined_to[l] != l) l = joined_to[l] = joined_to[joined_to[l]];
    return l;
  };
  std::int64_t n_pairs = 0;
  for (std::size_t cell = 0; cell + 1 < first_in_.size(); ++cell) {
    for (std::uint64_t i = first_in_[cell]; i < first_in_[cell + 1]; ++i) {
      n_pairs += static_cast<std::int64_t>(i - first_in_[cell]);
      if (n_pairs > kMaxPairs) return std::vector<bool>(lines_.size(), true);
      for (std::uint64_t j = first_in_[cell]; j < i; ++j) {
        const std::uint32_t s = segments_[j], t = segments_[i];
        const Contact found = contact(s, t);
        if (found == Contact::kNone) continue;
        joined_to[root(line(s))] = root(line(t));
        if (found == Contact::kUnsettled) unsettled[line(s)] = true;
      }
    }
  }
  std::vector<bool> out(lines_.size(), false);
  for (std::uint32_t l = 0; l < lines_.size(); ++l) {
    if (unsettled[l]) out[root(l)] = true;
  }
  for (std::uint32_t l = 0; l < lines_.size(); ++l) out[l] = out[root(l)];
  return out;
}

double SegmentGrid::height_at(std::uint32_t segment, LatticeXy p) const {
  const auto [a, b] = vertices(segment);
  if (p.x == a->x && p.y == a->y) return a->height_m;
  if (p.x == b->x && p.y == b->y) return b->height_m;
  const double dx = static_cast<double>(b->x - a->x), dy = static_cast<double>(b->y - a->y);
  const double along =
      (static_cast<double>(p.x - a->x) * dx + static_cast<double>(p.y - a->y) * dy) / (dx * dx + dy * dy);
  return std::lerp(a->height_m, b->height_m, std::clamp(along, 0.0, 1.0));
}

}  // namespace tind
