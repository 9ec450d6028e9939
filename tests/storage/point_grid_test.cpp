// SPDX-License-Identifier: GPL-3.0-or-later
// Points through PointSource and PointGrid: kept points, blocks, the grid between them, and what must not matter.
#include "storage/readers/point_grid.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <random>
#include <tuple>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/delaunay_surface.hpp"
#include "tests/storage/test_las.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;
using test::LasTestPoint;
using test::LasTestSpec;
using ::testing::HasSubstr;

using HeightAt = std::function<double(double lon_deg, double lat_deg)>;

/// A lattice whose bottom tile has 256 spacings of about a metre a side.
Lattice test_lattice() {
  Lattice lattice;
  lattice.level = 17;
  lattice.height_exponent = 8;
  return lattice;
}

class PointGridTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-point-grid-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { fs::remove_all(folder_); }

  /// A geographic LAS file, coordinates to 1e-7 degrees.
  std::string write(const std::string& name, const std::vector<LasTestPoint>& points, double west_deg = 9) {
    LasTestSpec spec;
    spec.scale = {1e-7, 1e-7, 0.001};
    spec.offset = {west_deg, 47, 0};
    spec.geo_keys = test::keys_of_geographic(4326, 0);
    const auto bytes = make_las(spec, points);
    std::ofstream(folder_ / name, std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    return (folder_ / name).string();
  }

  /// About a point a square metre over 0.002 x 0.0015 degrees from (9, 47).
  static std::vector<LasTestPoint> scattered(std::uint32_t seed, const HeightAt& height, std::size_t n = 25000) {
    std::mt19937 random(seed);
    std::vector<LasTestPoint> points;
    for (std::size_t i = 0; i < n; ++i) {
      const double lon = 9 + 1e-7 * static_cast<double>(random() % 20001),
                   lat = 47 + 1e-7 * static_cast<double>(random() % 15001);
      points.push_back({lon, lat, height(lon, lat), 2, false});
    }
    return points;
  }
  static double hills(double lon, double lat) {
    return 500 + 20 * std::sin((lon - 9) * 30000) * std::cos((lat - 47) * 20000) + std::fmod(lon * 1e7, 3.0);
  }

  Result<PointGrid> load(const std::vector<std::string>& paths, const PointGridOptions& grid_options = {},
                         const PointOptions& options = {}) {
    auto source = PointSource::open(paths, options);
    if (!source) return tl::unexpected(source.error());
    PointGridOptions o = grid_options;
    o.scratch_dir = folder_.string();
    return PointGrid::load(*source, test_lattice(), o, {});
  }
  std::string message(const std::vector<std::string>& paths, const PointGridOptions& grid_options = {},
                      const PointOptions& options = {}) {
    const auto grid = load(paths, grid_options, options);
    return grid ? "" : grid.error().message;
  }

  fs::path folder_;
};

/// Everything that the rest of tind reads of a field.
void expect_same(const HeightField& a, const HeightField& b) {
  ASSERT_EQ(std::tie(a.n_rows, a.n_cols, a.x0, a.y0, a.dx, a.dy), std::tie(b.n_rows, b.n_cols, b.x0, b.y0, b.dx, b.dy));
  const auto n = static_cast<std::size_t>(a.n_rows * a.n_cols);
  EXPECT_EQ(std::memcmp(a.heights_m, b.heights_m, n * sizeof(float)), 0);
  EXPECT_EQ(std::memcmp(a.origins, b.origins, n), 0);
  const PointBlocks &p = a.points, &q = b.points;
  ASSERT_EQ(std::tie(p.n_rows, p.n_cols, p.x0, p.y0, p.side), std::tie(q.n_rows, q.n_cols, q.x0, q.y0, q.side));
  const auto n_blocks = static_cast<std::size_t>(p.n_rows * p.n_cols);
  ASSERT_EQ(std::memcmp(p.first, q.first, (n_blocks + 1) * sizeof(std::uint64_t)), 0);
  for (std::uint64_t i = 0; i < p.first[n_blocks]; ++i) {
    const PointPost &s = p.posts[i], &t = q.posts[i];
    ASSERT_EQ(std::tie(s.x, s.y, s.height_m), std::tie(t.x, t.y, t.height_m)) << i;
  }
}

std::uint64_t n_points(const HeightField& f) { return f.points.first[f.points.n_rows * f.points.n_cols]; }

