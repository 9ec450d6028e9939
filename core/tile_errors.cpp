// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/tile_errors.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/drainage/flow_run.hpp"
#include "core/triangle_blocks.hpp"

namespace tind {

// One triangle over the posts of a window.
class TileErrors::OfTriangle {
 public:
  OfTriangle(const TilePosts& posts, const Measured& m, const PlanTriangle& plan, const FacePlane& plane)
      : posts_(posts),
        m_(m),
        w_(m.window),
        in_(plan, w_),
        rows_(in_.u, in_.v),
        plane_(plane),
        over_(plane_over(plane, w_)) {
    row_first_ = std::max<std::int64_t>(0, ceil_of(rows_.south()));
    row_end_ = std::min(m.n_rows, ceil_of(rows_.north()));
    col_first_ = std::max<std::int64_t>(0, ceil_of(in_.west() - kNoPost));
    col_end_ = std::min(m.n_cols, floor_of(in_.east() + kNoPost) + 1);
  }

  void add_to(const FaceScanner& scanner, Sums& sums) const {
    if (row_first_ >= row_end_ || col_first_ >= col_end_) return;
    if (!posts_.has_blocks() || !in_.is_large()) {
      add_box({0, 0, m_.n_rows, m_.n_cols}, m_.all_source, sums);
      return;
    }
    const PostBlocks& blocks = posts_.blocks();
    const TriangleBlocks walk(blocks, w_.field_row, w_.field_col, in_.u, in_.v, kNoPost);
    // First the largest error, by the most promising blocks; then no block can hold a larger one.
    walk.for_promising(
        sums.largest_m,
        [&](const PostBlock& block, const PostBlocks::Extent& e) { return scanner.plane_bound(plane_, w_, block, e); },
        [&](const BlockInWindow& b) {
          Sums here;
          add_box(b.posts, m_.all_source || is_source(b), here);
          sums.largest_m = greater(here.largest_m, sums.largest_m);
        });
    const auto descend = [&](const BlockInWindow& b, const auto& self) -> void {
      if (is_inside(b) && is_source(b)) {
        const PostBlocks::Extent& e = b.posts;
        const PostPlane own{plane_.at(w_.x(e.col), w_.y(e.row)), over_.per_col, plane_.slope_y * w_.dy};
        sums.sum_m2 += blocks.squared_distance_m2(b.level, b.i, b.j, own);
        sums.n += static_cast<std::uint64_t>(e.n_posts());
      } else if (b.level > 0) {
        walk.for_children(b, [&](const BlockInWindow& child) { self(child, self); });
      } else {
        add_box(b.posts, m_.all_source || is_source(b), sums);
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
    const auto strip = [&](const PostStrip& s) { sums.add(errors_in_strip(s, rows_, over_)); };
    if (all_source && posts_.for_strips(w_, {r_first, c_first, r_end - r_first, c_end - c_first}, strip)) return;
    for (std::int64_t r = r_first; r < r_end; ++r) {
      const auto [west, east] = rows_.cuts(static_cast<double>(r));
      const std::int64_t first = std::max(c_first, ceil_of(west)), end = std::min(c_end, ceil_of(east));
      const double z = plane_.at(w_.x0, w_.y(r));
      if (first >= end) continue;
      const auto part = [&](const float* heights, const PostOrigin* origins, std::int64_t c_begin,
                            std::int64_t c_stop) {
        double col = static_cast<double>(c_begin);
        for (std::int64_t k = 0; k < c_stop - c_begin; ++k, ++col) {
          if (all_source || origins[k] == PostOrigin::kSource) {
            sums.add(std::abs(z + over_.per_col * col - static_cast<double>(heights[k])));
          }
        }
      };
      posts_.for_parts(w_, r, first, end, part);
    }
  }

  const TilePosts& posts_;
  const Measured& m_;
  const PostWindow& w_;
  const TriangleInPosts in_;
  const TriangleRows rows_;
  const FacePlane& plane_;
  const PlaneOverPosts over_;
  std::int64_t row_first_ = 0, row_end_ = 0, col_first_ = 0, col_end_ = 0;
};

void TileErrors::measure(int threads, TileStats& stats) const {
  Sums sums;
  for (const PostWindow& w : posts_.windows()) {
    if (!w.is_base_grid) sums.add(of_window(w, threads));
  }
  if (posts_.n_points() != 0) sums.add(of_points());
  stats.n_posts = sums.n;
  stats.max_error_m = std::nextafter(static_cast<float>(sums.largest_m), std::numeric_limits<float>::max());
  if (sums.largest_m == 0) stats.max_error_m = 0;
  stats.rmse_m = sums.n ? static_cast<float>(std::sqrt(sums.sum_m2 / static_cast<double>(sums.n))) : 0;
}

TileErrors::Sums TileErrors::of_window(const PostWindow& w, int threads) const {
  Measured m{w, w.n_rows, w.n_cols};
  const double end = side_ - posts_.nudge();
  while (m.n_cols > 0 && w.x(m.n_cols - 1) >= end) --m.n_cols;
  while (!at_pole_ && m.n_rows > 0 && w.y(m.n_rows - 1) >= end) --m.n_rows;
  const std::uint64_t expected = posts_.count_source(w, m.n_rows, m.n_cols);
  m.all_source = expected == static_cast<std::uint64_t>(m.n_cols * m.n_rows);
  // Runs of triangles by their number alone: what the threads add up does not depend on how many they are.
  constexpr std::size_t kMostRuns = 64, kLeastInRun = 256;
  const std::size_t in_run = std::max(kLeastInRun, triangles_.size() / kMostRuns);
  std::vector<Sums> runs((triangles_.size() + in_run - 1) / in_run);
  for_each_job({threads, nullptr, {}}, static_cast<std::int64_t>(runs.size()), [&](int, std::int64_t job) {
    const auto k = static_cast<std::size_t>(job), begin = k * in_run;
    runs[k] = of_triangles(m, triangles_.subspan(begin, std::min(in_run, triangles_.size() - begin)));
  });
  Sums found;
  for (const Sums& run : runs) found.add(run);
  // Where two edges of a sliver cut a row within a rounding of a post, both or none of its neighbours may have it.
  return found.n == expected ? found : one_by_one(m);
}

TileErrors::Sums TileErrors::of_triangles(const Measured& m, std::span<const Triangle> triangles) const {
  // The tile's sides are moved to where its half-open box of posts begins and ends.
  const double nudge = posts_.nudge(), end = side_ - nudge, end_y = at_pole_ ? side_ + 4 * nudge : end;
  const auto moved = [&](double at, double last) { return at == 0 ? -4 * nudge : at == side_ ? last : at; };
  Sums sums;
  for (const Triangle& t : triangles) {
    PlanTriangle plan = plan_of(t);
    for (int i = 0; i < 3; ++i) {
      plan.x[i] = moved(plan.x[i], end);
      plan.y[i] = moved(plan.y[i], end_y);
    }
    const FacePlane plane = plane_of(t);
    OfTriangle(posts_, m, plan, plane).add_to(scanner_, sums);
  }
  return sums;
}

// The slow and sure way: closed triangles, and a mark for each post, by bands of rows.
TileErrors::Sums TileErrors::one_by_one(const Measured& m) const {
  constexpr std::int64_t kMostMarks = std::int64_t{1} << 22;
  const std::int64_t in_band = std::max<std::int64_t>(1, kMostMarks / std::max<std::int64_t>(1, m.n_cols));
  Sums sums;
  std::vector<std::uint8_t> seen;
  for (std::int64_t row = 0; row < m.n_rows; row += in_band) {
    const PostBlocks::Extent band{row, 0, std::min(in_band, m.n_rows - row), m.n_cols};
    seen.assign(static_cast<std::size_t>(band.n_posts()), 0);
    for (const Triangle& t : triangles_) {
      const FacePlane plane = plane_of(t);
      const TriangleInPosts in(plan_of(t), m.window);
      const auto add_row = [&](std::int64_t r, std::int64_t c_first, std::int64_t c_last) {
        const auto part = [&](const float* heights, const PostOrigin* origins, std::int64_t begin, std::int64_t end) {
          for (std::int64_t c = begin; c < end; ++c) {
            std::uint8_t& mark = seen[static_cast<std::size_t>((r - row) * m.n_cols + c)];
            if (mark != 0 || origins[c - begin] != PostOrigin::kSource) continue;
            mark = 1;
            const double height = static_cast<double>(heights[c - begin]);
            sums.add(std::abs(plane.at(m.window.x(c), m.window.y(r)) - height));
          }
        };
        posts_.for_parts(m.window, r, c_first, c_last + 1, part);
      };
      const Reach nudge{posts_.nudge() / m.window.dx, posts_.nudge() / m.window.dy};
      TilePosts::for_rows_in_box(WidenedRows(TriangleRows(in.u, in.v), nudge), m.window, band, add_row);
    }
  }
  return sums;
}

TileErrors::Sums TileErrors::of_points() const {
  const double nudge = posts_.nudge(), end = side_ - nudge;
  const double end_y = at_pole_ ? std::numeric_limits<double>::infinity() : end;
  Sums sums;
  std::vector<std::uint8_t> seen(posts_.n_points());
  for (const Triangle& t : triangles_) {
    const FacePlane plane = plane_of(t);
    posts_.for_points(plan_of(t), posts_.nudge(), [&](std::uint32_t k, const TilePoint& p) {
      if (seen[k] != 0 || p.x < -nudge || p.y < -nudge || p.x >= end || p.y >= end_y) return;
      seen[k] = 1;
      sums.add(std::abs(plane.at(p.x, p.y) - p.height_m));
    });
  }
  return sums;
}

}  // namespace tind
