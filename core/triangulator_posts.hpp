// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "core/height_field.hpp"
#include "core/mesh.hpp"
#include "core/post_blocks.hpp"
#include "core/post_strip.hpp"
#include "core/post_subset.hpp"
#include "core/tile_key.hpp"
#include "core/triangle_blocks.hpp"
#include "core/triangle_rows.hpp"
#include "core/virtual_node.hpp"

namespace tind {

/// A regular grid of posts over a tile, in local lattice steps.
struct PostWindow {
  double x0 = 0, y0 = 0, dx = 1, dy = 1;  ///< Position of post (0, 0) of the window and spacing.
  double per_dx = 1, per_dy = 1;          ///< 1 / dx, 1 / dy.
  Reach reach;                            ///< TilePosts::reach() in post spacings.
  std::int64_t n_cols = 0, n_rows = 0;
  std::int64_t field_col = 0, field_row = 0;  ///< Of the window's post (0, 0).
  bool is_base_grid = false;     ///< The level's own 256 x 256 grid at the base height, where the field covers nothing.
  bool all_promised = true;      ///< No post is interpolated between irregular ones.
  std::int64_t first_index = 0;  ///< Post (r, c) has the index first_index + r * n_cols + c among the tile's posts.
  /// Post (r, c) is at r * stride + c; null: the posts are in the field's pages.
  const float* heights_m = nullptr;
  const PostOrigin* origins = nullptr;
  std::int64_t stride = 0;
  std::int64_t n_readable = 0;  ///< So many columns from 0 on lie in memory, some beyond the window's last.

  double x(std::int64_t c) const { return x0 + static_cast<double>(c) * dx; }
  double y(std::int64_t r) const { return y0 + static_cast<double>(r) * dy; }
};

/// Far below a post's spacing, far above what rounding in doubles moves a triangle's edge by.
constexpr double kNoPost = 1e-6;

/// A triangle in the posts of a window: column and row of its corners.
struct TriangleInPosts {
  double u[3], v[3];

  double west() const { return lesser(lesser(u[0], u[1]), u[2]); }
  double east() const { return greater(greater(u[0], u[1]), u[2]); }
  double south() const { return lesser(lesser(v[0], v[1]), v[2]); }
  double north() const { return greater(greater(v[0], v[1]), v[2]); }
  /// Whether blocks of posts pay.
  bool is_large() const {
    constexpr double kLarge = 24;
    return east() - west() >= kLarge && north() - south() >= kLarge;
  }

  TriangleInPosts(const PlanTriangle& t, const PostWindow& w) {
    for (int i = 0; i < 3; ++i) {
      u[i] = (t.x[i] - w.x0) * w.per_dx;
      v[i] = (t.y[i] - w.y0) * w.per_dy;
    }
  }
};

/// A part of a tile, local lattice steps.
struct PlanBox {
  double west = 0, south = 0, east = 0, north = 0;
};

/// An irregular post of a tile, local lattice steps.
struct TilePoint {
  double x = 0, y = 0, height_m = 0;
};

/// All posts that a tile answers for, each with an index: windows of the field's grid (the field may reach the tile
/// twice, across longitude 180), the base grid, irregular posts. Storage is kept from tile to tile. The field must
/// outlive it.
class TilePosts {
 public:
  /// `is_served_far`: some vertex that is there from the start is, a post that may become one or not. `few`: few posts
  /// will be looked at.
  void reset(const HeightField& field, const TileKey& key, bool is_served_far, bool few);

  const std::vector<PostWindow>& windows() const { return windows_; }
  std::size_t n_points() const { return points_.size(); }
  /// Degrees carry about 1e-13 of rounding: a post this close to a tile's side, in lattice steps, lies on it.
  double nudge() const { return nudge_; }
  /// So far from a triangle on either axis, in lattice steps, posts are held against it: so far quantized-mesh moves
  /// corners (half a step of its own, a whole one where that would put them on the tile's side), and a post beside an
  /// edge comes to lie on the other side. docs/decisions/0003.
  double reach() const { return reach_; }

  /// Calls part(heights, origins, c_begin, c_end) for the posts [c_begin, c_end) of a row, from west to east in parts
  /// that lie together: heights[k] is column c_begin + k of the window. Both are valid until the call returns.
  template <class Part>
  void for_parts(const PostWindow& w, std::int64_t r, std::int64_t c_begin, std::int64_t c_end, Part part) const;
  /// Position of a post in local lattice steps.
  std::pair<double, double> position(std::int64_t index) const;
  /// Asks for the grid's posts around one of its posts, which are needed soon.
  void prefetch_around(std::int64_t index) const {
    constexpr std::int64_t kReach = 4;
    if (index >= first_point_) return;
    const PostWindow& w = window_of(index);
    if (w.heights_m == nullptr) return;
    const std::int64_t at = index - w.first_index, r = at / w.n_cols, c = at - r * w.n_cols;
    const std::int64_t r_end = std::min(r + kReach + 1, w.n_rows);
    for (std::int64_t row = std::max<std::int64_t>(r - kReach, 0); row < r_end; ++row) {
      __builtin_prefetch(w.heights_m + row * w.stride + c);
    }
  }
  std::int64_t index_of_point(std::uint32_t k) const { return first_point_ + k; }