TEST_F(PointGridTest, LoadingStopsWhenItIsToldTo) {
  std::atomic<bool> cancel{false};
  const auto path = write("a.las", scattered(1, hills));
  auto source = PointSource::open({path}, {});
  ASSERT_TRUE(source) << source.error().message;
  PointGridOptions options;
  options.scratch_dir = folder_.string();
  options.cancel = &cancel;
  // At every stage that reports its progress.
  int n_calls = 0;
  EXPECT_TRUE(PointGrid::load(*source, test_lattice(), options, [&](double) { ++n_calls; }));
  ASSERT_GT(n_calls, 2);
  for (int stop_at = 0; stop_at < n_calls - 1; ++stop_at) {
    cancel = stop_at == 0;
    int n = 0;
    const auto grid = PointGrid::load(*source, test_lattice(), options, [&](double) { cancel = ++n >= stop_at; });
    ASSERT_FALSE(grid) << stop_at;
    EXPECT_EQ(grid.error().kind, ErrorKind::kInterrupted);
  }
}

TEST_F(PointGridTest, PlaneIsRecoveredAtEveryPostAmongThePoints) {
  const auto plane = [](double lon, double lat) { return 300 + (lon - 9) * 20000 - (lat - 47) * 15000; };
  const auto grid = load({write("a.las", scattered(1, plane))}, {.base_height_m = 10, .falloff_posts = 8});
  ASSERT_TRUE(grid) << grid.error().message;
  const HeightField& f = grid->field();
  std::uint64_t n_inside = 0;
  for (std::int64_t r = 0; r < f.n_rows; ++r) {
    for (std::int64_t c = 0; c < f.n_cols; ++c) {
      const double lon = f.post_x(c) * f.lattice.step_deg() - 180, lat = f.post_y(r) * f.lattice.step_deg() - 90;
      const bool inside = lon > 9.00002 && lon < 9.00198 && lat > 47.00002 && lat < 47.00148;
      const bool outside = lon < 9 - 0.00002 || lon > 9.00202 || lat < 47 - 0.00002 || lat > 47.00152;
      if (inside) {
        ASSERT_EQ(f.origin_at(r, c), PostOrigin::kInterpolated) << r << " " << c;
        ASSERT_NEAR(f.height_at(r, c), plane(lon, lat), 0.01) << r << " " << c;
        ++n_inside;
      }
      if (outside) {
        ASSERT_NE(f.origin_at(r, c), PostOrigin::kInterpolated) << r << " " << c;
      }
      if (r == 0 || c == 0 || r == f.n_rows - 1 || c == f.n_cols - 1) {
        ASSERT_EQ(f.origin_at(r, c), PostOrigin::kBase);
        ASSERT_EQ(f.height_at(r, c), 10);
      }
    }
  }
  EXPECT_GT(n_inside, 20000u);
  EXPECT_EQ(grid->counts().filled, 0u);
  EXPECT_GT(grid->counts().falloff, 0u);
}

TEST_F(PointGridTest, BlocksHoldEveryPointInOrder) {
  const auto points = scattered(2, hills);
  const auto grid = load({write("a.las", points)});
  ASSERT_TRUE(grid) << grid.error().message;
  const HeightField& f = grid->field();
  const PointBlocks& b = f.points;
  // The rule again, by other means: the lowest of the points at one rounded position.
  std::map<std::pair<std::int64_t, std::int64_t>, float> lowest;
  for (const LasTestPoint& p : points) {
    const double lon = std::lround((p.x - 9) / 1e-7) * 1e-7 + 9, lat = std::lround((p.y - 47) / 1e-7) * 1e-7 + 47;
    const auto z = static_cast<float>(std::lround(p.z / 0.001) * 0.001);
    const std::pair key(std::llround((lat + 90) / f.lattice.step_deg()),
                        std::llround((lon + 180) / f.lattice.step_deg()));
    const auto [at, is_new] = lowest.try_emplace(key, z);
    if (!is_new) at->second = std::min(at->second, z);
  }
  EXPECT_EQ(grid->counts().kept, lowest.size());
  EXPECT_EQ(grid->counts().kept, n_points(f));
  EXPECT_EQ(grid->counts().kept + grid->counts().duplicates, points.size());
  for (std::int64_t r = 0; r < b.n_rows; ++r) {
    for (std::int64_t c = 0; c < b.n_cols; ++c) {
      std::pair<std::int64_t, std::int64_t> last(0, 0);
      for (const PointPost& p : b.block(r, c)) {
        ASSERT_GE(p.x, b.x0 + static_cast<double>(c) * b.side);
        ASSERT_LT(p.x, b.x0 + static_cast<double>(c + 1) * b.side);
        ASSERT_GE(p.y, b.y0 + static_cast<double>(r) * b.side);
        ASSERT_LT(p.y, b.y0 + static_cast<double>(r + 1) * b.side);
        const std::pair<std::int64_t, std::int64_t> key(std::llround(p.y), std::llround(p.x));
        ASSERT_LT(last, key);
        last = key;
        const auto at = lowest.find(key);
        ASSERT_NE(at, lowest.end());
        ASSERT_EQ(p.height_m, at->second);
        ASSERT_EQ(b.find(key.second, key.first), &p);
        lowest.erase(at);  // so no position comes twice
      }
    }
  }
  EXPECT_TRUE(lowest.empty());
}

