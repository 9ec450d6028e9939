// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "core/height_field.hpp"
#include "core/mesh.hpp"
#include "core/tile_key.hpp"

namespace tind {

/// floor and ceil of numbers below 2^63 in magnitude, without a call into libm.
inline std::int64_t floor_of(double v) {
  const auto whole = static_cast<std::int64_t>(v);
  return whole - (static_cast<double>(whole) > v ? 1 : 0);
}
inline std::int64_t ceil_of(double v) {
  const auto whole = static_cast<std::int64_t>(v);
  return whole + (static_cast<double>(whole) < v ? 1 : 0);
}

/// A regular grid of posts over a tile, in local lattice steps.
struct PostWindow {
  double x0 = 0, y0 = 0, dx = 1, dy = 1;  ///< Position of post (0, 0) of the window and spacing.
  double slack_x = 0, slack_y = 0;        ///< What counts as nothing, in post spacings.
  std::int64_t n_cols = 0, n_rows = 0;
  std::int64_t field_col = 0, field_row = 0;  ///< Of the window's post (0, 0).
  bool is_base_grid = false;     ///< The level's own 256 x 256 grid at the base height, where the field covers nothing.
  bool all_promised = true;      ///< No post is interpolated between irregular ones.
  std::int64_t first_index = 0;  ///< Post (r, c) has the index first_index + r * n_cols + c among the tile's posts.

  double x(std::int64_t c) const { return x0 + static_cast<double>(c) * dx; }
  double y(std::int64_t r) const { return y0 + static_cast<double>(r) * dy; }
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
  void reset(const HeightField& field, const TileKey& key);

  const std::vector<PostWindow>& windows() const { return windows_; }
  std::size_t n_points() const { return points_.size(); }
  /// Degrees carry about 1e-13 of rounding: a post this close to a tile's side, in lattice steps, lies on it.
  double nudge() const { return nudge_; }

  const float* row_heights(const PostWindow& w, std::int64_t r) const {
    return field_->heights_m + (w.field_row + r) * field_->n_cols + w.field_col;
  }
  const PostOrigin* row_origins(const PostWindow& w, std::int64_t r) const {
    return field_->origins + (w.field_row + r) * field_->n_cols + w.field_col;
  }
  /// Position of a post in local lattice steps.
  std::pair<double, double> position(std::int64_t index) const;
  std::int64_t index_of_point(std::uint32_t k) const { return first_point_ + k; }

  /// Whether the base grid has nothing to say in a triangle: the field covers it, by the box around it.
  bool is_covered(const PlanTriangle& t) const;
  /// Same for a point.
  bool is_covered(double x, double y) const {
    return field_->covers(x + static_cast<double>(west_), y + static_cast<double>(south_));
  }

  /// Lowest and highest of all posts, metres; low > high when there is none.
  std::pair<double, double> height_range() const;

  /// Calls row(r, c_first, c_last) for the posts of a window in a triangle, borders included: posts outside by a
  /// rounding are visited with it, so that none falls between two.
  template <class Row>
  static void for_rows(const PlanTriangle& t, const PostWindow& w, Row row);

  /// Calls visit(k, point) for the irregular posts in a triangle, borders included as above.
  template <class Visit>
  void for_points(const PlanTriangle& t, Visit visit) const {
    if (!points_.empty()) visit_points(t, visit);
  }

 private:
  struct Box {
    double west, south, east, north;
  };

  void find_windows();
  void find_covered_boxes();
  void collect_points();
  template <class Visit>
  void visit_points(const PlanTriangle& t, Visit visit) const;
  std::int64_t cell_col(double x) const {
    return std::clamp<std::int64_t>(floor_of((x - cells_x0_) / cell_size_), 0, n_cell_cols_ - 1);
  }
  std::int64_t cell_row(double y) const {
    return std::clamp<std::int64_t>(floor_of((y - cells_y0_) / cell_size_), 0, n_cell_rows_ - 1);
  }

