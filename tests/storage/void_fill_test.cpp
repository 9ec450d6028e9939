// SPDX-License-Identifier: GPL-3.0-or-later
// Filling and falloff on random masks, against the definition by brute force.
#include "storage/readers/falloff.hpp"
#include "storage/readers/void_fill.hpp"

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include <gtest/gtest.h>

namespace tind {
namespace {

struct World {
  std::vector<float> heights;
  std::vector<PostOrigin> origins;
  PostGrid grid;

  World(std::int64_t n_rows, std::int64_t n_cols, bool wraps)
      : heights(static_cast<std::size_t>(n_rows * n_cols)), origins(heights.size(), PostOrigin::kBase) {
    grid = {n_rows, n_cols, wraps, heights.data(), origins.data()};
  }
  void set(std::int64_t r, std::int64_t c, float height) {
    heights[static_cast<std::size_t>(r * grid.n_cols + c)] = height;
    origins[static_cast<std::size_t>(r * grid.n_cols + c)] = PostOrigin::kSource;
  }
  float height(std::int64_t r, std::int64_t c) const { return heights[static_cast<std::size_t>(r * grid.n_cols + c)]; }
  PostOrigin origin(std::int64_t r, std::int64_t c) const {
    return origins[static_cast<std::size_t>(r * grid.n_cols + c)];
  }
  DataFrame whole() const { return {0, grid.n_rows - 1, 0, grid.n_cols - 1, true, true}; }
};

World random_world(std::mt19937& random, bool wraps, double share) {
  const auto pick = [&](int low, int high) { return std::uniform_int_distribution<int>(low, high)(random); };
  World w(pick(3, 40), pick(3, 40), wraps);
  for (std::int64_t r = 0; r < w.grid.n_rows; ++r) {
    for (std::int64_t c = 0; c < w.grid.n_cols; ++c) {
      if (std::bernoulli_distribution(share)(random)) w.set(r, c, static_cast<float>(pick(100, 900)));
    }
  }
  w.set(pick(0, static_cast<int>(w.grid.n_rows) - 1), pick(0, static_cast<int>(w.grid.n_cols) - 1), 500);
  return w;
}

TEST(Falloff, ReachesExactlyAsFarAsItsDistance) {
  std::mt19937 random(1);
  for (int round = 0; round < 200; ++round) {
    World w = random_world(random, round % 2 == 0, 0.01);
    const World before = w;
    const std::int64_t limit = std::uniform_int_distribution<int>(1, 12)(random);
    std::uint64_t expected = 0;
    const std::uint64_t n = add_falloff(w.grid, 10, limit);
    for (std::int64_t r = 0; r < w.grid.n_rows; ++r) {
      for (std::int64_t c = 0; c < w.grid.n_cols; ++c) {
        std::int64_t nearest2 = 1 << 30;
        for (std::int64_t rr = 0; rr < w.grid.n_rows; ++rr) {
          for (std::int64_t cc = 0; cc < w.grid.n_cols; ++cc) {
            if (before.origin(rr, cc) != PostOrigin::kSource) continue;
            std::int64_t dc = std::abs(cc - c);
            if (w.grid.wraps) dc = std::min(dc, w.grid.n_cols - dc);
            nearest2 = std::min(nearest2, (rr - r) * (rr - r) + dc * dc);
          }
        }
        if (nearest2 == 0) {
          ASSERT_EQ(w.height(r, c), before.height(r, c));
        } else if (nearest2 >= limit * limit) {
          ASSERT_EQ(w.origin(r, c), PostOrigin::kBase) << round;
          ASSERT_EQ(w.height(r, c), 10) << round;
        } else {
          ++expected;
          ASSERT_EQ(w.origin(r, c), PostOrigin::kFalloff) << round;
          ASSERT_GE(w.height(r, c), 10);
          ASSERT_LE(w.height(r, c), 900);
        }
      }
    }
    ASSERT_EQ(n, expected);
  }
}

TEST(Falloff, AnyNumberOfThreadsMakesTheSame) {
  for (const bool wraps : {false, true}) {
    const auto made_by = [wraps](int threads) {
      std::mt19937 random(3);
      World w(1700, 30, wraps);
      for (std::int64_t r = 100; r < 1600; ++r) {
        for (std::int64_t c = 0; c < w.grid.n_cols; ++c) {
          if (std::bernoulli_distribution(0.01)(random)) w.set(r, c, static_cast<float>(random() % 900));
        }
      }
      const std::uint64_t n = add_falloff(w.grid, 10, 40, threads);
      EXPECT_EQ(n, static_cast<std::uint64_t>(std::count(w.origins.begin(), w.origins.end(), PostOrigin::kFalloff)));
      return w;
    };
    const World one = made_by(1);
    for (const int threads : {2, 3, 7, 100}) {
      const World many = made_by(threads);
      ASSERT_EQ(many.heights, one.heights) << threads;
      ASSERT_EQ(many.origins, one.origins) << threads;
    }
  }
}

/// The posts that a void reaches from (r, c) over void posts, 4-connected, by brute force; true iff it is interior.
bool is_interior(const World& w, std::int64_t r, std::int64_t c) {
  std::vector<bool> seen(w.heights.size());
  std::vector<std::pair<std::int64_t, std::int64_t>> stack{{r, c}};
  bool interior = true;
  while (!stack.empty()) {
    auto [rr, cc] = stack.back();
    stack.pop_back();
    if (w.grid.wraps) cc = (cc + w.grid.n_cols) % w.grid.n_cols;
    if (rr < 0 || rr >= w.grid.n_rows || cc < 0 || cc >= w.grid.n_cols) {
      interior = false;
      continue;
    }
    const auto i = static_cast<std::size_t>(rr * w.grid.n_cols + cc);
    if (seen[i] || w.origins[i] != PostOrigin::kBase) continue;
    seen[i] = true;
    for (const auto& [dr, dc] : {std::pair{-1, 0}, {1, 0}, {0, -1}, {0, 1}}) stack.emplace_back(rr + dr, cc + dc);
  }
  return interior;
}

TEST(InteriorVoids, AreThoseThatDoNotReachAnOpenSideAndStayInRange) {
  std::mt19937 random(2);
  for (int round = 0; round < 60; ++round) {
    World w = random_world(random, round % 2 == 0, 0.6);
    const World before = w;
    std::uint64_t expected = 0;
    const std::uint64_t n = fill_interior_voids(w.grid, w.whole());
    for (std::int64_t r = 0; r < w.grid.n_rows; ++r) {
      for (std::int64_t c = 0; c < w.grid.n_cols; ++c) {
        if (before.origin(r, c) == PostOrigin::kSource) {
          ASSERT_EQ(w.height(r, c), before.height(r, c));
        } else if (is_interior(before, r, c)) {
          ++expected;
          ASSERT_EQ(w.origin(r, c), PostOrigin::kFilled) << round;
          ASSERT_GE(w.height(r, c), 100);
          ASSERT_LE(w.height(r, c), 900);
        } else {
          ASSERT_EQ(w.origin(r, c), PostOrigin::kBase) << round;
        }
      }
    }
    ASSERT_EQ(n, expected);
  }
}

TEST(InteriorVoids, SolveLaplaceWithTheRimAsBoundary) {
  // Re(z^3) is harmonic; a disc of it is taken out, across the seam of a grid that wraps. Beside the disc all is known.
  World w(61, 90, true);
  const auto wave = [](std::int64_t r, std::int64_t c) {
    const double x = static_cast<double>(c < 45 ? c : c - 90) / 20, y = static_cast<double>(r - 30) / 20;
    return x * x * x - 3 * x * y * y;
  };
  for (std::int64_t r = 0; r < 61; ++r) {
    for (std::int64_t c = 0; c < 90; ++c) {
      const std::int64_t dc = c < 45 ? c : c - 90;
      if (dc * dc + (r - 30) * (r - 30) > 20 * 20) w.set(r, c, static_cast<float>(100 * wave(r, c)));
    }
  }
  ASSERT_GT(fill_interior_voids(w.grid, w.whole()), 1200u);
  for (std::int64_t r = 10; r <= 50; ++r) {
    for (std::int64_t c = 0; c < 90; ++c) {
      if (w.origin(r, c) == PostOrigin::kFilled) {
        ASSERT_NEAR(w.height(r, c), 100 * wave(r, c), 1.0) << r << " " << c;
      }
    }
  }
}

TEST(InteriorVoids, TouchingAPoleAreInterior) {
  World w(10, 12, true);
  for (std::int64_t r = 3; r < 10; ++r) {
    for (std::int64_t c = 0; c < 12; ++c) w.set(r, c, 50);
  }
  DataFrame frame = w.whole();
  frame.open_south = false;
  EXPECT_EQ(fill_interior_voids(w.grid, frame), 36u);
  EXPECT_EQ(w.height(0, 5), 50);
}

}  // namespace
}  // namespace tind
