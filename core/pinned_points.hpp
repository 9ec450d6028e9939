// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <tuple>
#include <vector>

#include "core/lattice.hpp"

namespace tind {

/// Lattice points whose vertices have a height of their own: those of break lines. A view of arrays it does not own;
/// const access is thread safe. Nearly all points that are asked for are none, which a bit per few points tells.
class PinnedPoints {
 public:
  PinnedPoints() = default;
  /// `points`: ascending by (y, x), x in [0, lattice width). `filter`: from make_filter(points), or empty: then each
  /// question costs a search. Implicit: a span of points is all there is to it.
  PinnedPoints(std::span<const LatticePoint> points, std::span<const std::uint64_t> filter = {})
      : points_(points), filter_(filter) {}

  bool empty() const { return points_.empty(); }
  /// All of them, ascending by (y, x).
  std::span<const LatticePoint> points() const { return points_; }

  /// The height of (x, y), x in [0, lattice width), if it is pinned.
  std::optional<std::int32_t> find(std::int64_t x, std::int64_t y) const {
    if (!filter_.empty()) {
      const std::uint64_t bit = bit_of(x, y, filter_.size());
      if (!(filter_[bit / 64] >> (bit % 64) & 1)) return std::nullopt;
    }
    const auto pin = std::lower_bound(points_.begin(), points_.end(), std::tuple(y, x),
                                      [](const LatticePoint& p, const std::tuple<std::int64_t, std::int64_t>& at) {
                                        return std::tie(p.y, p.x) < at;
                                      });
    if (pin == points_.end() || pin->y != y || pin->x != x) return std::nullopt;
    return pin->z;
  }

  /// A bit array in which each point's bit is set, as other points' may be: one of eight or more.
  static std::vector<std::uint64_t> make_filter(std::span<const LatticePoint> points) {
    if (points.empty()) return {};
    std::vector<std::uint64_t> filter(std::bit_ceil(points.size() / 8 + 1), 0);
    for (const LatticePoint& p : points) {
      const std::uint64_t bit = bit_of(p.x, p.y, filter.size());
      filter[bit / 64] |= std::uint64_t{1} << (bit % 64);
    }
    return filter;
  }

 private:
  // `n_words` is a power of two. Mixes as splitmix64 does (Steele, Lea, Flood 2014, doi:10.1145/2660193.2660195).
  static std::uint64_t bit_of(std::int64_t x, std::int64_t y, std::size_t n_words) {
    std::uint64_t h = static_cast<std::uint64_t>(x) * 0x9e3779b97f4a7c15u + static_cast<std::uint64_t>(y);
    h = (h ^ (h >> 30)) * 0xbf58476d1ce4e5b9u;
    h = (h ^ (h >> 27)) * 0x94d049bb133111ebu;
    return h >> (64 - 6 - std::countr_zero(n_words));
  }

  std::span<const LatticePoint> points_;
  std::span<const std::uint64_t> filter_;
};

}  // namespace tind