TEST_F(PointGridTest, OfPointsAtOneLatticePositionTheLowestIsKept) {
  auto points = scattered(3, [](double, double) { return 100.0; });
  const LasTestPoint at = points[500];
  points[501] = points[502] = points[503] = at;
  points[501].z = 90;
  points[502].z = 95;
  const auto grid = load({write("a.las", points)});
  ASSERT_TRUE(grid);
  const HeightField& f = grid->field();
  const auto x = std::llround((at.x + 180) / f.lattice.step_deg()),
             y = std::llround((at.y + 90) / f.lattice.step_deg());
  const PointPost* post = f.points.find(x, y);
  ASSERT_NE(post, nullptr);
  EXPECT_EQ(post->height_m, 90);
  EXPECT_EQ(f.lattice_height(x, y), 90 * 256);
  EXPECT_GE(grid->counts().duplicates, 3u);
  EXPECT_THAT(grid->notes(), ::testing::Contains(HasSubstr("lie within a lattice step of a lower one")));
}

TEST_F(PointGridTest, OrderFilesMemoryAndThreadsDoNotMatter) {
  auto points = scattered(4, hills);
  const auto whole = load({write("a.las", points)});
  ASSERT_TRUE(whole) << whole.error().message;
  std::shuffle(points.begin(), points.end(), std::mt19937(5));
  const auto shuffled = load({write("b.las", points)});
  ASSERT_TRUE(shuffled);
  expect_same(whole->field(), shuffled->field());
  const std::size_t half = points.size() / 2;
  const auto one = write("c.las", {points.begin(), points.begin() + static_cast<std::ptrdiff_t>(half)});
  const auto two = write("d.las", {points.begin() + static_cast<std::ptrdiff_t>(half), points.end()});
  const auto split = load({two, one});
  ASSERT_TRUE(split);
  expect_same(whole->field(), split->field());
  // A file of 500 kB with room for 1024 points at a time, and three threads.
  PointGridOptions small;
  small.memory_bytes = 1;
  small.threads = 3;
  PointOptions small_source;
  small_source.memory_bytes = 1;
  const auto frugal = load({(folder_ / "b.las").string()}, small, small_source);
  ASSERT_TRUE(frugal);
  expect_same(whole->field(), frugal->field());
}

TEST_F(PointGridTest, EveryKeptPointLiesBetweenPostsWithData) {
  // Clusters, a line and a lone point: most have no triangle.
  auto points = scattered(6, hills, 4000);
  for (int i = 0; i < 100; ++i) points.push_back({9.004 + 1e-6 * i, 47.001 + 5e-5 * i, 700, 2, false});
  points.push_back({9.006, 47.0002, 800, 2, false});
  const auto grid = load({write("a.las", points)}, {.falloff_posts = 5});
  ASSERT_TRUE(grid) << grid.error().message;
  const HeightField& f = grid->field();
  for (std::uint64_t i = 0; i < n_points(f); ++i) {
    const PointPost& p = f.points.posts[i];
    ASSERT_TRUE(f.covers(p.x, p.y));
    const auto c = static_cast<std::int64_t>(std::floor((p.x - f.x0) / f.dx));
    const auto r = static_cast<std::int64_t>(std::floor((p.y - f.y0) / f.dy));
    for (const std::int64_t rr : {r, r + 1}) {
      for (const std::int64_t cc : {c, c + 1}) ASSERT_EQ(f.origin_at(rr, cc), PostOrigin::kInterpolated) << i;
    }
    if (p.height_m == 800) {
      EXPECT_EQ(f.sample_m(p.x, p.y), 800);
    }
  }
}

