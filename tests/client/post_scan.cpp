// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/post_scan.hpp"

#include <utility>

namespace tind::client {

std::vector<PostWindow> post_windows(const SourcePosts& posts, const LatticeFrame& frame, const TileId& id) {
  const double step = frame.step_deg();
  const double side = static_cast<double>(frame.side(id.level));
  PostWindow w;
  w.dx = posts.lon_spacing_deg / step;
  w.dy = posts.lat_spacing_deg / step;
  w.nudge = line_nudge(frame);
  const double south = (posts.south_deg + 90.0) / step - static_cast<double>(frame.origin_y(id));
  w.row0 = std::max<std::int64_t>(0, static_cast<std::int64_t>(std::ceil((-south - w.nudge) / w.dy)));
  const auto last_row =
      std::min<std::int64_t>(posts.n_rows - 1, static_cast<std::int64_t>(std::floor((side - south + w.nudge) / w.dy)));
  w.n_rows = last_row - w.row0 + 1;
  w.y = south + static_cast<double>(w.row0) * w.dy;
  std::vector<PostWindow> windows;
  if (w.n_rows <= 0) return windows;
  for (int turn = -2; turn <= 2; ++turn) {
    const double west = (posts.west_deg + 180.0) / step + turn * static_cast<double>(frame.width()) -
                        static_cast<double>(frame.origin_x(id));
    PostWindow at = w;
    at.column0 = std::max<std::int64_t>(0, static_cast<std::int64_t>(std::ceil((-west - w.nudge) / w.dx)));
    const auto last =
        std::min<std::int64_t>(posts.n_cols - 1, static_cast<std::int64_t>(std::floor((side - west + w.nudge) / w.dx)));
    at.n_columns = last - at.column0 + 1;
    at.x = west + static_cast<double>(at.column0) * at.dx;
    if (at.n_columns > 0) windows.push_back(at);
  }
  return windows;
}

double line_nudge(const LatticeFrame& frame) { return 1e-5 + 1e-13 * static_cast<double>(frame.width()); }

TilePosts::TilePosts(const SourcePosts& posts, const LatticeFrame& frame, const TileId& id)
    : posts_(&posts), nudge_(line_nudge(frame)) {
  if (posts.kind != SourceKind::kPoints) {
    for (const PostWindow& window : post_windows(posts, frame, id)) {
      windows_.push_back({window, n_slots_});
      n_slots_ += static_cast<std::size_t>(window.n_rows * window.n_columns);
    }
    return;
  }
  const double step = frame.step_deg(), side = static_cast<double>(frame.side(id.level));
  const PointIndex& index = posts.index;
  // Cells of the index that the tile may touch, wherever the turn of the globe puts them.
  const double slack_deg = nudge_ * step + 1e-9;
  const double south_deg = static_cast<double>(frame.origin_y(id)) * step - 90 - slack_deg;
  const double height_deg = side * step + 2 * slack_deg;
  const auto cells = [&](double from_deg, double width_deg, std::int64_t n) {
    const double first = std::floor(from_deg / index.cell_deg),
                 last = std::floor((from_deg + width_deg) / index.cell_deg);
    return std::pair<std::int64_t, std::int64_t>(
        static_cast<std::int64_t>(std::clamp(first, 0.0, static_cast<double>(n))),
        static_cast<std::int64_t>(std::clamp(last, -1.0, static_cast<double>(n - 1))));
  };
  const auto [row0, row1] = cells(south_deg - index.south_deg, height_deg, index.n_rows);
  for (int turn = -2; turn <= 2; ++turn) {
    const double west_deg = static_cast<double>(frame.origin_x(id)) * step - 180 - slack_deg - 360.0 * turn;
    const auto [column0, column1] = cells(west_deg - index.west_deg, height_deg, index.n_cols);
    if (column0 > column1) continue;
    for (std::int64_t r = row0; r <= row1; ++r) {
      const std::uint32_t first = index.first[static_cast<std::size_t>(r * index.n_cols + column0)],
                          end = index.first[static_cast<std::size_t>(r * index.n_cols + column1) + 1];
      for (std::uint32_t at = first; at < end; ++at) {
        Place p;
        p.at = at;
        p.x = (posts.longitudes_deg[at] + 180) / step + turn * static_cast<double>(frame.width()) -
              static_cast<double>(frame.origin_x(id));
        p.y = (posts.latitudes_deg[at] + 90) / step - static_cast<double>(frame.origin_y(id));
        if (p.x >= -nudge_ && p.x <= side + nudge_ && p.y >= -nudge_ && p.y <= side + nudge_) places_.push_back(p);
      }
    }
  }
  n_slots_ = places_.size();
  n_bins_ = std::clamp<std::size_t>(static_cast<std::size_t>(std::sqrt(static_cast<double>(n_slots_) / 4)), 1, 1024);
  bin_side_ = side / static_cast<double>(n_bins_);
  const auto bin = [&](const Place& p) { return bin_of(p.y) * n_bins_ + bin_of(p.x); };
  std::stable_sort(places_.begin(), places_.end(), [&](const Place& a, const Place& b) { return bin(a) < bin(b); });
  bins_.assign(n_bins_ * n_bins_ + 1, 0);
  for (const Place& p : places_) ++bins_[bin(p) + 1];
  for (std::size_t k = 1; k < bins_.size(); ++k) bins_[k] += bins_[k - 1];
}

TilePosts::Place TilePosts::place(std::size_t slot) const {
  if (windows_.empty()) return places_[slot];
  std::size_t k = 0;
  while (k + 1 < windows_.size() && slot >= windows_[k + 1].first_slot) ++k;
  const PostWindow& w = windows_[k].window;
  const auto in = static_cast<std::int64_t>(slot - windows_[k].first_slot);
  const std::int64_t r = in / w.n_columns, c = in % w.n_columns;
  return {(w.row0 + r) * posts_->n_cols + w.column0 + c, w.post_x(c), w.post_y(r)};
}

PostErrors post_errors(const SourcePosts& posts, std::int64_t at, double z_m) {
  const auto first = static_cast<double>(posts.heights_m[static_cast<std::size_t>(at)]);
  PostErrors errors{std::abs(z_m - first), std::abs(z_m - first)};
  if (posts.other_values.empty()) return errors;
  const auto it = posts.other_values.find(at);
  if (it == posts.other_values.end()) return errors;
  double low = first, high = first;
  for (const float other : it->second) {
    low = std::min(low, static_cast<double>(other));
    high = std::max(high, static_cast<double>(other));
  }
  return {std::max({0.0, low - z_m, z_m - high}), std::max(std::abs(z_m - low), std::abs(z_m - high))};
}

double error_slack_m(const SourcePosts& posts, double height_m) {
  constexpr double kArithmetic = 1e-7;
  return posts.rounded ? kArithmetic + std::abs(height_m) * 0x1p-23 : kArithmetic;
}

}  // namespace tind::client
