// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/tile_errors.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/drainage/flow_run.hpp"
#include "core/triangle_blocks.hpp"

namespace tind {

// One triangle over the posts of a cell.
class TileErrors::OfTriangle {
 public:
  OfTriangle(const TilePosts& posts, const SquareQuantum& quantum, const Cell& cell, const PlanTriangle& plan,
             const FacePlane& plane)
      : posts_(posts),
        quantum_(quantum),
        cell_(cell),
        w_(cell.window),
        in_(plan, w_),
        rows_(in_.u, in_.v),
        plane_(plane),
        over_(plane_over(plane, w_)) {
    const PostBlocks::Extent& e = cell.posts;
    row_first_ = std::max(e.row, ceil_of(rows_.south()));
    row_end_ = std::min(e.row + e.n_rows, ceil_of(rows_.north()));
    col_first_ = std::max(e.col, ceil_of(in_.west() - kNoPost));
    col_end_ = std::min(e.col + e.n_cols, floor_of(in_.east() + kNoPost) + 1);
  }

  void add_to(const FaceScanner& scanner, Sums& sums) const {
    if (row_first_ >= row_end_ || col_first_ >= col_end_) return;
    if (!posts_.has_blocks() || !in_.is_large()) {
      add_box(cell_.posts, cell_.all_source, sums);
      return;
    }
    const PostBlocks& blocks = posts_.blocks();
    TriangleBlocks walk(blocks, w_.field_row, w_.field_col, in_.u, in_.v, kNoPost);
    walk.clip({row_first_, col_first_, row_end_ - row_first_, col_end_ - col_first_});
    // First the largest error, by the most promising blocks; then no block can hold a larger one.
    walk.for_promising(
        sums.largest_m,
        [&](const PostBlock& block, const PostBlocks::Extent& e) { return scanner.plane_bound(plane_, w_, block, e); },
        [&](const BlockInWindow& b) {
          Sums here;
          add_box(b.posts, cell_.all_source || is_source(b), here);
          sums.largest_m = greater(here.largest_m, sums.largest_m);
        });
    const auto descend = [&](const BlockInWindow& b, const auto& self) -> void {
      if (is_inside(b) && is_source(b)) {
        const PostBlocks::Extent& e = b.posts;
        const PostPlane own{plane_.at(w_.x(e.col), w_.y(e.row)), over_.per_col, plane_.slope_y * w_.dy};
        sums.n_quanta += quantum_.count(blocks.squared_distance_m2(b.level, b.i, b.j, own));
        sums.n += static_cast<std::uint64_t>(e.n_posts());
      } else if (b.level > 0) {
        walk.for_children(b, [&](const BlockInWindow& child) { self(child, self); });
      } else {
        add_box(b.posts, cell_.all_source || is_source(b), sums);
      }
    };
    walk.for_coarsest([&](const BlockInWindow& b) { descend(b, descend); });
  }

 private:
  bool is_source(const BlockInWindow& b) const {
    return posts_.blocks().block(b.level, b.i, b.j).is_all(PostOrigin::kSource);
  }

  // Whether all posts of a block count and lie in the triangle.
  bool is_inside(const BlockInWindow& b) const {
    const PostBlocks::Extent& e = b.posts;
    if (e.row < row_first_ || e.row + e.n_rows > row_end_ || e.col < col_first_ || e.col + e.n_cols > col_end_) {
      return false;
    }
    const auto has = [&](std::int64_t row) {
      const auto [west, east] = rows_.cuts(static_cast<double>(row));
      return west <= static_cast<double>(e.col) && static_cast<double>(e.col + e.n_cols - 1) < east;
    };
    return has(e.row) && has(e.row + e.n_rows - 1);
  }

