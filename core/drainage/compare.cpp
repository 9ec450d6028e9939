// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/drainage/compare.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace tind {
namespace {

/// Finds the distance to the nearest post of a network, up to a buffer.
class NearestPost {
 public:
  NearestPost(std::int64_t n_rows, std::int64_t n_cols, std::span<const StreamPost> posts, double buffer)
      : n_rows_(n_rows), n_cols_(n_cols), buffer_(buffer), has_(static_cast<std::size_t>(n_rows * n_cols)) {
    for (const StreamPost& p : posts) has_[static_cast<std::size_t>(p.row * n_cols + p.col)] = 1;
  }

  /// In cells; negative when there is none within the buffer.
  double distance(const StreamPost& p) const {
    const auto reach = static_cast<std::int64_t>(std::floor(buffer_));
    std::int64_t least = -1;
    for (std::int64_t r = std::max<std::int64_t>(0, p.row - reach); r <= std::min(n_rows_ - 1, p.row + reach); ++r) {
      for (std::int64_t c = std::max<std::int64_t>(0, p.col - reach); c <= std::min(n_cols_ - 1, p.col + reach); ++c) {
        if (!has_[static_cast<std::size_t>(r * n_cols_ + c)]) continue;
        const std::int64_t dr = r - p.row, dc = c - p.col, squared = dr * dr + dc * dc;
        if (least < 0 || squared < least) least = squared;
      }
    }
    const double d = std::sqrt(static_cast<double>(least));
    return least >= 0 && d <= buffer_ ? d : -1;
  }

 private:
  std::int64_t n_rows_, n_cols_;
  double buffer_;
  std::vector<std::uint8_t> has_;
};

}  // namespace

std::vector<StreamPost> stream_posts(std::int64_t n_rows, std::int64_t n_cols, const std::uint8_t* mask,
                                     const std::uint8_t* directions) {
  std::vector<StreamPost> posts;
  for (std::int64_t r = 0; r < n_rows; ++r) {
    for (std::int64_t c = 0; c < n_cols; ++c) {
      const std::int64_t i = r * n_cols + c;
      if (!mask[i]) continue;
      StreamPost post{r, c, 0};
      const auto d = static_cast<std::size_t>(directions[i] & kDirection);
      if (d < 8) {
        const std::int64_t rr = r + kStepRows[d], cc = c + kStepCols[d];
        if (rr >= 0 && rr < n_rows && cc >= 0 && cc < n_cols && mask[rr * n_cols + cc]) {
          post.length = d % 2 == 0 ? 1 : std::numbers::sqrt2;
        }
      }
      posts.push_back(post);
    }
  }
  return posts;
}

std::vector<StreamPost> stream_posts(const Flow& flow, double min_cells) {
  const std::vector<std::uint8_t> mask = channel_mask(flow, min_cells);
  return stream_posts(flow.n_rows, flow.n_cols, mask.data(), flow.directions.data());
}

StreamMatch compare_streams(std::int64_t n_rows, std::int64_t n_cols, std::span<const StreamPost> extracted,
                            std::span<const StreamPost> reference, double buffer_cells,
                            std::span<const std::uint8_t> excluded) {
  const auto scored = [&](const StreamPost& p) {
    return excluded.empty() || !excluded[static_cast<std::size_t>(p.row * n_cols + p.col)];
  };
  StreamMatch match;
  const NearestPost to_extracted(n_rows, n_cols, extracted, buffer_cells);
  for (const StreamPost& p : reference) {
    if (!scored(p)) continue;
    match.reference_length += p.length;
    if (to_extracted.distance(p) >= 0) match.reference_matched += p.length;
  }
  const NearestPost to_reference(n_rows, n_cols, reference, buffer_cells);
  double length_times_distance = 0;
  for (const StreamPost& p : extracted) {
    if (!scored(p)) continue;
    match.extracted_length += p.length;
    const double d = to_reference.distance(p);
    if (d < 0) continue;
    match.extracted_matched += p.length;
    length_times_distance += p.length * d;
  }
  if (match.extracted_matched > 0) match.mean_distance = length_times_distance / match.extracted_matched;
  return match;
}

}  // namespace tind
