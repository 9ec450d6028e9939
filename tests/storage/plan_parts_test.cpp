// SPDX-License-Identifier: GPL-3.0-or-later
// Parts of tind-build plan and of the command line: sizes, shards, spans of time, progress lines, windows of posts.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <limits>
#include <numeric>
#include <string>
#include <vector>

#include "storage/builder/build_arguments.hpp"
#include "storage/builder/duration.hpp"
#include "storage/builder/level_times.hpp"
#include "storage/builder/progress.hpp"
#include "storage/builder/sample_window.hpp"
#include "tests/client_checks/test_raster.hpp"
#include "tests/e2e/program.hpp"

namespace tind::test {
namespace {

using testing::HasSubstr;

TEST(ParseMemory, TakesMegabytesAndGigabytes) {
  EXPECT_EQ(parse_memory("512").value(), std::uint64_t{512} << 20);
  EXPECT_EQ(parse_memory("512M").value(), std::uint64_t{512} << 20);
  EXPECT_EQ(parse_memory("2g").value(), std::uint64_t{2} << 30);
  EXPECT_EQ(parse_memory("64").value(), kLeastMemoryBytes);
}

TEST(ParseMemory, RefusesEverythingElse) {
  for (const char* text : {"", "M", "63", "0", "-512", "1.5G", "512MB", "512 M", "2T", "99999999999999999999G",
                           "18014398509481984", "+512"}) {
    EXPECT_FALSE(parse_memory(text)) << text;
  }
}

TEST(ParseShard, TakesPartsBelowTheirNumber) {
  const auto shard = parse_shard("3/4");
  ASSERT_TRUE(shard);
  EXPECT_EQ(shard->index, 3);
  EXPECT_EQ(shard->count, 4);
  EXPECT_TRUE(parse_shard("65535/65536"));
  for (const char* text : {"", "4/4", "-1/4", "0/0", "1", "1/", "/4", "0/65537", "1/2/3", "a/4", "0x1/4", " 1/4"}) {
    EXPECT_FALSE(parse_shard(text)) << text;
  }
}

TEST(Duration, IsToldInItsTwoLargestUnits) {
  EXPECT_EQ(duration_text(0.2), "1 s");
  EXPECT_EQ(duration_text(59), "59 s");
  EXPECT_EQ(duration_text(725), "12 min 05 s");
  EXPECT_EQ(duration_text(3600), "1 h 00 min");
  EXPECT_EQ(duration_text(86399), "23 h 59 min");
  EXPECT_EQ(duration_text(187200), "2 d 4 h");
  EXPECT_EQ(duration_text(-5), "0 s");
  EXPECT_EQ(duration_text(1e12), "years");
  EXPECT_EQ(duration_text(std::numeric_limits<double>::infinity()), "years");
  EXPECT_EQ(duration_text(std::nan("")), "years");
}

std::string printed(const std::function<void(Progress&)>& work) {
  std::FILE* file = std::tmpfile();
  if (file == nullptr) return "no file";
  {
    Progress progress(file);
    work(progress);
  }
  std::rewind(file);
  std::string text;
  for (int c; (c = std::fgetc(file)) != EOF;) text += static_cast<char>(c);
  std::fclose(file);
  return text;
}

TEST(ProgressLines, AreFewOffATerminal) {
  const std::string text = printed([](Progress& progress) {
    for (int i = 0; i <= 1000; ++i) progress.update(i / 1000.0, i < 500 ? "reading" : "level 3 of 4");
  });
  EXPECT_EQ(count_lines(text), 2u) << text;
  EXPECT_THAT(text, HasSubstr("  0%  ETA ...  reading\n"));
  EXPECT_THAT(text, HasSubstr(" 50%  ETA 1 s  level 3 of 4\n"));
}

TEST(ProgressLines, SayWhatIsKnownAndNeverGoBack) {
  const std::string text = printed([](Progress& progress) {
    progress.update_stage(0, "reading", 0);
    progress.update_stage(0.4, "drainage", 0.5);
    progress.update_left("level 1 of 2", 4000);  // less is done than was thought
    progress.update_left("level 2 of 2", 0);
  });
  EXPECT_EQ(text,
            "  0%  ETA ...  reading\n"
            " 40%  ETA ...  drainage, 1 s more\n"
            " 40%  ETA 1 h 06 min  level 1 of 2\n"
            "100%  ETA 0 s  level 2 of 2\n");
}

// Seconds that a build's levels took, without what came before: what the ETA says while they are built must be near
// what they take, on data where each level costs more than the one before and where all cost alike.
TEST(LevelTimes, AreNearTheTruthOnRealBuilds) {
  const std::vector<std::vector<double>> builds = {
      {0.01, 0.01, 0.03, 0.06, 0.17, 0.30, 0.39, 0.58, 0.95, 1.61,
       2.61},                                // 23 million posts to 10 m, half of all at E_10
      {3.1, 3.3, 3.6, 4.2, 11, 13, 14, 21},  // a planet of 933 million posts to 50 m
      {0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8}};
  for (const auto& seconds : builds) {
    LevelTimes times(static_cast<int>(seconds.size()));
    double left = std::accumulate(seconds.begin(), seconds.end(), 0.0);
    const double all = left;
    for (const double s : seconds) {
      for (const double done : {0.25, 0.5, 0.75}) {
        const double really = left - done * s;
        if (really < 0.7 * all) {  // some levels tell
          EXPECT_GT(times.left(done, done * s), 0.5 * really) << done << " of " << s;
          EXPECT_LT(times.left(done, done * s), 2 * really) << done << " of " << s;
        }
      }
      times.finish_level(s);
      left -= s;
    }
    EXPECT_EQ(times.left(0, 0), 0);
  }
}

class SampleWindow : public testing::Test {
 protected:
  /// A raster whose post in row r, column c (from the north-west) is r * 1000 + c metres high, at 10 E 46 N.
  RasterMosaic mosaic(const std::string& name, double west_deg = 10, std::optional<double> nodata = {}) {
    RasterPlan plan;
    plan.n = 20;
    plan.west_deg = west_deg;
    plan.nodata = nodata;
    plan.height_m = [](int r, int c) { return r * 1000 + c; };
    write_raster(folder_.file(name), plan);
    return RasterMosaic::open({folder_.file(name)}, {}).value();
  }
  ScratchFolder folder_;
};

TEST_F(SampleWindow, HoldsThePostsOfItsRange) {
  const RasterMosaic m = mosaic("a.tif");
  const auto sample = read_posts(m, {5, 3, 4, 6});
  ASSERT_TRUE(sample) << sample.error().message;
  for (int r = 0; r < 4; ++r) {
    for (int c = 0; c < 6; ++c) {
      EXPECT_EQ(sample->heights_m[static_cast<std::size_t>(r * 6 + c)], (19 - 5 - r) * 1000 + 3 + c);
    }
  }
  EXPECT_EQ(sample->signs.posts, 24u);
  EXPECT_EQ(sample->signs.voids, 0u);
  EXPECT_EQ(sample->signs.lowest_m, 11003);
  EXPECT_EQ(sample->signs.highest_m, 14008);
  EXPECT_TRUE(sample->signs.whole_metres);
  EXPECT_EQ(sample->roughness_m, 0);
}

TEST_F(SampleWindow, IsVoidOutsideTheMosaicButCountsOnlyItsPosts) {
  const RasterMosaic m = mosaic("a.tif", 10, 19000);
  const auto sample = read_posts(m, {-2, 18, 4, 5});
  ASSERT_TRUE(sample) << sample.error().message;
  EXPECT_EQ(sample->signs.posts, 4u);  // rows 0 and 1, columns 18 and 19
  EXPECT_EQ(sample->signs.voids, 0u);
  EXPECT_TRUE(std::isnan(sample->heights_m[0]));
  EXPECT_EQ(sample->heights_m[2 * 5], 19018);
  const auto corner = read_posts(m, {0, 0, 1, 1});
  EXPECT_EQ(corner->signs.voids, 1u);
  EXPECT_EQ(corner->signs.heights, 0u);
}

TEST_F(SampleWindow, AveragesSourcesAndSaysThatTheyDiffer) {
  RasterPlan plan;
  plan.n = 20;
  plan.height_m = [](int, int) { return 100; };
  write_raster(folder_.file("low.tif"), plan);
  plan.west_deg = 10.1;
  plan.height_m = [](int, int) { return 104; };
  write_raster(folder_.file("high.tif"), plan);
  const RasterMosaic m = RasterMosaic::open({folder_.file("low.tif"), folder_.file("high.tif")}, {}).value();
  const auto sample = read_posts(m, {0, 8, 1, 4});
  ASSERT_TRUE(sample) << sample.error().message;
  EXPECT_THAT(sample->heights_m, testing::ElementsAre(100, 100, 102, 102));
  EXPECT_EQ(sample->signs.overlapping, 2u);
  EXPECT_EQ(sample->signs.disagreeing, 2u);
  EXPECT_EQ(sample->signs.largest_disagreement_m, 4);
}

TEST_F(SampleWindow, FindsZerosBesideVoids) {
  RasterPlan plan;
  plan.n = 20;
  plan.nodata = -1;
  plan.height_m = [](int r, int c) { return c == 4 ? -1 : c == 5 ? 0 : 500 + r; };
  write_raster(folder_.file("zeros.tif"), plan);
  const RasterMosaic m = RasterMosaic::open({folder_.file("zeros.tif")}, {}).value();
  const auto sample = read_posts(m, {0, 0, 10, 10});
  ASSERT_TRUE(sample) << sample.error().message;
  EXPECT_EQ(sample->signs.zeros, 10u);
  EXPECT_EQ(sample->signs.zeros_beside_voids, 10u);
  EXPECT_EQ(sample->signs.lowest_other_m, 510);
  PostSigns sum;
  sum.add(sample->signs);
  sum.add(read_posts(m, {0, 6, 10, 10})->signs);
  EXPECT_EQ(sum.zeros_beside_voids, 10u);
  EXPECT_EQ(sum.lowest_m, 0);
  EXPECT_EQ(sum.lowest_other_m, 510);
}

TEST_F(SampleWindow, FieldHasTheHeightsOfTheWholeGridAtTheSamePlaces) {
  const RasterMosaic m = mosaic("a.tif");
  Lattice lattice;
  lattice.level = 8;
  lattice.height_exponent = 4;
  HeightGridOptions options;
  options.scratch_dir = folder_.path().string();
  const auto grid = HeightGrid::load(m, lattice, options, {});
  ASSERT_TRUE(grid) << grid.error().message;
  const PostRange range{4, 5, 10, 9};
  auto sample = read_posts(m, range);
  const WindowField first(m, lattice, range, std::move(*sample), 0, 64);
  // The outermost posts may be rounded out of the window.
  for (std::int64_t r = 1; r + 1 < range.n_rows; ++r) {
    for (std::int64_t c = 1; c + 1 < range.n_cols; ++c) {
      const HeightField& f = first.field();
      EXPECT_EQ(f.origin_at(r, c), PostOrigin::kSource);
      EXPECT_NEAR(f.sample_m(f.post_x(c), f.post_y(r)), grid->field().sample_m(f.post_x(c), f.post_y(r)), 1e-3);
    }
  }
}

TEST_F(SampleWindow, PostsAroundATileCoverIt) {
  const RasterMosaic m = mosaic("a.tif");
  Lattice lattice;
  lattice.level = 12;
  const TileKey tile{11, 2162, 1546};  // 10.02 E, 45.88 N
  const PostRange range = posts_around(m, lattice, tile);
  const double side = 180.0 / 2048;
  EXPECT_LE(m.west_deg + static_cast<double>(range.col) * m.lon_spacing_deg, side * tile.x - 180);
  EXPECT_GE(m.west_deg + static_cast<double>(range.col + range.n_cols - 1) * m.lon_spacing_deg,
            side * (tile.x + 1) - 180);
  EXPECT_LE(m.south_deg + static_cast<double>(range.row) * m.lat_spacing_deg, side * tile.y - 90);
  EXPECT_GE(m.south_deg + static_cast<double>(range.row + range.n_rows - 1) * m.lat_spacing_deg,
            side * (tile.y + 1) - 90);
  EXPECT_LT(range.n_cols, 9 + 8);
}

}  // namespace
}  // namespace tind::test