  bool has_blocks() const { return field_->blocks != nullptr; }
  const PostBlocks& blocks() const { return *field_->blocks; }

  /// Whether the base grid has nothing to say in a triangle: the field covers it, by the box around it.
  bool is_covered(const PlanTriangle& t) const;
  /// Same for a point.
  bool is_covered(double x, double y) const {
    return field_->covers(x + static_cast<double>(west_), y + static_cast<double>(south_));
  }

  /// Number of the source's own posts in a part of a window.
  std::uint64_t count_source(const PostWindow& w, const PostBlocks::Extent& part) const;

  /// The posts of grids that round to vertices.
  struct OfVertices {
    struct Post {
      std::size_t window;
      PostSubset::Post post;
    };
    std::vector<Post> posts;       ///< In the vertices' order.
    std::vector<float> heights_m;  ///< Of those of the field's own grid.
  };
  void find_posts_of(std::span<const LocalVertex> vertices, OfVertices& found) const;

  /// From now on promising boxes have no other posts than these and those of the closed `boxes`, one post wider all
  /// around; height_range and what is counted stays as it is. False, and nothing is done, where that leaves out too
  /// few.
  bool restrict_to(const OfVertices& vertices, std::span<const PlanBox> boxes);
  /// Until here, or until reset.
  void lift_restriction() { is_restricted_ = false; }
  bool is_restricted() const { return is_restricted_; }
  /// The vertex of restrict_to that a post rounds to; nullopt: there is none.
  std::optional<std::uint32_t> vertex_of(std::int64_t index) const {
    const PostWindow& w = window_of(index);
    const std::int64_t at = index - w.first_index, r = at / w.n_cols;
    const PostSubset::Post* const post =
        some_[static_cast<std::size_t>(&w - windows_.data())].find(r, at - r * w.n_cols);
    return post == nullptr ? std::nullopt : std::optional(post->vertex);
  }

  /// Lowest and highest of all posts, metres; low > high when there is none.
  std::pair<double, double> height_range() const;

  /// Calls box(extent) for boxes of columns and rows of a window that have all posts within reach of a triangle between
  /// them. Large triangles leave out the blocks of posts of which bound(block, extent) says less than `worst`, which
  /// `box` may raise; the most promising blocks come first. `rows`: of the same triangle, widened by the window's
  /// reach. Of restricted posts the single ones within reach, and promising(r, c, height_m), come as
  /// single(r, c, height_m) instead.
  template <class Bound, class Visit, class Promising, class Single>
  void for_promising_boxes(const TriangleInPosts& t, const WidenedRows& rows, const PostWindow& w, const double& worst,
                           Bound bound, Visit box, Promising promising, Single single) const;
  /// Calls row(r, c_first, c_last) for the posts of a window within reach of a triangle, those of a box.
  template <class Row>
  static void for_rows_in_box(const WidenedRows& rows, const PostWindow& w, const PostBlocks::Extent& e, Row row);
  /// Cuts a box into strips and calls strip(PostStrip) for each, west to east; false, and nothing is called, where it
  /// is too wide for that to pay, or the grid too narrow to be read by strips.
  template <class Strip>
  bool for_strips(const PostWindow& w, const PostBlocks::Extent& e, Strip strip) const;

  /// Calls visit(k, point) for the irregular posts in a triangle and those within `reach` lattice steps of it.
  template <class Visit>
  void for_points(const PlanTriangle& t, double reach, Visit visit) const {
    if (!points_.empty()) visit_points(t, reach, visit);
  }

 private:
  // Of a post of a grid.
  const PostWindow& window_of(std::int64_t index) const {
    const PostWindow* w = &windows_.back();
    while (index < w->first_index) --w;
    return *w;
  }
  // Rows [first, end) of a box that a triangle may have posts in.
  static std::pair<std::int64_t, std::int64_t> rows_in_box(const WidenedRows& rows, const PostWindow& w,
                                                           const PostBlocks::Extent& e) {
    return {std::max({std::int64_t{0}, e.row, ceil_of(rows.south())}),
            std::min({w.n_rows, e.row + e.n_rows, floor_of(rows.north()) + 1})};
  }
  void find_windows();
  bool has_post_served_far() const;
  void find_posts(bool few);
  void find_covered_boxes();
  void collect_points();
  template <class Settle, class Row>
  void for_posts(const PostWindow& w, const PostBlocks::Extent& part, Settle settle, Row row) const;
  template <class Visit>
  void visit_points(const PlanTriangle& t, double reach, Visit visit) const;
  std::int64_t cell_col(double x) const {
    return std::clamp<std::int64_t>(floor_of((x - cells_x0_) / cell_size_), 0, n_cell_cols_ - 1);
  }
  std::int64_t cell_row(double y) const {
    return std::clamp<std::int64_t>(floor_of((y - cells_y0_) / cell_size_), 0, n_cell_rows_ - 1);
  }

