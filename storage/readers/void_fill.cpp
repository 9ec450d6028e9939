// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/void_fill.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <span>
#include <vector>

namespace tind {
namespace {

/// Void posts [begin, end) of one row.
struct Run {
  std::int64_t row, begin, end;
};

/// Disjoint sets with path halving; the smaller index becomes the root, so roots do not depend on the order of unions.
class DisjointSets {
 public:
  explicit DisjointSets(std::size_t n) : parent_(n) { std::iota(parent_.begin(), parent_.end(), std::size_t{0}); }
  std::size_t root(std::size_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void unite(std::size_t a, std::size_t b) {
    a = root(a);
    b = root(b);
    parent_[std::max(a, b)] = std::min(a, b);
  }

 private:
  std::vector<std::size_t> parent_;
};

/// Void runs of the frame by row, and first run of each row in `row_start` (one more entry than rows).
std::vector<Run> find_runs(const PostGrid& grid, const DataFrame& frame, std::vector<std::size_t>& row_start) {
  std::vector<Run> runs;
  for (std::int64_t r = frame.south_row; r <= frame.north_row; ++r) {
    row_start.push_back(runs.size());
    const PostOrigin* row = grid.origins + r * grid.n_cols;
    const std::int64_t end = frame.east_col + 1;
    for (std::int64_t begin = next_void(row, frame.west_col, end); begin < end;) {
      const std::int64_t run_end = next_post(row, begin, end);
      runs.push_back({r, begin, run_end});
      begin = next_void(row, run_end, end);
    }
  }
  row_start.push_back(runs.size());
  return runs;
}

/// Membrane over one window: known cells are fixed, unknown ones become the mean of their neighbours, absent ones are
/// not part of it. Row-major; `closed`: the columns wrap.
class Membrane {
 public:
  enum Kind : std::uint8_t { kAbsent, kKnown, kUnknown };

  Membrane(std::int64_t n_rows, std::int64_t n_cols, bool closed)
      : n_rows_(n_rows),
        n_cols_(n_cols),
        closed_(closed),
        value_(static_cast<std::size_t>(n_rows * n_cols)),
        kind_(static_cast<std::size_t>(n_rows * n_cols), kAbsent) {}

  void set_known(std::int64_t r, std::int64_t c, float value) { value_[at(r, c)] = value, kind_[at(r, c)] = kKnown; }
  void set_unknown(std::int64_t r, std::int64_t c) { kind_[at(r, c)] = kUnknown; }
  float value(std::int64_t r, std::int64_t c) const { return value_[at(r, c)]; }

  /// Solves from a window of half the size (recursively), then relaxes until no value moves by more than a millimetre,
  /// at most `max_sweeps` times. Every step is a mean, so no value leaves the range of the known ones.
  void solve(int max_sweeps, CancelFlag cancel) {
    std::vector<std::pair<std::int64_t, std::int64_t>> unknown;
    for (std::int64_t r = 0; r < n_rows_; ++r) {
      for (std::int64_t c = 0; c < n_cols_; ++c) {
        if (kind_[at(r, c)] == kUnknown) unknown.emplace_back(r, c);
      }
    }
    if (unknown.empty()) return;
    start_from_coarse(unknown, cancel);
    for (int sweep = 0; sweep < max_sweeps && !is_set(cancel); ++sweep) {
      float moved = 0;
      const auto relax = [&](const std::pair<std::int64_t, std::int64_t>& cell) {
        const float mean = mean_of_neighbours(cell.first, cell.second);
        float& v = value_[at(cell.first, cell.second)];
        moved = std::max(moved, std::abs(mean - v));
        v = mean;
      };
      // Both directions in turn: no side of the window is favoured.
      if (sweep % 2 == 0) {
        std::for_each(unknown.begin(), unknown.end(), relax);
      } else {
        std::for_each(unknown.rbegin(), unknown.rend(), relax);
      }
      if (moved < 1e-3f) break;
    }
  }

