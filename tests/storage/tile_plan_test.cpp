// SPDX-License-Identifier: GPL-3.0-or-later
// What a build knows of its tiles from the posts: which there are, what they cover, how high they are. Judged post by
// post.
#include "storage/builder/plan.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <set>
#include <tuple>
#include <vector>

#include "core/format/quantized_mesh.hpp"
#include "storage/builder/tile_posts.hpp"
#include "tests/support/test_field.hpp"

namespace tind {
namespace {

constexpr int kBottom = 5;
using Position = std::tuple<int, std::uint32_t, std::uint32_t>;  // level, x, y

/// A field whose posts are base but for spots of random origin; posts several to a tile or several tiles to a post.
struct World {
  test::TestField f;
  std::vector<std::byte> memory, demanded_memory;
  std::optional<PostBlocks> blocks, demanded;

  World(std::uint64_t seed, bool wraps, double posts_per_tile) : f(make(seed, wraps, posts_per_tile)) {
    f.field.wraps = wraps;
    for (std::int64_t r = 0; r < f.field.n_rows; ++r) {
      for (std::int64_t c = 0; c < f.field.n_cols; ++c) {
        const auto at = static_cast<std::size_t>(r * f.field.n_cols + c);
        const double spot = test::noise(seed + 1, r / 13, c / 17);
        f.origins[at] = spot < 0.3   ? PostOrigin::kSource
                        : spot < 0.5 ? static_cast<PostOrigin>(static_cast<int>(5 * test::noise(seed + 2, r, c)))
                                     : PostOrigin::kBase;
        if (f.origins[at] == PostOrigin::kBase) f.heights_m[at] = static_cast<float>(f.field.base_height_m);
      }
    }
    memory.resize(PostBlocks::n_bytes(f.field.n_rows, f.field.n_cols));
    blocks = PostBlocks::build(f.field, memory, 1);
    demanded_memory.resize(memory.size());
    demanded = PostBlocks::on_demand(f.field, demanded_memory, 1);
  }
  static test::TestField make(std::uint64_t seed, bool wraps, double posts_per_tile) {
    test::GridPlace place;
    place.lattice_level = kBottom;
    Lattice lattice;
    lattice.level = kBottom;
    place.base_height_m = -3;
    place.dx = place.dy = static_cast<double>(lattice.tile_side(kBottom)) / posts_per_tile;
    place.n_rows = 40 + static_cast<std::int64_t>(60 * test::noise(seed, 0, 0));
    place.n_cols = 40 + static_cast<std::int64_t>(60 * test::noise(seed, 0, 1));
    const double width = static_cast<double>(lattice.width()), height = static_cast<double>(lattice.height());
    if (!wraps) place.n_cols = std::min(place.n_cols, static_cast<std::int64_t>(0.9 * width / place.dx));
    if (wraps) place.dx = width / static_cast<double>(place.n_cols);
    place.dy = std::min(place.dy, height / static_cast<double>(place.n_rows + 2));
    place.x0 = wraps ? 0.0 : std::floor(width * test::noise(seed, 0, 2));
    place.y0 = place.dy + (height - static_cast<double>(place.n_rows + 2) * place.dy) * test::noise(seed, 0, 3);
    const test::HeightAt terrain = test::rough_terrain(seed, 4000);
    return test::TestField(place, terrain);
  }
  HeightField with_blocks() const {
    HeightField field = f.field;
    field.blocks = &*blocks;
    return field;
  }
  HeightField with_blocks_on_demand() const {
    HeightField field = f.field;
    field.blocks = &*demanded;
    return field;
  }
  bool has_made_blocks() const {
    return std::any_of(demanded_memory.begin(), demanded_memory.end(), [](std::byte b) { return b != std::byte{0}; });
  }
};

/// Calls visit(row, column, x, y) for every post, x in [0, width).
template <class Visit>
void for_posts(const HeightField& f, Visit visit) {
  const double width = static_cast<double>(f.lattice.width());
  for (std::int64_t r = 0; r < f.n_rows; ++r) {
    for (std::int64_t c = 0; c < f.n_cols; ++c) visit(r, c, std::fmod(f.post_x(c), width), f.post_y(r));
  }
}

std::set<Position> expected_tiles(const HeightField& f) {
  std::set<Position> tiles;
  const double side = static_cast<double>(f.lattice.tile_side(kBottom));
  const std::int64_t n_x = TileKey::count_x(kBottom), n_y = TileKey::count_y(kBottom);
  std::set<std::pair<std::int64_t, std::int64_t>> touched;
  for_posts(f, [&](std::int64_t r, std::int64_t c, double, double y) {
    if (f.origin_at(r, c) == PostOrigin::kBase) return;
    const auto tile = [&](double v) { return static_cast<std::int64_t>(std::floor(v / side)); };
    for (std::int64_t tx = tile(f.post_x(c) - f.dx); tx <= tile(f.post_x(c) + f.dx); ++tx) {
      for (std::int64_t ty = std::max<std::int64_t>(tile(y - f.dy), 0); ty <= std::min(tile(y + f.dy), n_y - 1); ++ty) {
        touched.insert({((tx % n_x) + n_x) % n_x, ty});
      }
    }
  });
  for (int level = kBottom; level > 0; --level) {
    std::set<std::pair<std::int64_t, std::int64_t>> parents;
    for (const auto& [x, y] : touched) parents.insert({x / 2, y / 2});
    for (const auto& [x, y] : parents) {
      for (int k = 0; k < 4; ++k) {
        tiles.insert({level, static_cast<std::uint32_t>(2 * x + k % 2), static_cast<std::uint32_t>(2 * y + k / 2)});
      }
    }
    touched = parents;
  }
  tiles.insert({0, 0, 0});
  tiles.insert({0, 1, 0});
  return tiles;
}

/// Smallest power of two in which low..high, rounded outwards, has at most 32767 steps.
double expected_step(double low, double high) {
  double step = kSmallestBorderStepM;
  while (std::ceil(high / step) - std::floor(low / step) > kQuantizedSteps) step *= 2;
  return step;
}

class PlanTest : public ::testing::TestWithParam<std::tuple<int, bool, double>> {
 protected:
  PlanTest()
      : world_(static_cast<std::uint64_t>(std::get<0>(GetParam())), std::get<1>(GetParam()), std::get<2>(GetParam())) {}
  World world_;
};

TEST_P(PlanTest, TilesAreThoseThatPostsTouch) {
  const auto expected = expected_tiles(world_.f.field);
  for (const HeightField& field : {world_.f.field, world_.with_blocks(), world_.with_blocks_on_demand()}) {
    const TilePlan plan(field, kBottom);
    std::set<Position> found;
    for (int level = 0; level <= kBottom; ++level) {
      const auto& tiles = plan.tiles(level);
      for (const TileKey& t : tiles) found.insert({t.level, t.x, t.y});
      EXPECT_TRUE(std::is_sorted(tiles.begin(), tiles.end(), [](const TileKey& a, const TileKey& b) {
        return morton_code(a.x, a.y) < morton_code(b.x, b.y);
      }));
    }
    EXPECT_EQ(found, expected) << (field.blocks != nullptr);
  }
  EXPECT_FALSE(world_.has_made_blocks());
}

TEST_P(PlanTest, CoverageIsThatOfTheCellsPosts) {
  const HeightField& plain = world_.f.field;
  const HeightField with_blocks = world_.with_blocks(), on_demand = world_.with_blocks_on_demand();
  const double width = static_cast<double>(plain.lattice.width());
  const TilePlan plan(plain, kBottom);
  int n_partial = 0;
  for (int level = 0; level <= kBottom; ++level) {
    for (const TileKey& tile : plan.tiles(level)) {
      const double side = static_cast<double>(plain.lattice.tile_side(level));
      bool any = false, all = false;
      for (const double turn : {-width, 0.0, width}) {
        if (plain.wraps && turn != 0) continue;
        const auto r0 = static_cast<std::int64_t>(std::floor((side * tile.y - plain.y0) / plain.dy));
        const auto r1 = static_cast<std::int64_t>(std::ceil((side * (tile.y + 1.0) - plain.y0) / plain.dy));
        const auto c0 = static_cast<std::int64_t>(std::floor((side * tile.x - plain.x0 - turn) / plain.dx));
        const auto c1 = static_cast<std::int64_t>(std::ceil((side * (tile.x + 1.0) - plain.x0 - turn) / plain.dx));
        bool complete = true;
        for (std::int64_t r = r0; r <= r1; ++r) {
          for (std::int64_t c = c0; c <= c1; ++c) {
            const std::int64_t n = plain.n_cols, column = plain.wraps ? ((c % n) + n) % n : c;
            const bool is_post = r >= 0 && r < plain.n_rows && column >= 0 && column < n;
            const bool is_source = is_post && is_of_source(plain.origin_at(r, column));
            any = any || is_source;
            complete = complete && is_source;
          }
        }
        all = all || complete;
      }
      const TileCoverage expected = all ? TileCoverage::kReal : any ? TileCoverage::kPartial : TileCoverage::kFiller;
      ASSERT_EQ(coverage_of(plain, tile), expected) << level << "/" << tile.x << "/" << tile.y;
      ASSERT_EQ(coverage_of(with_blocks, tile), expected) << level << "/" << tile.x << "/" << tile.y;
      ASSERT_EQ(coverage_of(on_demand, tile), expected) << level << "/" << tile.x << "/" << tile.y;
      n_partial += expected == TileCoverage::kPartial;
    }
  }
  EXPECT_GT(n_partial, 0);
  EXPECT_FALSE(world_.has_made_blocks());
}

TEST_P(PlanTest, HeightStepsHoldTheHighestTile) {
  const HeightField& plain = world_.f.field;
  const TilePlan plan(plain, kBottom);
  const double side = static_cast<double>(plain.lattice.tile_side(kBottom));
  const double width = static_cast<double>(plain.lattice.width()), unit = plain.lattice.height_unit_m() + 0.25;
  std::vector<double> expected(kBottom + 1, kSmallestBorderStepM);
  for (int level = 0; level <= kBottom; ++level) {
    for (const TileKey& tile : plan.tiles(level)) {
      double low = plain.base_height_m, high = low;
      for (const TileKey& bottom : plan.tiles(kBottom)) {
        if (bottom.x >> (kBottom - level) != tile.x || bottom.y >> (kBottom - level) != tile.y) continue;
        for (const double turn : {-width, 0.0, width}) {
          const auto r0 = static_cast<std::int64_t>(std::floor((side * bottom.y - plain.y0) / plain.dy));
          const auto r1 = static_cast<std::int64_t>(std::ceil((side * (bottom.y + 1.0) - plain.y0) / plain.dy));
          const auto c0 = static_cast<std::int64_t>(std::floor((side * bottom.x - plain.x0 - turn) / plain.dx));
          const auto c1 = static_cast<std::int64_t>(std::ceil((side * (bottom.x + 1.0) - plain.x0 - turn) / plain.dx));
          for (std::int64_t r = std::max<std::int64_t>(r0, 0); r <= std::min(r1, plain.n_rows - 1); ++r) {
            for (std::int64_t c = std::max<std::int64_t>(c0, 0); c <= std::min(c1, plain.n_cols - 1); ++c) {
              low = std::min(low, plain.height_at(r, c));
              high = std::max(high, plain.height_at(r, c));
            }
          }
        }
      }
      double& step = expected[static_cast<std::size_t>(level)];
      step = std::max(step, expected_step(low - unit, high + unit));
    }
  }
  EXPECT_EQ(height_steps(plain, plan, 0.25), expected);
  EXPECT_EQ(height_steps(world_.with_blocks(), plan, 0.25, 2), expected);
  EXPECT_EQ(height_steps(world_.with_blocks_on_demand(), plan, 0.25, 3), expected);
  EXPECT_FALSE(world_.has_made_blocks());
}

TEST_P(PlanTest, APointLiesOutsideWhereItsNearestPostDoes) {
  const HeightField& f = world_.f.field;
  const std::int64_t width = f.lattice.width();
  int n_outside = 0, n_inside = 0;
  for (std::int64_t k = 0; k < 4000; ++k) {
    // Around the grid, and beyond.
    const auto x =
        (static_cast<std::int64_t>(f.x0 + (1.2 * test::noise(9, k, 0) - 0.1) * static_cast<double>(f.n_cols) * f.dx) +
         width) %
        width;
    const auto y =
        static_cast<std::int64_t>(f.y0 + (1.2 * test::noise(9, k, 1) - 0.1) * static_cast<double>(f.n_rows) * f.dy);
    bool inside = false;
    for_posts(f, [&](std::int64_t r, std::int64_t c, double post_x, double post_y) {
      const double across = std::abs(std::remainder(static_cast<double>(x) - post_x, static_cast<double>(width)));
      const bool nearest = across < f.dx / 2 && std::abs(static_cast<double>(y) - post_y) < f.dy / 2;
      const PostOrigin origin = f.origin_at(r, c);
      inside = inside || (nearest && (is_of_source(origin) || origin == PostOrigin::kFilled));
    });
    ASSERT_EQ(is_outside(f, x, y), !inside) << x << " " << y;
    ++(inside ? n_inside : n_outside);
  }
  EXPECT_GT(n_inside, 100);
  EXPECT_GT(n_outside, 100);
}

INSTANTIATE_TEST_SUITE_P(Worlds, PlanTest,
                         ::testing::Combine(::testing::Values(1, 2, 3, 4), ::testing::Bool(),
                                            ::testing::Values(7.3, 0.6)));

}  // namespace
}  // namespace tind