TEST_F(PointGridTest, WindowsGiveWhatOneTriangulationWould) {
  // Several windows; then one with so many points that it is taken in quarters.
  for (const auto& [n, spacing_m] : {std::pair<std::size_t, double>{25000, 0.4}, {1070000, 1.0}}) {
    PointOptions options;
    options.spacing_m = spacing_m;
    const auto grid = load({write("a.las", scattered(11, hills, n))}, {}, options);
    ASSERT_TRUE(grid) << grid.error().message;
    const HeightField& f = grid->field();
    std::vector<SurfaceSite> sites;
    for (std::uint64_t i = 0; i < n_points(f); ++i) {
      const PointPost& p = f.points.posts[i];
      sites.push_back({(p.x - f.x0) / f.dx, (p.y - f.y0) / f.dy, p.height_m});
    }
    std::vector<float> heights(static_cast<std::size_t>(f.n_rows * f.n_cols));
    interpolate_posts(sites, {0, 0, 1, f.n_rows, f.n_cols}, 16, heights);
    std::int64_t n_compared = 0;
    for (std::int64_t i = 0; i < f.n_rows * f.n_cols; ++i) {
      const float expected = heights[static_cast<std::size_t>(i)];
      if (std::isnan(expected)) continue;
      ASSERT_EQ(f.heights_m[i], expected) << i;
      ASSERT_EQ(f.origins[i], PostOrigin::kInterpolated);
      ++n_compared;
    }
    EXPECT_GT(n_compared, 20000);
    EXPECT_LE(static_cast<std::uint64_t>(n_compared), grid->counts().interpolated);
  }
}

TEST_F(PointGridTest, WideHolesAreFilledAndHaveNoPoints) {
  const auto all = scattered(7, [](double lon, double) { return 100 + (lon - 9) * 10000; });
  std::vector<LasTestPoint> ring;
  for (const auto& p : all) {
    if (std::abs(p.x - 9.001) > 0.0005 || std::abs(p.y - 47.00075) > 0.0005) ring.push_back(p);
  }
  const auto grid = load({write("a.las", ring)});
  ASSERT_TRUE(grid) << grid.error().message;
  EXPECT_GT(grid->counts().filled, 3000u);
  const HeightField& f = grid->field();
  const auto c = std::llround(((9.001 + 180) / f.lattice.step_deg() - f.x0) / f.dx);
  const auto r = std::llround(((47.00075 + 90) / f.lattice.step_deg() - f.y0) / f.dy);
  EXPECT_EQ(f.origin_at(r, c), PostOrigin::kFilled);
  EXPECT_NEAR(f.height_at(r, c), 110, 0.5);
}

TEST_F(PointGridTest, PointsMayCrossLongitude180) {
  // The same points at 9 degrees and around 180, a whole number of spacings further: the same field but for x0.
  const auto points = scattered(8, hills);
  auto far = points;
  for (auto& p : far) {
    p.x = p.x - 9 + 179.999;
    if (p.x >= 180) p.x -= 360;
  }
  LasTestSpec spec;
  spec.scale = {1e-7, 1e-7, 0.001};
  spec.geo_keys = test::keys_of_geographic(4326, 0);
  const auto bytes = make_las(spec, far);
  std::ofstream(folder_ / "f.las", std::ios::binary)
      .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  const auto here = load({write("a.las", points)}), there = load({(folder_ / "f.las").string()});
  ASSERT_TRUE(here) << here.error().message;
  ASSERT_TRUE(there) << there.error().message;
  const HeightField &f = here->field(), &g = there->field();
  EXPECT_EQ(n_points(f), n_points(g));
  const double width = static_cast<double>(g.lattice.width());
  EXPECT_LT(g.x0, width);
  EXPECT_GT(g.post_x(g.n_cols - 1), width);
  // Heights on both sides of the line, asked for by either name.
  for (const double lon : {179.9995, -179.9999, -179.9995}) {
    const double x = (lon + 180) / g.lattice.step_deg(), y = (47.0007 + 90) / g.lattice.step_deg();
    EXPECT_GT(g.sample_m(x, y), 400);
    EXPECT_NEAR(g.sample_m(x, y), g.sample_m(x + width, y), 1e-3);
  }
}

