// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/triangulator_posts.hpp"

#include <cmath>
#include <limits>

#include "core/format/quantized_mesh.hpp"
#include "core/level_spec.hpp"

namespace tind {

void TilePosts::reset(const HeightField& field, const TileKey& key, bool is_served_far, bool few) {
  field_ = &field;
  side_ = field.lattice.tile_side(key.level);
  west_ = side_ * key.x;
  south_ = side_ * key.y;
  nudge_ = 1e-5 + 1e-13 * static_cast<double>(field.lattice.width());
  windows_.clear();
  covered_.clear();
  points_.clear();
  is_restricted_ = false;
  find_windows();
  find_posts(few);
  if (!field.points.empty()) collect_points();
  const double served_step = static_cast<double>(side_) / kQuantizedSteps;
  reach_ = (is_served_far || has_post_served_far() ? served_step : served_step / 2) + nudge_;
  std::int64_t n = 0;
  for (PostWindow& w : windows_) {
    w.reach = {reach_ / w.dx, reach_ / w.dy};
    w.first_index = n;
    n += w.n_cols * w.n_rows;
    if (w.is_base_grid || field.points.empty()) continue;
    for (std::int64_t r = 0; r < w.n_rows && w.all_promised; ++r) {
      for_parts(w, r, 0, w.n_cols,
                [&](const float*, const PostOrigin* origins, std::int64_t c_begin, std::int64_t c_end) {
                  const PostOrigin* const end = origins + (c_end - c_begin);
                  if (std::find(origins, end, PostOrigin::kInterpolated) != end) w.all_promised = false;
                });
    }
  }
  first_point_ = n;
}

// Whether a post may become a vertex that quantized-mesh moves further than half a step.
bool TilePosts::has_post_served_far() const {
  const double side = static_cast<double>(side_);
  // Posts become vertices at the lattice point nearest to them.
  const auto is_far = [side](double at) { return is_served_far(static_cast<double>(floor_of(at + 0.5)), side); };
  const auto any = [&](double first, double step, std::int64_t n) {
    bool far = false;
    // From both ends, as far as a step of quantized-mesh reaches.
    for (std::int64_t k = 0; k < n && first + static_cast<double>(k) * step < side / kQuantizedSteps; ++k) {
      far = far || is_far(first + static_cast<double>(k) * step);
    }
    for (std::int64_t k = n - 1; k >= 0 && side - first - static_cast<double>(k) * step < side / kQuantizedSteps; --k) {
      far = far || is_far(first + static_cast<double>(k) * step);
    }
    return far;
  };
  return std::any_of(windows_.begin(), windows_.end(),
                     [&](const PostWindow& w) { return any(w.x0, w.dx, w.n_cols) || any(w.y0, w.dy, w.n_rows); }) ||
         std::any_of(points_.begin(), points_.end(), [&](const TilePoint& p) { return is_far(p.x) || is_far(p.y); });
}

void TilePosts::find_windows() {
  const HeightField& field = *field_;
  const double width = static_cast<double>(field.lattice.width()), side = static_cast<double>(side_);
  for (const double turn : {-width, 0.0, width}) {
    PostWindow w;
    w.dx = field.dx;
    w.dy = field.dy;
    w.per_dx = 1 / w.dx;
    w.per_dy = 1 / w.dy;
    const double x0 = field.x0 + turn - static_cast<double>(west_), y0 = field.y0 - static_cast<double>(south_);
    const auto first = [this](double origin, double step) {
      return std::max<std::int64_t>(0, ceil_of((-origin - nudge_) / step));
    };
    const auto last = [this, side](double origin, double step, std::int64_t n) {
      return std::min<std::int64_t>(n - 1, floor_of((side - origin + nudge_) / step));
    };
    w.field_col = first(x0, w.dx);
    w.field_row = first(y0, w.dy);
    w.n_cols = last(x0, w.dx, field.n_cols) - w.field_col + 1;
    w.n_rows = last(y0, w.dy, field.n_rows) - w.field_row + 1;
    if (w.n_cols <= 0 || w.n_rows <= 0) continue;
    w.x0 = x0 + static_cast<double>(w.field_col) * w.dx;
    w.y0 = y0 + static_cast<double>(w.field_row) * w.dy;
    windows_.push_back(w);
  }
  // Posts end where the grid ends: beyond it the base height is checked on the level's own grid.
  if (is_covered(0, 0) && is_covered(side, 0) && is_covered(0, side) && is_covered(side, side) && field.n_rows > 1) {
    const double west = static_cast<double>(west_), last = field.post_x(field.n_cols - 1);
    if (field.wraps || (field.x0 <= west && west + side <= last)) return;
  }
  PostWindow grid;
  grid.is_base_grid = true;
  grid.dx = grid.dy = static_cast<double>(side_ / kCellsPerTile);
  grid.per_dx = grid.per_dy = 1 / grid.dx;
  grid.n_cols = grid.n_rows = kCellsPerTile + 1;
  windows_.push_back(grid);
  find_covered_boxes();
}

// Small windows lie in memory, in rows as short as they are; of large ones few posts are looked at.
void TilePosts::find_posts(bool few) {
  constexpr std::int64_t kMostCopied = 2200000;  // 11 MB
  std::int64_t n = 0;
  for (const PostWindow& w : windows_) n += w.is_base_grid ? 0 : w.n_rows * w.n_cols;
  if (field_->pages != nullptr) {
    if (few || n > kMostCopied) return;
    copied_heights_m_.resize(static_cast<std::size_t>(n));
    copied_origins_.resize(static_cast<std::size_t>(n));
  }
  std::int64_t at = 0;
  for (PostWindow& w : windows_) {
    if (w.is_base_grid) continue;
    if (field_->pages == nullptr) {
      const std::int64_t first = w.field_row * field_->n_cols + w.field_col;
      w.heights_m = field_->heights_m + first;
      w.origins = field_->origins + first;
      w.stride = field_->n_cols;
      w.n_readable = field_->n_cols - w.field_col;
      continue;
    }
    float* const heights = copied_heights_m_.data() + at;
    PostOrigin* const origins = copied_origins_.data() + at;
    field_->pages->copy(w.field_row, w.field_col, w.n_rows, w.n_cols, heights, origins);
    w.heights_m = heights;
    w.origins = origins;
    w.stride = w.n_readable = w.n_cols;
    at += w.n_rows * w.n_cols;
  }
}

// As HeightField::covers, in local lattice steps and a little smaller.
void TilePosts::find_covered_boxes() {
  const HeightField& f = *field_;
  const double width = static_cast<double>(f.lattice.width()), west = static_cast<double>(west_);
  const double south = (f.continues_south ? 0.0 : f.y0) - static_cast<double>(south_);
  const double north = (f.continues_north ? static_cast<double>(f.lattice.height()) : f.post_y(f.n_rows - 1)) -
                       static_cast<double>(south_);
  for (const double turn : {-width, 0.0, width}) {
    PlanBox box{f.x0 + turn - west, south, f.post_x(f.n_cols - 1) + turn - west, north};
    if (f.wraps) {
      box.west = -nudge_;
      box.east = static_cast<double>(side_) + nudge_;
    }
    covered_.push_back({box.west + nudge_, box.south + nudge_, box.east - nudge_, box.north - nudge_});
  }
}

bool TilePosts::is_covered(const PlanTriangle& t) const {
  const double south = std::min({t.y[0], t.y[1], t.y[2]}), north = std::max({t.y[0], t.y[1], t.y[2]});
  const double west = std::min({t.x[0], t.x[1], t.x[2]}), east = std::max({t.x[0], t.x[1], t.x[2]});
  for (const PlanBox& b : covered_) {
    if (west >= b.west && east <= b.east && south >= b.south && north <= b.north) return true;
  }
  return false;
}

void TilePosts::collect_points() {
  const double width = static_cast<double>(field_->lattice.width()), side = static_cast<double>(side_);
  found_.clear();
  for (const double turn : {0.0, width}) {
    const double west = static_cast<double>(west_) + turn, south = static_cast<double>(south_);
    field_->points.for_blocks(west - nudge_, south - nudge_, west + side + nudge_, south + side + nudge_,
                              [&](const PointPost& p) {
                                const TilePoint local{p.x - west, p.y - south, static_cast<double>(p.height_m)};
                                if (local.x < -nudge_ || local.x > side + nudge_) return;
                                if (local.y < -nudge_ || local.y > side + nudge_) return;
                                found_.push_back(local);
                              });
  }
  if (found_.empty()) return;
  double x1 = found_[0].x, y1 = found_[0].y;
  cells_x0_ = x1;
  cells_y0_ = y1;
  for (const TilePoint& p : found_) {
    cells_x0_ = std::min(cells_x0_, p.x);
    cells_y0_ = std::min(cells_y0_, p.y);
    x1 = std::max(x1, p.x);
    y1 = std::max(y1, p.y);
  }
  // About one point a cell, wherever the points are.
  const double n = static_cast<double>(found_.size()), longer = std::max({x1 - cells_x0_, y1 - cells_y0_, 1.0});
  cell_size_ = std::max(std::sqrt((x1 - cells_x0_) * (y1 - cells_y0_) / n), longer / n);
  n_cell_cols_ = static_cast<std::int64_t>((x1 - cells_x0_) / cell_size_) + 1;
  n_cell_rows_ = static_cast<std::int64_t>((y1 - cells_y0_) / cell_size_) + 1;
  const auto cell_of = [&](const TilePoint& p) {
    return static_cast<std::size_t>(cell_row(p.y) * n_cell_cols_ + cell_col(p.x));
  };
  cell_first_.assign(static_cast<std::size_t>(n_cell_cols_ * n_cell_rows_) + 1, 0);
  for (const TilePoint& p : found_) ++cell_first_[cell_of(p) + 1];
  for (std::size_t k = 1; k < cell_first_.size(); ++k) cell_first_[k] += cell_first_[k - 1];
  points_.resize(found_.size());
  cell_next_.assign(cell_first_.begin(), cell_first_.end() - 1);
  for (const TilePoint& p : found_) points_[cell_next_[cell_of(p)]++] = p;
}

std::pair<double, double> TilePosts::position(std::int64_t index) const {
  if (index >= first_point_) {
    const TilePoint& p = points_[static_cast<std::size_t>(index - first_point_)];
    return {p.x, p.y};
  }
  const PostWindow& w = window_of(index);
  const std::int64_t at = index - w.first_index, r = at / w.n_cols;
  return {w.x(at - r * w.n_cols), w.y(r)};
}

void TilePosts::find_posts_of(std::span<const LocalVertex> vertices, OfVertices& found) const {
  found.posts.clear();
  found.heights_m.clear();
  for (std::size_t k = 0; k < vertices.size(); ++k) {
    const LocalVertex& v = vertices[k];
    const double x = static_cast<double>(v.x), y = static_cast<double>(v.y);
    for (const PostWindow& w : windows_) {
      // Posts are more than two steps apart: no other one rounds to the vertex.
      const std::int64_t c = floor_of((x - w.x0) * w.per_dx + 0.5), r = floor_of((y - w.y0) * w.per_dy + 0.5);
      if (c < 0 || r < 0 || c >= w.n_cols || r >= w.n_rows) continue;
      if (floor_of(w.x(c) + 0.5) != v.x || floor_of(w.y(r) + 0.5) != v.y) continue;
      found.posts.push_back(
          {static_cast<std::size_t>(&w - windows_.data()),
           {static_cast<std::int32_t>(r), static_cast<std::int32_t>(c), 0, static_cast<std::uint32_t>(k)}});
    }
  }
  // Apart, so that the processor may wait for several of them at once.
  for (OfVertices::Post& of_vertex : found.posts) {
    const PostWindow& w = windows_[of_vertex.window];
    if (w.is_base_grid) continue;  // its height is known elsewhere
    PostSubset::Post& p = of_vertex.post;
    p.height_m = w.heights_m != nullptr ? w.heights_m[p.row * w.stride + p.col]
                                        : field_->pages->height_m(w.field_row + p.row, w.field_col + p.col);
    found.heights_m.push_back(p.height_m);
  }
}

bool TilePosts::restrict_to(const OfVertices& vertices, std::span<const PlanBox> boxes) {
  constexpr std::int64_t kLeastLeftOut = 2;  // times those that are kept in boxes
  some_.resize(windows_.size());
  std::int64_t n_all = 0, n_kept = 0;
  for (std::size_t k = 0; k < windows_.size(); ++k) {
    const PostWindow& w = windows_[k];
    some_[k].clear();
    if (w.is_base_grid) continue;
    n_all += w.n_rows * w.n_cols;
    for (const PlanBox& b : boxes) {
      const std::int64_t row = std::max<std::int64_t>(0, floor_of((b.south - w.y0) * w.per_dy) - 1);
      const std::int64_t col = std::max<std::int64_t>(0, floor_of((b.west - w.x0) * w.per_dx) - 1);
      const std::int64_t row_end = std::min(w.n_rows, ceil_of((b.north - w.y0) * w.per_dy) + 2);
      const std::int64_t col_end = std::min(w.n_cols, ceil_of((b.east - w.x0) * w.per_dx) + 2);
      if (row >= row_end || col >= col_end) continue;
      some_[k].add_box({row, col, row_end - row, col_end - col});
      n_kept += (row_end - row) * (col_end - col);
    }
  }
  if (n_kept * (1 + kLeastLeftOut) > n_all) return false;
  for (const OfVertices::Post& p : vertices.posts) some_[p.window].add_post(p.post);
  for (PostSubset& some : some_) some.arrange();
  is_restricted_ = true;
  return true;
}

// The posts of a part of a window: blocks that settle(level, i, j, inside) is done with, and rows of the others.
template <class Settle, class Row>
void TilePosts::for_posts(const PostWindow& w, const PostBlocks::Extent& part, Settle settle, Row row) const {
  if (!has_blocks()) {
    for (std::int64_t r = part.row; r < part.row + part.n_rows; ++r) row(r, part.col, part.col + part.n_cols);
    return;
  }
  blocks().visit({w.field_row + part.row, w.field_col + part.col, part.n_rows, part.n_cols}, settle,
                 [&](std::int64_t r, std::int64_t c_begin, std::int64_t c_end) {
                   row(r - w.field_row, c_begin - w.field_col, c_end - w.field_col);
                 });
}

std::uint64_t TilePosts::count_source(const PostWindow& w, const PostBlocks::Extent& part) const {
  std::uint64_t n = 0;
  if (part.n_rows <= 0 || part.n_cols <= 0) return n;
  const auto row = [&](std::int64_t r, std::int64_t c_begin, std::int64_t c_end) {
    for_parts(w, r, c_begin, c_end, [&](const float*, const PostOrigin* origins, std::int64_t begin, std::int64_t end) {
      n += static_cast<std::uint64_t>(std::count(origins, origins + (end - begin), PostOrigin::kSource));
    });
  };
  const std::int64_t row_first = w.field_row + part.row, row_end = row_first + part.n_rows;
  const std::int64_t col_first = w.field_col + part.col, col_end = col_first + part.n_cols;
  // Where a block has posts of the source alone, or none, so has what the part has of it.
  const auto settle = [&](int level, std::int64_t i, std::int64_t j, bool inside) {
    const std::uint32_t n_source = blocks().summary(level, i, j).n_source;
    const PostBlocks::Extent e = blocks().extent(level, i, j);
    if (inside) {
      n += n_source;
    } else if (static_cast<std::int64_t>(n_source) == e.n_posts()) {
      n += static_cast<std::uint64_t>((std::min(row_end, e.row + e.n_rows) - std::max(row_first, e.row)) *
                                      (std::min(col_end, e.col + e.n_cols) - std::max(col_first, e.col)));
    }
    return inside || n_source == 0 || static_cast<std::int64_t>(n_source) == e.n_posts();
  };
  for_posts(w, part, settle, row);
  return n;
}

std::pair<double, double> TilePosts::height_range() const {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (const PostWindow& w : windows_) {
    if (w.is_base_grid) {
      low = std::min(low, field_->base_height_m);
      high = std::max(high, field_->base_height_m);
      continue;
    }
    const auto row = [&](std::int64_t r, std::int64_t c_begin, std::int64_t c_end) {
      for_parts(w, r, c_begin, c_end,
                [&](const float* heights, const PostOrigin*, std::int64_t begin, std::int64_t end) {
                  float least = heights[0], most = heights[0];
                  for (std::int64_t k = 1; k < end - begin; ++k) {
                    least = heights[k] < least ? heights[k] : least;
                    most = heights[k] > most ? heights[k] : most;
                  }
                  low = std::min(low, static_cast<double>(least));
                  high = std::max(high, static_cast<double>(most));
                });
    };
    for_posts(
        w, {0, 0, w.n_rows, w.n_cols},
        [&](int level, std::int64_t i, std::int64_t j, bool inside) {
          const PostSummary posts = blocks().summary(level, i, j);
          const auto least = static_cast<double>(posts.min_height_m), most = static_cast<double>(posts.max_height_m);
          if (inside) {
            low = std::min(low, least);
            high = std::max(high, most);
          }
          return inside || (low <= least && most <= high);
        },
        row);
  }
  for (const TilePoint& p : points_) {
    low = std::min(low, p.height_m);
    high = std::max(high, p.height_m);
  }
  return {low, high};
}

}  // namespace tind