 private:
  static constexpr int kCoarseSweeps = 32;

  std::size_t at(std::int64_t r, std::int64_t c) const { return static_cast<std::size_t>(r * n_cols_ + c); }

  void start_from_coarse(const std::vector<std::pair<std::int64_t, std::int64_t>>& unknown, CancelFlag cancel) {
    Membrane coarse((n_rows_ + 1) / 2, (n_cols_ + 1) / 2, closed_);
    std::vector<float> sum(coarse.value_.size());
    std::vector<std::uint8_t> count(coarse.value_.size());
    for (std::int64_t r = 0; r < n_rows_; ++r) {
      for (std::int64_t c = 0; c < n_cols_; ++c) {
        const std::size_t to = coarse.at(r / 2, c / 2);
        if (kind_[at(r, c)] == kKnown) {
          sum[to] += value_[at(r, c)];
          ++count[to];
        } else if (kind_[at(r, c)] == kUnknown) {
          coarse.kind_[to] = kUnknown;
        }
      }
    }
    for (std::size_t i = 0; i < sum.size(); ++i) {
      if (count[i] == 0) continue;
      coarse.kind_[i] = kKnown;
      coarse.value_[i] = sum[i] / static_cast<float>(count[i]);
    }
    coarse.solve(kCoarseSweeps, cancel);
    for (const auto& [r, c] : unknown) value_[at(r, c)] = coarse.value(r / 2, c / 2);
  }

  float mean_of_neighbours(std::int64_t r, std::int64_t c) const {
    float sum = 0;
    int n = 0;
    const auto add = [&](std::int64_t rr, std::int64_t cc) {
      const std::size_t i = at(rr, cc);
      if (kind_[i] == kAbsent) return;
      sum += value_[i];
      ++n;
    };
    if (r > 0) add(r - 1, c);
    if (r + 1 < n_rows_) add(r + 1, c);
    if (c > 0 || closed_) add(r, c > 0 ? c - 1 : n_cols_ - 1);
    if (c + 1 < n_cols_ || closed_) add(r, c + 1 < n_cols_ ? c + 1 : 0);
    return n > 0 ? sum / static_cast<float>(n) : value_[at(r, c)];
  }

