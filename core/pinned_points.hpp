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

/// Which lattice points may be among some: a bit array in which each of these has its bit set, as other points' may be,
/// one of eight or more. Points of one cell have their bits in one or two lines of the processor's cache, for whoever
/// asks for points that lie together. Const access is thread safe.
class PinFilter {
 public:
  PinFilter() = default;
  /// `cell_bits`: a cell's side is 2^cell_bits steps; a few points in each is best.
  PinFilter(std::span<const LatticePoint> points, int cell_bits) : cell_bits_(cell_bits) {
    if (points.empty()) return;
    lines_.resize(std::bit_ceil(points.size() / 64 + 1));
    for (const LatticePoint& p : points) {
      const std::uint64_t bit = bit_of(p.x, p.y);
      lines_[line_of(p.x, p.y)].words[bit / 64] |= std::uint64_t{1} << (bit % 64);
    }
  }

  bool empty() const { return lines_.empty(); }
  std::size_t n_bytes() const { return lines_.size() * sizeof(Line); }
  /// Precondition: not empty.
  bool may_have(std::int64_t x, std::int64_t y) const {
    const std::uint64_t bit = bit_of(x, y);
    return (lines_[line_of(x, y)].words[bit / 64] >> (bit % 64) & 1) != 0;
  }

 private:
  struct alignas(64) Line {
    std::uint64_t words[8] = {};
  };

  // Mixes as splitmix64 does (Steele, Lea, Flood 2014, doi:10.1145/2660193.2660195).
  static std::uint64_t mix(std::int64_t x, std::int64_t y) {
    std::uint64_t h = static_cast<std::uint64_t>(x) * 0x9e3779b97f4a7c15u + static_cast<std::uint64_t>(y);
    h = (h ^ (h >> 30)) * 0xbf58476d1ce4e5b9u;
    h = (h ^ (h >> 27)) * 0x94d049bb133111ebu;
    return h ^ (h >> 31);
  }
  static std::uint64_t bit_of(std::int64_t x, std::int64_t y) { return mix(x, y) >> (64 - 9); }
  std::size_t line_of(std::int64_t x, std::int64_t y) const {
    return static_cast<std::size_t>(mix(x >> cell_bits_, y >> cell_bits_)) & (lines_.size() - 1);
  }

  std::vector<Line> lines_;  // a power of two of them
  int cell_bits_ = 0;
};

/// Lattice points whose vertices have a height of their own: those of break lines. A view of arrays it does not own;
/// const access is thread safe. Nearly all points that are asked for are none, which the filter tells.
class PinnedPoints {
 public:
  PinnedPoints() = default;
  /// `points`: ascending by (y, x), x in [0, lattice width). `filter`: of these points, or null: then each question
  /// costs a search. Implicit: a span of points is all there is to it.
  PinnedPoints(std::span<const LatticePoint> points, const PinFilter* filter = nullptr)
      : points_(points), filter_(filter) {}

  bool empty() const { return points_.empty(); }
  /// All of them, ascending by (y, x).
  std::span<const LatticePoint> points() const { return points_; }

  /// The height of (x, y), x in [0, lattice width), if it is pinned.
  std::optional<std::int32_t> find(std::int64_t x, std::int64_t y) const {
    if (points_.empty() || (filter_ != nullptr && !filter_->empty() && !filter_->may_have(x, y))) return std::nullopt;
    const auto pin = std::lower_bound(points_.begin(), points_.end(), std::tuple(y, x),
                                      [](const LatticePoint& p, const std::tuple<std::int64_t, std::int64_t>& at) {
                                        return std::tie(p.y, p.x) < at;
                                      });
    if (pin == points_.end() || pin->y != y || pin->x != x) return std::nullopt;
    return pin->z;
  }

 private:
  std::span<const LatticePoint> points_;
  const PinFilter* filter_ = nullptr;
};

}  // namespace tind