  // The triangle's posts in a part of the window, from its western cuts up to, not including, its eastern ones.
  void add_box(const PostBlocks::Extent& e, bool all_source, Sums& sums) const {
    const std::int64_t r_first = std::max(row_first_, e.row), r_end = std::min(row_end_, e.row + e.n_rows);
    const std::int64_t c_first = std::max(col_first_, e.col), c_end = std::min(col_end_, e.col + e.n_cols);
    if (r_first >= r_end || c_first >= c_end) return;
    const auto strip = [&](const PostStrip& s) {
      const StripErrors here = errors_in_strip(s, rows_, over_, quantum_);
      sums.add({here.largest_m, here.n, here.n_quanta});
    };
    for (std::int64_t row = r_first; row < r_end; row += PostStrip::kMostRows) {
      const std::int64_t end = std::min(r_end, row + PostStrip::kMostRows);
      if (all_source && posts_.for_strips(w_, {row, c_first, end - row, c_end - c_first}, strip)) continue;
      add_rows(row, end, c_first, c_end, all_source, sums);
    }
  }

  void add_rows(std::int64_t r_first, std::int64_t r_end, std::int64_t c_first, std::int64_t c_end, bool all_source,
                Sums& sums) const {
    for (std::int64_t r = r_first; r < r_end; ++r) {
      const auto [west, east] = rows_.cuts(static_cast<double>(r));
      const std::int64_t first = std::max(c_first, ceil_of(west)), end = std::min(c_end, ceil_of(east));
      const double z = plane_.at(w_.x0, w_.y(r));
      if (first >= end) continue;
      const auto part = [&](const float* heights, const PostOrigin* origins, std::int64_t c_begin,
                            std::int64_t c_stop) {
        double col = static_cast<double>(c_begin);
        for (std::int64_t k = 0; k < c_stop - c_begin; ++k, ++col) {
          if (!all_source && origins[k] != PostOrigin::kSource) continue;
          const double error = std::abs(z + over_.per_col * col - static_cast<double>(heights[k]));
          sums.add({error, 1, quantum_.square(error)});
        }
      };
      posts_.for_parts(w_, r, first, end, part);
    }
  }

  const TilePosts& posts_;
  const SquareQuantum& quantum_;
  const Cell& cell_;
  const PostWindow& w_;
  const TriangleInPosts in_;
  const TriangleRows rows_;
  const FacePlane& plane_;
  const PlaneOverPosts over_;
  std::int64_t row_first_ = 0, row_end_ = 0, col_first_ = 0, col_end_ = 0;
};

// The triangles that may meet each wanted cell of a window, in order.
class TileErrors::Buckets {
 public:
  Buckets(const TileErrors& errors, const PostWindow& w, const CellLines& lines, const std::vector<bool>& wanted) {
    const std::size_t n_triangles = errors.triangles_.size(), side = lines.rows.size() - 1;
    if (side == 1) {
      triangles_.resize(n_triangles);
      for (std::size_t k = 0; k < n_triangles; ++k) triangles_[k] = static_cast<std::uint32_t>(k);
      first_ = {0, n_triangles};
      return;
    }
    struct Cells {
      std::uint16_t row, row_end, col, col_end;
    };
    const auto range = [](const std::vector<std::int64_t>& begins, double low, double high) {
      // One post more, so that no rounding of a cut is missed.
      const auto before = [&begins](std::int64_t at) {
        const auto after = std::upper_bound(begins.begin(), begins.end() - 1, at);
        return static_cast<std::uint16_t>(std::max<std::ptrdiff_t>(after - begins.begin() - 1, 0));
      };
      return std::pair(before(floor_of(low) - 1), static_cast<std::uint16_t>(before(ceil_of(high) + 1) + 1));
    };
    std::vector<Cells> met(n_triangles);
    first_.assign(side * side + 1, 0);
    // Of the posts of cells that are wanted.
    constexpr auto kMost = std::numeric_limits<double>::max();
    double south = kMost, north = -kMost, west = kMost, east = -kMost;
    for (std::size_t cell = 0; cell < wanted.size(); ++cell) {
      if (!wanted[cell]) continue;
      const std::size_t j = cell / side, i = cell % side;
      south = std::min(south, static_cast<double>(lines.rows[j]));
      north = std::max(north, static_cast<double>(lines.rows[j + 1]));
      west = std::min(west, static_cast<double>(lines.cols[i]));
      east = std::max(east, static_cast<double>(lines.cols[i + 1]));
    }
    const auto for_cells = [&](std::size_t k, auto visit) {
      for (std::size_t j = met[k].row; j < met[k].row_end; ++j) {
        for (std::size_t i = met[k].col; i < met[k].col_end; ++i) {
          if (wanted[j * side + i]) visit(j * side + i);
        }
      }
    };
    for (std::size_t k = 0; k < n_triangles; ++k) {
      const TriangleInPosts in(errors.plan_of(errors.triangles_[k]), w);
      if (in.north() < south - 2 || in.south() > north + 2 || in.east() < west - 2 || in.west() > east + 2) {
        met[k] = {};
        continue;
      }
      const auto [row, row_end] = range(lines.rows, in.south(), in.north());
      const auto [col, col_end] = range(lines.cols, in.west(), in.east());
      met[k] = {row, row_end, col, col_end};
      for_cells(k, [&](std::size_t cell) { ++first_[cell + 1]; });
    }
    for (std::size_t cell = 1; cell < first_.size(); ++cell) first_[cell] += first_[cell - 1];
    triangles_.resize(first_.back());
    std::vector<std::size_t> next(first_.begin(), first_.end() - 1);
    for (std::size_t k = 0; k < n_triangles; ++k) {
      for_cells(k, [&](std::size_t cell) { triangles_[next[cell]++] = static_cast<std::uint32_t>(k); });
    }
  }