  std::int64_t n_rows_, n_cols_;
  bool closed_;
  std::vector<float> value_;
  std::vector<std::uint8_t> kind_;
};

/// Fills one void, given as its runs in row order.
void fill_void(PostGrid& grid, const DataFrame& frame, std::span<const Run> runs) {
  constexpr int kMaxSweeps = 256;
  std::int64_t south = runs.front().row, north = south, west = grid.n_cols, east = 0;
  bool at_west_seam = false, at_east_seam = false;
  for (const Run& run : runs) {
    south = std::min(south, run.row);
    north = std::max(north, run.row);
    west = std::min(west, run.begin);
    east = std::max(east, run.end - 1);
    at_west_seam |= run.begin == 0;
    at_east_seam |= run.end == grid.n_cols;
  }
  // One post of rim on every side; across the seam of a grid that wraps the window is the whole ring.
  const bool ring = grid.wraps && (at_west_seam || at_east_seam);
  south = std::max(south - 1, frame.south_row);
  north = std::min(north + 1, frame.north_row);
  west = ring ? 0 : std::max(west - 1, frame.west_col);
  east = ring ? grid.n_cols - 1 : std::min(east + 1, frame.east_col);

  Membrane membrane(north - south + 1, east - west + 1, ring);
  float low = std::numeric_limits<float>::infinity(), high = -low;
  const auto rim = [&](std::int64_t r, std::int64_t c) {
    if (r < south || r > north) return;
    if (grid.wraps) c = (c + grid.n_cols) % grid.n_cols;
    if (c < west || c > east || grid.origins[r * grid.n_cols + c] != PostOrigin::kSource) return;
    const float height = grid.heights_m[r * grid.n_cols + c];
    membrane.set_known(r - south, c - west, height);
    low = std::min(low, height);
    high = std::max(high, height);
  };
  for (const Run& run : runs) {
    rim(run.row, run.begin - 1);
    rim(run.row, run.end);
    for (std::int64_t c = run.begin; c < run.end; ++c) {
      rim(run.row - 1, c);
      rim(run.row + 1, c);
      membrane.set_unknown(run.row - south, c - west);
    }
  }
  membrane.solve(kMaxSweeps, grid.cancel);
  for (const Run& run : runs) {
    for (std::int64_t c = run.begin; c < run.end; ++c) {
      // Means of floats may leave the range by a rounding.
      const float height = std::clamp(membrane.value(run.row - south, c - west), low, high);
      grid.heights_m[run.row * grid.n_cols + c] = height;
    }
  }
}

}  // namespace

std::int64_t next_void(const PostOrigin* origins, std::int64_t from, std::int64_t n) {
  static_assert(static_cast<int>(PostOrigin::kBase) == 0 && sizeof(PostOrigin) == 1);
  const void* at = std::memchr(origins + from, 0, static_cast<std::size_t>(n - from));
  return at == nullptr ? n : static_cast<const PostOrigin*>(at) - origins;
}

std::int64_t next_post(const PostOrigin* origins, std::int64_t from, std::int64_t n) {
  for (std::uint64_t eight = 0; from + 8 <= n; from += 8) {
    std::memcpy(&eight, origins + from, sizeof eight);
    if (eight != 0) break;
  }
  while (from < n && origins[from] == PostOrigin::kBase) ++from;
  return from;
}

std::uint64_t fill_interior_voids(PostGrid& grid, const DataFrame& frame) {
  std::vector<std::size_t> row_start;
  const std::vector<Run> runs = find_runs(grid, frame, row_start);
  if (runs.empty()) return 0;
  DisjointSets sets(runs.size());
  for (std::size_t row = 0; row + 1 < row_start.size(); ++row) {
    const std::size_t begin = row_start[row], end = row_start[row + 1];
    if (grid.wraps && end > begin && runs[begin].begin == 0 && runs[end - 1].end == grid.n_cols)
      sets.unite(begin, end - 1);
    if (row == 0) continue;
    for (std::size_t below = row_start[row - 1], here = begin; below < begin && here < end;) {
      if (runs[below].begin < runs[here].end && runs[here].begin < runs[below].end) sets.unite(below, here);
      if (runs[below].end < runs[here].end) {
        ++below;
      } else {
        ++here;
      }
    }
  }
  std::vector<bool> outside(runs.size(), false);
  for (std::size_t i = 0; i < runs.size(); ++i) {
    const Run& run = runs[i];
    const bool at_rim = (run.row == frame.south_row && frame.open_south) ||
                        (run.row == frame.north_row && frame.open_north) ||
                        (!grid.wraps && (run.begin == frame.west_col || run.end == frame.east_col + 1));
    if (at_rim) outside[sets.root(i)] = true;
  }
  // Runs grouped by void, in row order within each.
  std::vector<std::size_t> order;
  for (std::size_t i = 0; i < runs.size(); ++i) {
    if (!outside[sets.root(i)]) order.push_back(i);
  }
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return sets.root(a) < sets.root(b); });
  std::uint64_t n_filled = 0;
  std::vector<Run> members;
  for (std::size_t i = 0; i < order.size();) {
    const std::size_t root = sets.root(order[i]);
    members.clear();
    for (; i < order.size() && sets.root(order[i]) == root; ++i) members.push_back(runs[order[i]]);
    fill_void(grid, frame, members);
  }
  for (const std::size_t i : order) {
    std::fill(grid.origins + runs[i].row * grid.n_cols + runs[i].begin,
              grid.origins + runs[i].row * grid.n_cols + runs[i].end, PostOrigin::kFilled);
    n_filled += static_cast<std::uint64_t>(runs[i].end - runs[i].begin);
  }
  return n_filled;
}

}  // namespace tind
