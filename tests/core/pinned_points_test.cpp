// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/pinned_points.hpp"

#include <random>

#include <gtest/gtest.h>

namespace tind {
namespace {

std::vector<LatticePoint> random_points(std::size_t n, unsigned seed) {
  std::mt19937_64 random(seed);
  std::vector<LatticePoint> points;
  for (std::size_t k = 0; k < n; ++k) {
    // Even coordinates, so that odd ones are none of them.
    points.push_back({static_cast<std::int64_t>(random() % 100'000) * 2, static_cast<std::int64_t>(random() % 1000) * 2,
                      static_cast<std::int32_t>(k)});
  }
  const auto key = [](const LatticePoint& p) { return std::tuple(p.y, p.x); };
  std::sort(points.begin(), points.end(),
            [&](const LatticePoint& a, const LatticePoint& b) { return key(a) < key(b); });
  points.erase(std::unique(points.begin(), points.end(),
                           [&](const LatticePoint& a, const LatticePoint& b) { return key(a) == key(b); }),
               points.end());
  return points;
}

TEST(PinnedPoints, FindsEachPointAndNoOtherWithAFilterAndWithout) {
  for (const std::size_t n : {0u, 1u, 7u, 8u, 9u, 1000u, 50'000u}) {
    const auto points = random_points(n, 7);
    const PinFilter filter(points, static_cast<int>(n % 13));
    for (const PinnedPoints pinned : {PinnedPoints(points), PinnedPoints(points, &filter)}) {
      EXPECT_EQ(pinned.empty(), n == 0);
      for (const LatticePoint& p : points) {
        ASSERT_EQ(pinned.find(p.x, p.y), p.z) << n;
        ASSERT_EQ(pinned.find(p.x + 1, p.y), std::nullopt);
        ASSERT_EQ(pinned.find(p.x, p.y - 1), std::nullopt);
      }
    }
  }
}

TEST(PinnedPoints, FilterSparesMostSearches) {
  const auto points = random_points(50'000, 1);
  for (const int cell_bits : {0, 3, 5, 8}) {
    const PinFilter filter(points, cell_bits);
    EXPECT_LE(filter.n_bytes(), points.size() * 2 + 64);  // at most two bytes a point
    std::size_t n_others = 0;
    for (const LatticePoint& p : points) {
      ASSERT_TRUE(filter.may_have(p.x, p.y));
      n_others += filter.may_have(p.x + 1, p.y) ? 1 : 0;  // of cells that have points
    }
    EXPECT_LT(n_others, points.size() / 5) << cell_bits;
  }
  // It is asked first: what it does not know is not found.
  const PinFilter few(random_points(3, 2), 4);
  const PinnedPoints blind(points, &few);
  std::size_t n_found = 0;
  for (const LatticePoint& p : points) n_found += blind.find(p.x, p.y).has_value() ? 1 : 0;
  EXPECT_LT(n_found, points.size() / 8);
}

}  // namespace
}  // namespace tind
