// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/post_scan.hpp"

namespace tind::client {

std::vector<PostWindow> post_windows(const SourcePosts& posts, const LatticeFrame& frame, const TileId& id) {
  const double step = frame.step_deg();
  const double side = static_cast<double>(frame.side(id.level));
  PostWindow w;
  w.dx = posts.lon_spacing_deg / step;
  w.dy = posts.lat_spacing_deg / step;
  // Degrees carry about 1e-13 of rounding, so do real lattice positions.
  w.nudge = 1e-5 + 1e-13 * static_cast<double>(frame.width());
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

PostErrors post_errors(const SourcePosts& posts, std::int64_t at, double z_m) {
  const double first = std::abs(z_m - static_cast<double>(posts.heights_m[static_cast<std::size_t>(at)]));
  PostErrors errors{first, first};
  if (posts.other_values.empty()) return errors;
  const auto it = posts.other_values.find(at);
  if (it == posts.other_values.end()) return errors;
  for (const float other : it->second) {
    const double error = std::abs(z_m - static_cast<double>(other));
    errors.nearest = std::min(errors.nearest, error);
    errors.farthest = std::max(errors.farthest, error);
  }
  return errors;
}

double error_slack_m(const SourcePosts& posts, double height_m) {
  constexpr double kArithmetic = 1e-7;
  return posts.rounded ? kArithmetic + std::abs(height_m) * 0x1p-23 : kArithmetic;
}

}  // namespace tind::client