TEST_F(PointGridTest, PointsJustEastOfLongitude180HaveARimWestOfIt) {
  auto points = scattered(9, hills);
  for (auto& p : points) p.x += -180 - 9 + 1e-5;
  const auto grid = load({write("a.las", points, -180)});
  ASSERT_TRUE(grid) << grid.error().message;
  const HeightField& f = grid->field();
  EXPECT_GE(f.x0, 0);
  EXPECT_LT(f.x0, static_cast<double>(f.lattice.width()));
  EXPECT_GE(f.points.posts[0].x, static_cast<double>(f.lattice.width()));
  const auto& p = f.points.posts[n_points(f) / 2];
  EXPECT_EQ(f.lattice_height(std::llround(p.x) - f.lattice.width(), std::llround(p.y)),
            f.lattice.height_from_m(static_cast<double>(p.height_m)));
}

TEST_F(PointGridTest, WhatCannotBeGriddedIsNamed) {
  const auto path = write("a.las", scattered(10, hills));
  EXPECT_THAT(message({path}, {.falloff_posts = 0}), HasSubstr("at least 1 post"));
  EXPECT_THAT(message({path}, {.base_height_m = 1e6}), HasSubstr("base height"));
  const auto text = [&](const std::string& name, const std::string& lines) {
    std::ofstream(folder_ / name) << lines;
    return (folder_ / name).string();
  };
  std::string world, polar, apart;
  for (int i = 0; i < 1000; ++i) {
    world += fmt::format("{} {} 5\n", -180 + 9 * (i % 40), -80 + 6.5 * (i / 40));
    polar += fmt::format("{} {} 5\n", 10 + 1e-3 * (i % 30), 90 - 1e-5 * (i / 30));
    apart += fmt::format("{:.6f} {:.6f} 5\n", (i % 2 == 0 ? 10 : 40) + 1e-5 * (i / 2 % 20), 20 + 1e-5 * (i / 40));
  }
  EXPECT_THAT(message({text("w.xyz", world)}), HasSubstr("w.xyz: its points reach all around the globe"));
  EXPECT_THAT(message({text("p.xyz", polar)}), HasSubstr("p.xyz: its points reach a pole"));
  PointOptions fine;
  fine.spacing_m = 0.01;
  EXPECT_THAT(message({text("s.xyz", apart)}, {}, fine), HasSubstr("lie scattered over"));
  fine.spacing_m = 1e-6;
  EXPECT_THAT(message({path}, {}, fine), HasSubstr("too small; give --spacing M"));
  const auto source = PointSource::open({path}, {});
  ASSERT_TRUE(source);
  const auto grid = PointGrid::load(*source, test_lattice(), {.scratch_dir = (folder_ / "none").string()}, {});
  ASSERT_FALSE(grid);
  EXPECT_EQ(grid.error().kind, ErrorKind::kIo);
}

TEST_F(PointGridTest, ShorterFalloffWhereThereIsNoRoom) {
  std::string lines;
  for (int i = 0; i < 1000; ++i) lines += fmt::format("{} {} 900\n", -170 + 8.5 * (i % 40), -60 + 5 * (i / 40));
  std::ofstream(folder_ / "w.xyz") << lines;
  const auto grid = load({(folder_ / "w.xyz").string()});
  ASSERT_TRUE(grid) << grid.error().message;
  EXPECT_THAT(grid->notes(), ::testing::Contains(HasSubstr("posts instead of 64")));
  const HeightField& f = grid->field();
  for (std::int64_t r = 0; r < f.n_rows; ++r) EXPECT_EQ(f.height_at(r, 0), 0);
}

TEST_F(PointGridTest, RealFilesKeepTheirGroundPoints) {
  const fs::path folder = fs::path(TIND_SHARED_DATA) / "lidar";
  if (!fs::exists(folder)) GTEST_SKIP() << "needs " << folder;
  for (const auto& [name, n, low, high] :
       {std::tuple{"autzen_trim.las", 26107u, 123.8, 132.4}, std::tuple{"Topography.las", 8159u, 788.9, 830.0}}) {
    const auto grid = load({(folder / name).string()});
    ASSERT_TRUE(grid) << grid.error().message;
    const HeightField& f = grid->field();
    EXPECT_EQ(grid->counts().kept + grid->counts().duplicates, n);
    double sum2 = 0;
    for (std::uint64_t i = 0; i < n_points(f); ++i) {
      const PointPost& p = f.points.posts[i];
      ASSERT_GT(p.height_m, low);
      ASSERT_LT(p.height_m, high);
      const double off = f.sample_m(p.x, p.y) - static_cast<double>(p.height_m);
      sum2 += off * off;
    }
    // The grid between the points is close to them.
    EXPECT_LT(std::sqrt(sum2 / static_cast<double>(n_points(f))), 0.2) << name;
  }
}

}  // namespace
}  // namespace tind