  std::span<const std::uint32_t> of_cell(std::size_t cell) const {
    return std::span(triangles_).subspan(first_[cell], first_[cell + 1] - first_[cell]);
  }

 private:
  std::vector<std::uint32_t> triangles_;  // by cells
  std::vector<std::size_t> first_;        // per cell, and the end
};

void TileErrors::measure(int n_cell_levels, int threads, const Known* known, TileSurface& surface) const {
  surface.cells.assign(std::size_t{1} << (2 * n_cell_levels), {});
  std::vector<bool> wanted(surface.cells.size(), true);
  if (known != nullptr) {
    wanted = known->is_changed;
    for (std::size_t k = 0; k < wanted.size(); ++k) {
      if (!wanted[k]) surface.cells[k] = known->cells[k];
    }
  }
  for (const PostWindow& w : posts_.windows()) {
    if (!w.is_base_grid) add_window(w, cell_lines(w, n_cell_levels), threads, wanted, surface.cells);
  }
  CellErrors all;
  const auto add = [&all](const CellErrors& cell) {
    all.n_posts += cell.n_posts;
    all.sum_m2 += cell.sum_m2;
    all.largest_m = std::max(all.largest_m, cell.largest_m);
  };
  for (const CellErrors& cell : surface.cells) add(cell);
  if (posts_.n_points() != 0) {
    CellErrors points;
    add_with_fitting_quantum(
        of_points(quantum_), [&](const SquareQuantum& q) { return of_points(q); }, points);
    add(points);
  }
  TileStats& stats = surface.stats;
  stats.n_posts = all.n_posts;
  stats.max_error_m = all.largest_m == 0 ? 0 : std::nextafter(all.largest_m, std::numeric_limits<float>::max());
  const double mean_m2 = all.sum_m2 / static_cast<double>(std::max<std::uint64_t>(all.n_posts, 1));
  stats.rmse_m = std::min(static_cast<float>(std::sqrt(mean_m2)), stats.max_error_m);  // squares were rounded
}

// Adds sums in the tolerance's quantum; errors it is too coarse or too fine for are measured again.
template <class Measure>
void TileErrors::add_with_fitting_quantum(Sums sums, Measure again, CellErrors& to) const {
  SquareQuantum quantum = quantum_;
  if (!quantum.fits(sums.largest_m)) {
    quantum = SquareQuantum::of_scale(sums.largest_m);
    sums = again(quantum);
  }
  to.n_posts += sums.n;
  to.sum_m2 += quantum.sum_m2(sums.n_quanta);
  to.largest_m = std::max(to.largest_m, static_cast<float>(sums.largest_m));
}

TileErrors::CellLines TileErrors::cell_lines(const PostWindow& w, int n_cell_levels) const {
  const std::int64_t n = std::int64_t{1} << n_cell_levels;
  // Posts that lie on a line belong to the cell north or east of it.
  const auto first_from = [&](std::int64_t line, std::int64_t n_posts, const auto& at) {
    const double least = side_ * static_cast<double>(line) / static_cast<double>(n) - posts_.nudge();
    std::int64_t k = line == 0 ? 0 : std::clamp<std::int64_t>(ceil_of((least - at(0)) / (at(1) - at(0))), 0, n_posts);
    while (k > 0 && line > 0 && at(k - 1) >= least) --k;
    while (k < n_posts && line > 0 && at(k) < least) ++k;
    return k;
  };
  CellLines lines;
  for (std::int64_t line = 0; line <= n; ++line) {
    lines.cols.push_back(first_from(line, w.n_cols, [&w](std::int64_t c) { return w.x(c); }));
    lines.rows.push_back(first_from(line, w.n_rows, [&w](std::int64_t r) { return w.y(r); }));
  }
  if (at_pole_) lines.rows.back() = w.n_rows;
  return lines;
}

void TileErrors::add_window(const PostWindow& w, const CellLines& lines, int threads, const std::vector<bool>& wanted,
                            std::vector<CellErrors>& cells) const {
  const std::size_t side = lines.rows.size() - 1;
  const Buckets buckets(*this, w, lines, wanted);
  // Runs of cells' triangles: whole numbers are summed up, so it does not matter who adds what.
  constexpr std::size_t kMostRuns = 64, kLeastInRun = 256;
  const std::size_t in_run = std::max(kLeastInRun, triangles_.size() / kMostRuns);
  struct Part {
    std::size_t k;  // of the cell
    Cell cell;
    std::uint64_t expected;
    Sums found;
  };
  struct Run {
    std::size_t part;
    std::span<const std::uint32_t> triangles;
    Sums sums;
  };
  std::vector<Part> parts;
  std::vector<Run> runs;
  for (std::size_t k = 0; k < cells.size(); ++k) {
    const std::size_t j = k / side, i = k % side;
    if (lines.rows[j] == lines.rows[j + 1]) {
      k += side - 1;
      continue;
    }
    if (!wanted[k] || lines.cols[i] == lines.cols[i + 1]) continue;
    Cell cell{w, {lines.rows[j], lines.cols[i], lines.rows[j + 1] - lines.rows[j], lines.cols[i + 1] - lines.cols[i]}};
    const std::uint64_t expected = posts_.count_source(w, cell.posts);
    if (expected == 0) continue;
    cell.all_source = expected == static_cast<std::uint64_t>(cell.posts.n_posts());
    const std::span<const std::uint32_t> triangles = buckets.of_cell(k);
    for (std::size_t at = 0; at < triangles.size(); at += in_run) {
      runs.push_back({parts.size(), triangles.subspan(at, std::min(in_run, triangles.size() - at)), {}});
    }
    parts.push_back({k, cell, expected, {}});
  }
  constexpr std::int64_t kRunsOfJob = 4;
  const auto n_runs = static_cast<std::int64_t>(runs.size());
  for_each_job({threads, nullptr, {}}, (n_runs + kRunsOfJob - 1) / kRunsOfJob, [&](int, std::int64_t job) {
    const std::int64_t first = job * kRunsOfJob;
    for (std::int64_t k = first; k < std::min(first + kRunsOfJob, n_runs); ++k) {
      Run& run = runs[static_cast<std::size_t>(k)];
      run.sums = of_triangles(parts[run.part].cell, run.triangles, quantum_);
    }
  });
  for (const Run& run : runs) parts[run.part].found.add(run.sums);
  for (const auto& [k, cell, expected, found] : parts) {
    // Where two edges of a sliver cut a row within a rounding of a post, both or none of its neighbours may have it.
    const bool is_whole = found.n == expected;
    const auto again = [&, k = k, &cell = cell](const SquareQuantum& q) {
      return is_whole ? of_triangles(cell, buckets.of_cell(k), q) : one_by_one(cell, q);
    };
    add_with_fitting_quantum(is_whole ? found : again(quantum_), again, cells[k]);
  }
}

PlanTriangle TileErrors::moved_plan_of(const Triangle& t) const {
  // The tile's sides are moved to where its half-open box of posts begins and ends.
  const double nudge = posts_.nudge(), end = side_ - nudge, end_y = at_pole_ ? side_ + 4 * nudge : end;
  const auto moved = [&](double at, double last) { return at == 0 ? -4 * nudge : at == side_ ? last : at; };
  PlanTriangle plan = plan_of(t);
  for (int i = 0; i < 3; ++i) {
    plan.x[i] = moved(plan.x[i], end);
    plan.y[i] = moved(plan.y[i], end_y);
  }
  return plan;
}

TileErrors::Sums TileErrors::of_triangles(const Cell& cell, std::span<const std::uint32_t> triangles,
                                          const SquareQuantum& quantum) const {
  Sums sums;
  for (const std::uint32_t k : triangles) {
    const Triangle& t = triangles_[k];
    const FacePlane plane = plane_of(t);
    OfTriangle(posts_, quantum, cell, moved_plan_of(t), plane).add_to(scanner_, sums);
  }
  return sums;
}

// The slow and sure way: closed triangles, and a mark for each post, by bands of rows.
TileErrors::Sums TileErrors::one_by_one(const Cell& cell, const SquareQuantum& quantum) const {
  constexpr std::int64_t kMostMarks = std::int64_t{1} << 22;
  const PostBlocks::Extent& e = cell.posts;
  const PostWindow& w = cell.window;
  const std::int64_t in_band = std::max<std::int64_t>(1, kMostMarks / std::max<std::int64_t>(1, e.n_cols));
  Sums sums;
  std::vector<std::uint8_t> seen;
  for (std::int64_t row = e.row; row < e.row + e.n_rows; row += in_band) {
    const PostBlocks::Extent band{row, e.col, std::min(in_band, e.row + e.n_rows - row), e.n_cols};
    seen.assign(static_cast<std::size_t>(band.n_posts()), 0);
    for (const Triangle& t : triangles_) {
      const FacePlane plane = plane_of(t);
      const TriangleInPosts in(plan_of(t), w);
      const auto add_row = [&](std::int64_t r, std::int64_t c_first, std::int64_t c_last) {
        const auto part = [&](const float* heights, const PostOrigin* origins, std::int64_t begin, std::int64_t end) {
          for (std::int64_t c = begin; c < end; ++c) {
            std::uint8_t& mark = seen[static_cast<std::size_t>((r - row) * e.n_cols + c - e.col)];
            if (mark != 0 || origins[c - begin] != PostOrigin::kSource) continue;
            mark = 1;
            const double error = std::abs(plane.at(w.x(c), w.y(r)) - static_cast<double>(heights[c - begin]));
            sums.add({error, 1, quantum.square(error)});
          }
        };
        posts_.for_parts(w, r, c_first, c_last + 1, part);
      };
      const Reach nudge{posts_.nudge() / w.dx, posts_.nudge() / w.dy};
      TilePosts::for_rows_in_box(WidenedRows(TriangleRows(in.u, in.v), nudge), w, band, add_row);
    }
  }
  return sums;
}

TileErrors::Sums TileErrors::of_points(const SquareQuantum& quantum) const {
  const double nudge = posts_.nudge(), end = side_ - nudge;
  const double end_y = at_pole_ ? std::numeric_limits<double>::infinity() : end;
  Sums sums;
  std::vector<std::uint8_t> seen(posts_.n_points());
  for (const Triangle& t : triangles_) {
    const FacePlane plane = plane_of(t);
    posts_.for_points(plan_of(t), posts_.nudge(), [&](std::uint32_t k, const TilePoint& p) {
      if (seen[k] != 0 || p.x < -nudge || p.y < -nudge || p.x >= end || p.y >= end_y) return;
      seen[k] = 1;
      const double error = std::abs(plane.at(p.x, p.y) - p.height_m);
      sums.add({error, 1, quantum.square(error)});
    });
  }
  return sums;
}

}  // namespace tind