  const HeightField* field_ = nullptr;
  std::int64_t side_ = 0, west_ = 0, south_ = 0;
  double nudge_ = 0, reach_ = 0;
  std::vector<PostWindow> windows_;
  std::vector<PlanBox> covered_;
  bool is_restricted_ = false;
  std::vector<PostSubset> some_;  // per window
  std::int64_t first_point_ = 0;
  // Irregular posts by cells of a regular grid around them.
  double cells_x0_ = 0, cells_y0_ = 0, cell_size_ = 1;
  std::int64_t n_cell_cols_ = 0, n_cell_rows_ = 0;
  std::vector<std::uint32_t> cell_first_, cell_next_;  // n_cell_rows * n_cell_cols + 1
  std::vector<TilePoint> points_, found_;
  // Posts of small windows, copied from the field's pages.
  std::vector<float> copied_heights_m_;
  std::vector<PostOrigin> copied_origins_;
};

template <class Part>
void TilePosts::for_parts(const PostWindow& w, std::int64_t r, std::int64_t c_begin, std::int64_t c_end,
                          Part part) const {
  if (w.heights_m != nullptr) {
    const std::int64_t at = r * w.stride + c_begin;
    part(w.heights_m + at, w.origins + at, c_begin, c_end);
    return;
  }
  const std::int64_t row = w.field_row + r;
  while (c_begin < c_end) {
    const std::int64_t col = w.field_col + c_begin;
    const std::int64_t end = std::min(c_end, c_begin + PostPages::kSide - col % PostPages::kSide);
    const PostPage& page = field_->pages->of_post(row, col);
    const std::size_t at = PostPages::index(row, col);
    part(page.heights_m + at, page.origins + at, c_begin, end);
    c_begin = end;
  }
}

template <class Row>
void TilePosts::for_rows_in_box(const WidenedRows& rows, const PostWindow& w, const PostBlocks::Extent& e, Row row) {
  const auto [r_first, r_end] = rows_in_box(rows, w, e);
  for (std::int64_t r = r_first; r < r_end; ++r) {
    const auto [west, east] = rows.cuts(static_cast<double>(r));
    const auto c_first = std::max({std::int64_t{0}, e.col, ceil_of(west)});
    const auto c_last = std::min({w.n_cols, e.col + e.n_cols, floor_of(east) + 1}) - 1;
    if (c_first <= c_last) row(r, c_first, c_last);
  }
}

template <class Strip>
bool TilePosts::for_strips(const PostWindow& w, const PostBlocks::Extent& e, Strip strip) const {
  constexpr std::int64_t kMostStrips = 3;
  if (e.n_cols > kMostStrips * PostStrip::kColumns) return false;
  PostStrip s;
  const std::int64_t col_end = e.col + e.n_cols, row_end = e.row + e.n_rows;
  if (w.heights_m != nullptr) {
    if (w.n_readable < PostStrip::kColumns) return false;
    s.row = e.row;
    s.n_rows = e.n_rows;
    s.stride = w.stride;
    for (s.col = e.col; s.col < col_end; s.col += PostStrip::kColumns) {
      s.n_cols = std::min(PostStrip::kColumns, col_end - s.col);
      s.first_read = std::min(s.col, w.n_readable - PostStrip::kColumns);
      s.heights = w.heights_m + s.row * s.stride + s.first_read;
      strip(s);
    }
    return true;
  }
  // No strip leaves its page.
  s.stride = PostPages::kSide;
  for (s.row = e.row; s.row < row_end; s.row += s.n_rows) {
    const std::int64_t field_row = w.field_row + s.row;
    s.n_rows = std::min(row_end - s.row, PostPages::kSide - field_row % PostPages::kSide);
    for (s.col = e.col; s.col < col_end; s.col += s.n_cols) {
      const std::int64_t from_read = (w.field_col + s.col) % PostStrip::kColumns;
      s.first_read = s.col - from_read;
      s.n_cols = std::min(PostStrip::kColumns - from_read, col_end - s.col);
      const std::int64_t field_col = w.field_col + s.first_read;
      s.heights = field_->pages->of_post(field_row, field_col).heights_m + PostPages::index(field_row, field_col);
      strip(s);
    }
  }
  return true;
}

template <class Bound, class Visit, class Promising, class Single>
void TilePosts::for_promising_boxes(const TriangleInPosts& t, const WidenedRows& rows, const PostWindow& w,
                                    const double& worst, Bound bound, Visit box, Promising promising,
                                    Single single) const {
  // The posts that the triangle may have in a part of the window.
  const auto visit_box = [&](const PostBlocks::Extent& e) {
    const auto [r_first, r_end] = rows_in_box(rows, w, e);
    const auto c_first = std::max({std::int64_t{0}, e.col, ceil_of(rows.west())});
    const auto c_end = std::min({w.n_cols, e.col + e.n_cols, floor_of(rows.east()) + 1});
    if (r_first < r_end && c_first < c_end) box({r_first, c_first, r_end - r_first, c_end - c_first});
  };
  if (is_restricted_) {
    const std::int64_t r0 = std::max<std::int64_t>(0, ceil_of(rows.south()));
    const std::int64_t c0 = std::max<std::int64_t>(0, ceil_of(rows.west()));
    some_[static_cast<std::size_t>(&w - windows_.data())].visit(
        {r0, c0, floor_of(rows.north()) + 1 - r0, floor_of(rows.east()) + 1 - c0},
        [&rows](double first, double last) { return rows.cuts_between(first, last); }, visit_box,
        [&](const PostSubset::Post& p) {
          if (!promising(p.row, p.col, p.height_m)) return;
          const auto [west, east] = rows.cuts(static_cast<double>(p.row));
          if (p.col >= ceil_of(west) && p.col <= floor_of(east)) single(p.row, p.col, p.height_m);
        });
    return;
  }
  if (w.is_base_grid || !has_blocks() || !t.is_large()) {
    visit_box({0, 0, w.n_rows, w.n_cols});
    return;
  }
  const double slack = greater(w.reach.cols, w.reach.rows) + kNoPost;
  const TriangleBlocks walk(*field_->blocks, w.field_row, w.field_col, t.u, t.v, slack);
  walk.for_promising(worst, bound, [&](const BlockInWindow& b) { visit_box(b.posts); });
}

template <class Visit>
void TilePosts::visit_points(const PlanTriangle& t, double reach, Visit visit) const {
  const double south = std::min({t.y[0], t.y[1], t.y[2]}), north = std::max({t.y[0], t.y[1], t.y[2]});
  const double west = std::min({t.x[0], t.x[1], t.x[2]}), east = std::max({t.x[0], t.x[1], t.x[2]});
  const double end_x = cells_x0_ + cell_size_ * static_cast<double>(n_cell_cols_);
  const double end_y = cells_y0_ + cell_size_ * static_cast<double>(n_cell_rows_);
  if (east + reach < cells_x0_ || west - reach > end_x || north + reach < cells_y0_ || south - reach > end_y) {
    return;
  }
  double slack[3];
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3;
    const double ex = t.x[j] - t.x[i], ey = t.y[j] - t.y[i];
    slack[i] = -reach * (std::abs(ex) + std::abs(ey));
  }
  for (std::int64_t r = cell_row(south - reach); r <= cell_row(north + reach); ++r) {
    // Where the triangle lies in this row of cells.
    const double low = cells_y0_ + cell_size_ * static_cast<double>(r) - reach;
    const double high = low + cell_size_ + 2 * reach;
    double left = east, right = west;
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3;
      const double yi = t.y[i], yj = t.y[j], xi = t.x[i], xj = t.x[j], lower = std::min(yi, yj),
                   upper = std::max(yi, yj);
      if (upper < low || lower > high) continue;
      for (const double at : {std::clamp(low, lower, upper), std::clamp(high, lower, upper)}) {
        const double share = yi == yj ? 0 : (at - yi) / (yj - yi), cut = xi + share * (xj - xi);
        left = std::min({left, cut, yi == yj ? xj : cut});
        right = std::max({right, cut, yi == yj ? xj : cut});
      }
    }
    if (left > right) continue;
    for (std::int64_t c = cell_col(left - reach); c <= cell_col(right + reach); ++c) {
      const auto cell = static_cast<std::size_t>(r * n_cell_cols_ + c);
      for (std::uint32_t k = cell_first_[cell]; k < cell_first_[cell + 1]; ++k) {
        const TilePoint& p = points_[k];
        bool inside = true;
        for (int i = 0; i < 3 && inside; ++i) {
          const int j = (i + 1) % 3;
          inside = (t.x[j] - t.x[i]) * (p.y - t.y[i]) - (t.y[j] - t.y[i]) * (p.x - t.x[i]) >= slack[i];
        }
        if (inside) visit(k, p);
      }
    }
  }
}

}  // namespace tind