  const HeightField* field_ = nullptr;
  std::int64_t side_ = 0, west_ = 0, south_ = 0;
  double nudge_ = 0;
  std::vector<PostWindow> windows_;
  std::vector<Box> covered_;
  std::int64_t first_point_ = 0;
  // Irregular posts by cells of a regular grid around them.
  double cells_x0_ = 0, cells_y0_ = 0, cell_size_ = 1;
  std::int64_t n_cell_cols_ = 0, n_cell_rows_ = 0;
  std::vector<std::uint32_t> cell_first_, cell_next_;  // n_cell_rows * n_cell_cols + 1
  std::vector<TilePoint> points_, found_;
};

template <class Row>
void TilePosts::for_rows(const PlanTriangle& t, const PostWindow& w, Row row) {
  // Corners by their row: 0 lowest.
  const double to_col = 1 / w.dx, to_row = 1 / w.dy;
  double x0 = (t.x[0] - w.x0) * to_col, x1 = (t.x[1] - w.x0) * to_col, x2 = (t.x[2] - w.x0) * to_col;
  double y0 = (t.y[0] - w.y0) * to_row, y1 = (t.y[1] - w.y0) * to_row, y2 = (t.y[2] - w.y0) * to_row;
  const auto order = [](double& xa, double& ya, double& xb, double& yb) {
    if (ya > yb) {
      std::swap(xa, xb);
      std::swap(ya, yb);
    }
  };
  order(x0, y0, x1, y1);
  order(x1, y1, x2, y2);
  order(x0, y0, x1, y1);
  const auto r_first = std::max<std::int64_t>(0, ceil_of(y0 - w.slack_y));
  const auto r_last = std::min<std::int64_t>(w.n_rows - 1, floor_of(y2 + w.slack_y));
  if (r_first > r_last) return;
  const double long_slope = (x2 - x0) / (y2 - y0);
  const double low_slope = y1 > y0 ? (x1 - x0) / (y1 - y0) : 0;
  const double high_slope = y2 > y1 ? (x2 - x1) / (y2 - y1) : 0;
  for (std::int64_t r = r_first; r <= r_last; ++r) {
    const double at = std::min(std::max(static_cast<double>(r), y0), y2);
    const double x_long = x0 + long_slope * (at - y0);
    double x_short = x1;
    if (at < y1) {
      x_short = x0 + low_slope * (at - y0);
    } else if (y2 > y1) {
      x_short = x1 + high_slope * (at - y1);
    }
    const auto c_first = std::max<std::int64_t>(0, ceil_of(std::min(x_long, x_short) - w.slack_x));
    const auto c_last = std::min<std::int64_t>(w.n_cols - 1, floor_of(std::max(x_long, x_short) + w.slack_x));
    if (c_first <= c_last) row(r, c_first, c_last);
  }
}

template <class Visit>
void TilePosts::visit_points(const PlanTriangle& t, Visit visit) const {
  const double south = std::min({t.y[0], t.y[1], t.y[2]}), north = std::max({t.y[0], t.y[1], t.y[2]});
  const double west = std::min({t.x[0], t.x[1], t.x[2]}), east = std::max({t.x[0], t.x[1], t.x[2]});
  const double end_x = cells_x0_ + cell_size_ * static_cast<double>(n_cell_cols_);
  const double end_y = cells_y0_ + cell_size_ * static_cast<double>(n_cell_rows_);
  if (east + nudge_ < cells_x0_ || west - nudge_ > end_x || north + nudge_ < cells_y0_ || south - nudge_ > end_y) {
    return;
  }
  double slack[3];
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3;
    const double ex = t.x[j] - t.x[i], ey = t.y[j] - t.y[i];
    slack[i] = -nudge_ * std::sqrt(ex * ex + ey * ey);
  }
  for (std::int64_t r = cell_row(south - nudge_); r <= cell_row(north + nudge_); ++r) {
    // Where the triangle lies in this row of cells.
    const double low = cells_y0_ + cell_size_ * static_cast<double>(r) - nudge_;
    const double high = low + cell_size_ + 2 * nudge_;
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
    for (std::int64_t c = cell_col(left - nudge_); c <= cell_col(right + nudge_); ++c) {
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
