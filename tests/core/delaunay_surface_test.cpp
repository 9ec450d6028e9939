// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/delaunay_surface.hpp"

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include <gtest/gtest.h>

namespace tind {
namespace {

std::vector<SurfaceSite> random_sites(std::uint32_t seed, std::size_t n, double side) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> at(0, side);
  std::vector<SurfaceSite> sites;
  for (std::size_t i = 0; i < n; ++i) {
    const double x = at(random), y = at(random);
    sites.push_back({x, y, static_cast<float>(100 * std::sin(x / 5) + 3 * y)});
  }
  return sites;
}

std::vector<float> interpolate(const std::vector<SurfaceSite>& sites, const PostRaster& window, double max_radius) {
  std::vector<float> heights(static_cast<std::size_t>(window.n_rows * window.n_cols), -1.0f);
  interpolate_posts(sites, window, max_radius, heights);
  return heights;
}

/// NaN equals NaN, everything else bit by bit.
bool same(const std::vector<float>& a, const std::vector<float>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](float x, float y) { return x == y || (std::isnan(x) && std::isnan(y)); });
}

TEST(DelaunaySurface, PlaneIsRecovered) {
  std::vector<SurfaceSite> sites = random_sites(1, 2000, 50);
  for (SurfaceSite& s : sites) s.height_m = static_cast<float>(500 + 2 * s.x - 3 * s.y);
  const auto heights = interpolate(sites, {5, 5, 1, 40, 40}, 16);
  for (int r = 0; r < 40; ++r) {
    for (int c = 0; c < 40; ++c) {
      ASSERT_NEAR(heights[static_cast<std::size_t>(r * 40 + c)], 500 + 2 * (5 + c) - 3 * (5 + r), 1e-3)
          << r << " " << c;
    }
  }
}

TEST(DelaunaySurface, PostOnASiteOrAnEdgeHasItsHeight) {
  const std::vector<SurfaceSite> sites = {{0, 0, 10}, {2, 0, 20}, {2, 2, 30}, {0, 2.5, 40}};
  const auto heights = interpolate(sites, {0, 0, 1, 3, 3}, 16);
  EXPECT_EQ(heights[0], 10);
  EXPECT_EQ(heights[1], 15);  // on the hull's edge
  EXPECT_EQ(heights[2], 20);
  EXPECT_EQ(heights[5], 25);
  EXPECT_EQ(heights[8], 30);
}

TEST(DelaunaySurface, OutsideAndInWideGapsIsVoid) {
  // Two strips 40 apart: the triangles between them have circles of radius 20 and more.
  std::vector<SurfaceSite> sites;
  for (int x = 0; x <= 100; ++x) {
    for (int y = 0; y <= 10; ++y) {
      sites.push_back({x + 0.01 * y, y + 0.003 * x, 1});
      sites.push_back({x + 0.01 * y, 50 + y + 0.003 * x, 2});
    }
  }
  const auto heights = interpolate(sites, {-5, -5, 1, 75, 111}, 16);
  const auto at = [&](int x, int y) { return heights[static_cast<std::size_t>((y + 5) * 111 + x + 5)]; };
  EXPECT_TRUE(std::isnan(at(-3, 5)));
  EXPECT_TRUE(std::isnan(at(50, -3)));
  EXPECT_TRUE(std::isnan(at(50, 30)));
  EXPECT_TRUE(std::isnan(at(50, 12)));
  EXPECT_EQ(at(50, 5), 1);
  EXPECT_EQ(at(50, 55), 2);
  // With wider circles the gap belongs to the surface.
  const auto wide = interpolate(sites, {50, 30, 1, 1, 1}, 40);
  EXPECT_FALSE(std::isnan(wide[0]));
}

TEST(DelaunaySurface, OrderOfSitesDoesNotMatter) {
  std::vector<SurfaceSite> sites = random_sites(2, 3000, 40);
  // A regular grid, too: four sites on one circle everywhere.
  for (int x = 60; x < 90; ++x) {
    for (int y = 0; y < 30; ++y) {
      sites.push_back({x + 0.5, y + 0.5, static_cast<float>((x * 37 + y * 91) % 50)});
    }
  }
  const auto heights = interpolate(sites, {0, 0, 1, 40, 95}, 16);
  std::mt19937 random(3);
  std::shuffle(sites.begin(), sites.end(), random);
  EXPECT_TRUE(same(interpolate(sites, {0, 0, 1, 40, 95}, 16), heights));
}

TEST(DelaunaySurface, SitesBeyondTwoRadiiDoNotMatter) {
  const double radius = 4;
  std::vector<SurfaceSite> all = random_sites(4, 4000, 100), near;
  for (const SurfaceSite& s : all) {
    if (std::max(std::abs(s.x - 50), std::abs(s.y - 50)) <= 10 + 2 * radius) near.push_back(s);
  }
  ASSERT_LT(near.size(), all.size() / 2);
  const PostRaster window{40, 40, 1, 21, 21};
  EXPECT_TRUE(same(interpolate(near, window, radius), interpolate(all, window, radius)));
  // The border of that guarantee: with hardly any halo the window's rim differs.
  std::erase_if(near, [](const SurfaceSite& s) { return std::max(std::abs(s.x - 50), std::abs(s.y - 50)) > 10; });
  EXPECT_FALSE(same(interpolate(near, window, radius), interpolate(all, window, radius)));
}

TEST(DelaunaySurface, FewerThanThreeSitesOrALineHaveNoSurface) {
  for (const std::size_t n : {0u, 1u, 2u, 9u}) {
    std::vector<SurfaceSite> sites;
    for (std::size_t i = 0; i < n; ++i) sites.push_back({static_cast<double>(i), 2.0 * static_cast<double>(i), 7});
    for (const float h : interpolate(sites, {0, 0, 1, 5, 5}, 16)) EXPECT_TRUE(std::isnan(h));
  }
}

TEST(DelaunaySurface, NoHeightLeavesTheRangeOfTheSites) {
  // Slivers: nearly on one line.
  std::mt19937 random(5);
  std::vector<SurfaceSite> sites;
  for (int i = 0; i < 500; ++i) {
    const double t = static_cast<double>(random() % 100000) / 2500;
    sites.push_back({t, 10 + 1e-9 * static_cast<double>(random() % 1000), static_cast<float>(random() % 100)});
  }
  for (int i = 0; i < 50; ++i) sites.push_back({static_cast<double>(i), i % 2 == 0 ? 0.0 : 20.0, 50});
  for (const float h : interpolate(sites, {0, 0, 0.5, 41, 81}, 1e6)) {
    if (std::isnan(h)) continue;
    EXPECT_GE(h, 0);
    EXPECT_LE(h, 99);
  }
}

}  // namespace
}  // namespace tind
