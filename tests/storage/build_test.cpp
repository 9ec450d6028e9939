// SPDX-License-Identifier: GPL-3.0-or-later
// Tiny worlds as text (ESRI ASCII grids) through the whole builder, then looked at through the store alone.
#include "storage/builder/build.hpp"

#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <set>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/assembler.hpp"
#include "storage/piece_blob.hpp"
#include "storage/tile_store.hpp"
#include "storage/zstd_codec.hpp"
#include "tests/support/test_field.hpp"
#include "tests/support/test_tile.hpp"

namespace tind::test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

/// A built file and all its tiles, read from scratch.
struct Pyramid {
  Manifest manifest;
  std::map<std::tuple<int, std::uint32_t, std::uint32_t>, VirtualNode> tiles;

  const VirtualNode& at(int level, std::uint32_t x, std::uint32_t y) const { return tiles.at({level, x, y}); }
};

class BuildTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-build-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { fs::remove_all(folder_); }

  std::string path(const std::string& name) const { return (folder_ / name).string(); }

  /// Posts at west + c * spacing, south + r * spacing; row 0 is the southernmost.
  std::string write_grid(const std::string& name, double west, double south, double spacing, int n_rows, int n_cols,
                         const HeightAt& height) const {
    std::string text = fmt::format("ncols {}\nnrows {}\nxllcenter {}\nyllcenter {}\ncellsize {}\nNODATA_value -9999\n",
                                   n_cols, n_rows, west, south, spacing);
    for (int r = n_rows - 1; r >= 0; --r) {
      for (int c = 0; c < n_cols; ++c) text += fmt::format("{:.2f} ", height(r, c));
      text += '\n';
    }
    std::ofstream(path(name)) << text;
    return path(name);
  }
  /// Mountains of 64 x 80 posts, 0.001 degrees apart, with a void.
  std::string write_mountains(const std::string& name = "mountains.asc") const {
    return write_grid(name, 10.0003, 45.0001, 0.001, 64, 80, [rough = rough_terrain(3, 1500)](auto r, auto c) {
      return r > 20 && r < 26 && c > 30 && c < 34 ? -9999 : rough(r, c);
    });
  }

  BuildOptions options(std::vector<std::string> inputs, const std::string& output, int threads = 2) const {
    BuildOptions o;
    o.source.inputs = std::move(inputs);
    o.output = path(output);
    o.threads = threads;
    o.falloff_posts = 12;
    o.levels.finest_m = 12;  // level 13, tiles of 22 posts
    return o;
  }
  static Result<BuildReport> build(const BuildOptions& o) {
    Progress silent(nullptr);
    return build_pyramid(o, silent);
  }
  std::string bytes_of(const std::string& name) const {
    std::ifstream in(path(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  std::set<std::string> files() const {
    std::set<std::string> names;
    for (const auto& entry : fs::directory_iterator(folder_)) names.insert(entry.path().filename().string());
    return names;
  }

  /// Reads everything back; each failure to do so is a test failure.
  Pyramid read(const std::string& name) const {
    Pyramid p;
    const auto store = TileStore::open(path(name));
    EXPECT_TRUE(store) << store.error().message;
    const auto snapshot = store->snapshot();
    const auto record = [&](const PieceKey& key) {
      const auto value = snapshot->find(key);
      EXPECT_TRUE(value) << int{key.level} << ' ' << static_cast<int>(key.kind) << ' ' << key.i << ' ' << key.j;
      return value ? unpack_value(*value).value() : Bytes();
    };
    p.manifest = decode_manifest(unpack_value(*snapshot->find_manifest()).value()).value();
    for (const LevelInfo& level : p.manifest.levels) {
      for (const TileRun& run : level.rows) {
        for (std::uint32_t x = run.x_first; x <= run.x_last; ++x) {
          const TileKey key{static_cast<std::uint8_t>(level.level), x, run.y};
          const auto keys = pieces_of(key);
          TilePieces pieces;
          for (std::size_t b = 0; b < 4; ++b) {
            pieces.corners[b] = decode_corner(record(keys[2 * b])).value();
            pieces.edges[b] = decode_edge(record(keys[2 * b + 1])).value();
          }
          pieces.body = decode_body(record(keys[8])).value();
          EXPECT_EQ(pieces.body.stats.coverage, run.coverage);
          auto node = assemble(p.manifest.lattice, key, std::move(pieces));
          EXPECT_TRUE(node) << node.error().message;
          p.tiles.emplace(std::tuple(level.level, x, run.y), std::move(*node));
        }
      }
    }
    return p;
  }

  fs::path folder_;
};

std::size_t ring_size(const VirtualNode& node) {
  return std::size_t{4} + node.n_side[0] + node.n_side[1] + node.n_side[2] + node.n_side[3];
}

using Point = std::tuple<std::int64_t, std::int64_t, std::int32_t>;

/// Global positions and heights of border b in stored direction. X is not wrapped.
std::vector<Point> side_of(const Pyramid& p, const VirtualNode& node, int b) {
  const std::int64_t side = p.manifest.lattice.tile_side(node.key.level);
  std::vector<Point> out;
  for (std::size_t k = 0; k < node.vertices.size() && k < ring_size(node); ++k) {
    const LocalVertex& v = node.vertices[k];
    const bool on = b == 0 ? v.y == 0 : b == 1 ? v.x == side : b == 2 ? v.y == side : v.x == 0;
    if (on) {
      out.emplace_back(side * node.key.x + v.x, side * node.key.y + v.y, v.z);
    }
  }
  std::sort(out.begin(), out.end());
  return out;
}

/// What must hold in any pyramid: siblings, shared borders, nested borders, areas, tolerances and counts.
void expect_sound(const Pyramid& p) {
  const Lattice& lattice = p.manifest.lattice;
  std::map<std::tuple<std::int64_t, std::int64_t>, std::int32_t> heights;  // of border vertices, over all levels
  for (const LevelInfo& level : p.manifest.levels) {
    const int l = level.level;
    const std::uint32_t n_x = TileKey::count_x(l);
    std::uint64_t n_tiles = 0, n_triangles = 0, n_posts = 0, n_interior = 0;
    std::array<std::uint64_t, 3> n_coverage{};
    double worst = 0;
    std::set<std::tuple<std::int64_t, std::int64_t>> border_vertices;
    for (const auto& [id, node] : p.tiles) {
      if (node.key.level != l) continue;
      const TileKey key = node.key;
      ++n_tiles;
      ++n_coverage[static_cast<std::size_t>(node.stats.coverage)];
      n_triangles += node.triangles.size();
      n_posts += node.stats.n_posts;
      worst = std::max<double>(worst, node.stats.max_error_m);
      const Int128 side = lattice.tile_side(l);
      EXPECT_TRUE(doubled_area({node.vertices, node.triangles}) == 2 * side * side);
      n_interior += node.vertices.size() - ring_size(node);
      for (int b = 0; b < 4; ++b) {
        for (const auto& [unwrapped_x, y, z] : side_of(p, node, b)) {
          const std::int64_t x = unwrapped_x % lattice.width();
          const bool pole = y == 0 || y == lattice.height();
          const bool is_corner = x % lattice.tile_side(l) == 0;
          border_vertices.insert({pole && is_corner ? 0 : x, y});
          // One height a point, on all tiles of all levels that have it.
          const auto height = heights.insert({{pole ? 0 : x, y}, z}).first->second;
          EXPECT_EQ(height, z) << l << ": " << x << ' ' << y;
        }
      }
      const auto neighbour = p.tiles.find({l, (key.x + 1) % n_x, key.y});
      if (neighbour != p.tiles.end()) {
        auto east = side_of(p, node, 1);
        for (auto& [x, y, z] : east) x %= lattice.width();
        EXPECT_EQ(east, side_of(p, neighbour->second, 3));
      }
      if (l > 0) {
        EXPECT_TRUE(p.tiles.contains({l - 1, key.x / 2, key.y / 2}));
        for (int c = 0; c < 4; ++c)
          EXPECT_TRUE(p.tiles.contains({l, key.parent().child(c).x, key.parent().child(c).y}));
        // P_{L-1} is a subset of P_L.
        const VirtualNode& parent = p.at(l - 1, key.x / 2, key.y / 2);
        for (int b = 0; b < 4; ++b) {
          const bool outer = b == 0   ? key.y % 2 == 0
                             : b == 1 ? key.x % 2 == 1
                             : b == 2 ? key.y % 2 == 1
                                      : key.x % 2 == 0;
          if (!outer) continue;
          const auto fine = side_of(p, node, b), coarse = side_of(p, parent, b);
          for (const auto& v : coarse) {
            const auto along = [&](const auto& o) { return b % 2 == 0 ? std::get<0>(o) : std::get<1>(o); };
            if (along(v) <= along(fine.front()) || along(v) >= along(fine.back())) continue;
            EXPECT_TRUE(std::binary_search(fine.begin(), fine.end(), v));
          }
        }
      }
    }
    EXPECT_EQ(level.n_tiles, n_tiles);
    EXPECT_EQ(level.n_filler, n_coverage[0]);
    EXPECT_EQ(level.n_partial, n_coverage[1]);
    EXPECT_EQ(level.n_real, n_coverage[2]);
    EXPECT_EQ(level.n_triangles, n_triangles);
    EXPECT_EQ(level.n_posts, n_posts);
    EXPECT_EQ(level.n_border_vertices, border_vertices.size());
    EXPECT_EQ(level.n_vertices, border_vertices.size() + n_interior);
    EXPECT_EQ(level.max_error_m, worst);
    EXPECT_LE(worst, level.tolerance_m) << "level " << l;
  }
  EXPECT_TRUE(p.tiles.contains({0, 0, 0}) && p.tiles.contains({0, 1, 0}));
}

TEST_F(BuildTest, WritesTheSameBytesForAnyNumberOfThreads) {
  const std::string input = write_mountains();
  for (const int threads : {1, 2, 3}) {
    const auto report = build(options({input}, fmt::format("{}.tind", threads), threads));
    ASSERT_TRUE(report) << report.error().message;
    EXPECT_EQ(report->file_bytes, bytes_of(fmt::format("{}.tind", threads)).size());
  }
  EXPECT_EQ(bytes_of("1.tind"), bytes_of("2.tind"));
  EXPECT_EQ(bytes_of("1.tind"), bytes_of("3.tind"));
  EXPECT_EQ(files(), (std::set<std::string>{"1.tind", "2.tind", "3.tind", "mountains.asc"}));
}

// Little memory: posts lie in pages, of which few are held.
TEST_F(BuildTest, WritesTheSameBytesForAnyMemory) {
  const std::string input = write_mountains();
  ASSERT_TRUE(build(options({input}, "much.tind", 2)));
  BuildOptions little = options({input}, "little.tind", 2);
  little.memory_bytes = std::uint64_t{64} << 10;
  const auto report = build(little);
  ASSERT_TRUE(report) << report.error().message;
  EXPECT_EQ(bytes_of("much.tind"), bytes_of("little.tind"));
}

TEST_F(BuildTest, WritesTheSameBytesForAnyOrderOfInputs) {
  const HeightAt rough = rough_terrain(5, 1000);
  // Overlapping by a column that disagrees by half a metre.
  const std::string a = write_grid("a.asc", 7, 50, 0.001, 30, 31, rough);
  const std::string b = write_grid("b.asc", 7.03, 50, 0.001, 30, 31,
                                   [&](auto r, auto c) { return rough(r, c + 30) + (c == 0 ? 0.5 : 0); });
  const std::string c =
      write_grid("c.asc", 7, 50.03, 0.001, 30, 31, [&](auto r, auto col) { return rough(r + 30, col); });
  ASSERT_TRUE(build(options({a, b, c}, "abc.tind")));
  ASSERT_TRUE(build(options({c, a, b}, "cab.tind")));
  EXPECT_EQ(bytes_of("abc.tind"), bytes_of("cab.tind"));
  const Pyramid p = read("abc.tind");
  EXPECT_EQ(p.manifest.sources.size(), 3u);
  EXPECT_NEAR(p.manifest.disagreement_m, 0.25, 0.26);
  expect_sound(p);
}

TEST_F(BuildTest, MakesASoundPyramidWithVoidsAndFalloff) {
  const auto report = build(options({write_mountains()}, "a.tind"));
  ASSERT_TRUE(report) << report.error().message;
  const Pyramid p = read("a.tind");
  expect_sound(p);
  EXPECT_EQ(p.manifest.n_source_posts, 64u * 80 - 5 * 3);
  EXPECT_EQ(p.manifest.n_filled_posts, 15u);
  EXPECT_GT(p.manifest.n_falloff_posts, 12u * 64 * 2);
  for (const LevelInfo& level : p.manifest.levels) EXPECT_EQ(level.n_posts, p.manifest.n_source_posts) << level.level;
  EXPECT_GT(p.manifest.levels.back().n_real, 0u);
  EXPECT_GT(p.manifest.levels.back().n_filler, 0u);
  // Far from the data nothing but the roots and what siblings need is stored.
  EXPECT_FALSE(p.manifest.has_tile({4, 0, 0}));
}

TEST_F(BuildTest, StoresRunsThatAgreeWithEntryLevels) {
  ASSERT_TRUE(build(options({write_mountains()}, "a.tind")));
  const Pyramid p = read("a.tind");
  int n_compared = 0, n_runs = 0;
  for (const auto& [id, node] : p.tiles) {
    ASSERT_EQ(int{node.n_gaps}, p.manifest.bottom_level - node.key.level);
    for (const VirtualTriangle& vt : node.virtual_triangles) {
      if (vt.n_edges != 1 || node.n_gaps == 0) continue;
      // The two finer tiles beside south or west sides, where the tile itself is split.
      if (vt.border % 3 != 0 || !p.tiles.contains({node.key.level + 1, node.key.x * 2, node.key.y * 2})) continue;
      const std::int64_t side = p.manifest.lattice.tile_side(node.key.level);
      std::set<std::int64_t> own;
      const auto along = [&](const LocalVertex& v) { return vt.border == 0 ? v.x : v.y; };
      for (const LocalVertex& v : node.vertices) {
        if ((vt.border == 0 ? v.y : v.x) == 0) own.insert(along(v));
      }
      const std::vector<std::int64_t> ends(own.begin(), own.end());
      const std::size_t k = vt.border == 0 ? vt.interval : ends.size() - 2 - vt.interval;
      std::set<std::int64_t> inside;
      for (int c = 0; c < 2; ++c) {
        const TileKey child = node.key.child(vt.border == 0 ? c : 2 * c);
        const std::int64_t shift = c * side / 2;
        for (const LocalVertex& v : p.at(child.level, child.x, child.y).vertices) {
          if ((vt.border == 0 ? v.y : v.x) != 0) continue;
          const std::int64_t t = shift + along(v);
          if (t > ends[k] && t < ends[k + 1]) inside.insert(t);
        }
      }
      EXPECT_EQ(vt.runs.at(0), inside.size());
      EXPECT_TRUE(std::is_sorted(vt.runs.begin(), vt.runs.end()));
      ++n_compared;
      n_runs += !inside.empty();
    }
  }
  EXPECT_GT(n_compared, 50);
  EXPECT_GT(n_runs, 10);
}

TEST_F(BuildTest, JoinsDataAcrossLongitude180) {
  const HeightAt rough = rough_terrain(9, 2000);
  const std::string west = write_grid("west.asc", 179.967, -17, 0.001, 40, 33, rough);  // ends at 179.999
  const std::string east =
      write_grid("east.asc", -180, -17, 0.001, 40, 33, [&](auto r, auto c) { return rough(r, c + 33); });
  ASSERT_TRUE(build(options({west, east}, "a.tind")));
  const Pyramid p = read("a.tind");
  EXPECT_EQ(p.manifest.n_source_posts, 40u * 66);
  expect_sound(p);
  const int bottom = p.manifest.bottom_level;
  std::size_t n_rough = 0;
  for (const auto& [id, node] : p.tiles) {
    if (node.key.level != bottom || node.key.x != 0 || node.stats.n_posts == 0) continue;
    ASSERT_TRUE(p.tiles.contains({bottom, TileKey::count_x(bottom) - 1, node.key.y}));
    n_rough += node.n_side[3];
  }
  EXPECT_GT(n_rough, 10u);  // the seam is no base line
}

TEST_F(BuildTest, CoversAWholeGlobeWithOneHeightAtEachPole) {
  // Cell centres half a spacing from poles and from longitude 180.
  const std::string input = write_grid("globe.asc", -178.5, -88.5, 3, 60, 120, rough_terrain(4, 28000));
  BuildOptions o = options({input}, "a.tind");
  o.levels.finest_m = 9000;
  ASSERT_TRUE(build(o));
  const Pyramid p = read("a.tind");
  expect_sound(p);
  EXPECT_EQ(p.manifest.n_source_posts, 60u * 120);
  for (const LevelInfo& level : p.manifest.levels) {
    EXPECT_EQ(level.n_tiles, std::uint64_t{2} << (2 * level.level));
    EXPECT_EQ(level.n_real, level.n_tiles);
    EXPECT_EQ(level.n_posts, 60u * 120);
  }
}

TEST_F(BuildTest, GivesARowOfPostsOnAPoleOneHeight) {
  const std::string input = write_grid("globe.asc", -180, -90, 3, 61, 120, rough_terrain(4, 28000));
  BuildOptions o = options({input}, "a.tind");
  o.levels.finest_m = 17000;
  ASSERT_TRUE(build(o));
  const Pyramid p = read("a.tind");
  expect_sound(p);
  for (const LevelInfo& level : p.manifest.levels) EXPECT_EQ(level.n_posts, 61u * 120);
}

TEST_F(BuildTest, KeepsTheToleranceOnSteepDataWithATightOne) {
  // A post is 111 m wide and 300 m high: half a lattice step aside is 0.3 m.
  BuildOptions o =
      options({write_grid("steep.asc", 10.0003, 45.0001, 0.001, 20, 24, rough_terrain(3, 1500))}, "a.tind");
  o.levels.finest_m.reset();
  o.levels.tolerance_m = 0.2;
  ASSERT_TRUE(build(o));
  expect_sound(read("a.tind"));
}

TEST_F(BuildTest, StopsAndGoesOnWhereItIsTold) {
  const std::string input = write_mountains();
  BuildOptions o = options({input}, "a.tind");
  o.levels.max_level = 9;
  ASSERT_TRUE(build(o));
  const Pyramid coarse = read("a.tind");
  EXPECT_EQ(coarse.manifest.bottom_level, 9);
  expect_sound(coarse);
}

TEST_F(BuildTest, LeavesNothingBehindWhenCancelled) {
  const std::string input = write_mountains();
  std::atomic<bool> cancel{true};
  BuildOptions o = options({input}, "a.tind");
  o.cancel = &cancel;
  const auto report = build(o);
  ASSERT_FALSE(report);
  EXPECT_THAT(report.error().message, HasSubstr("interrupted"));
  EXPECT_EQ(files(), (std::set<std::string>{"mountains.asc"}));
}

TEST_F(BuildTest, LeavesAnEarlierOutputUntouchedOnFailure) {
  const std::string input = write_mountains();
  std::ofstream(path("a.tind")) << "earlier";
  auto report = build(options({input}, "a.tind"));
  ASSERT_FALSE(report);
  EXPECT_THAT(report.error().message, HasSubstr("--force"));
  EXPECT_EQ(bytes_of("a.tind"), "earlier");

  BuildOptions forced = options({path("missing.asc")}, "a.tind");
  forced.force = true;
  ASSERT_FALSE(build(forced));
  std::atomic<bool> cancel{true};
  forced.source.inputs = {input};
  forced.cancel = &cancel;
  ASSERT_FALSE(build(forced));
  EXPECT_EQ(bytes_of("a.tind"), "earlier");
  forced.cancel = nullptr;
  ASSERT_TRUE(build(forced));
  EXPECT_NE(bytes_of("a.tind"), "earlier");
  EXPECT_EQ(files(), (std::set<std::string>{"a.tind", "mountains.asc"}));
}

TEST_F(BuildTest, RefusesOutputsThatCannotBe) {
  const std::string input = write_mountains();
  const auto message = [&](const std::string& output) {
    BuildOptions o = options({input}, "x");
    o.output = output;
    const auto report = build(o);
    return report ? "" : report.error().message;
  };
  EXPECT_THAT(message(""), HasSubstr("-o"));
  EXPECT_THAT(message(path("no/such/folder/a.tind")), HasSubstr("folder"));
  EXPECT_THAT(message(folder_.string()), HasSubstr("folder"));
  EXPECT_EQ(files(), (std::set<std::string>{"mountains.asc"}));
}

/// Runs a build in a child whose files may not grow beyond `limit`; what it says, and nothing is left behind.
TEST_F(BuildTest, SaysSoWhenTheDiskIsFull) {
  const std::string input = write_mountains();
  ASSERT_TRUE(build(options({input}, "whole.tind")));
  const auto size = fs::file_size(path("whole.tind"));
  std::ofstream(path("a.tind")) << "earlier";
  for (const double share : {0.05, 0.5, 0.95}) {
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      std::signal(SIGXFSZ, SIG_IGN);
      const auto limit = static_cast<rlim_t>(share * static_cast<double>(size));
      const rlimit files_limit{limit, limit};
      ::setrlimit(RLIMIT_FSIZE, &files_limit);
      BuildOptions o = options({input}, "a.tind", 1);
      o.force = true;
      const auto report = build(o);
      const bool said =
          !report && report.error().kind == ErrorKind::kIo && report.error().message.find("\n") == std::string::npos;
      std::_Exit(said ? 0 : 1);
    }
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << share << ": status " << status;
    EXPECT_EQ(bytes_of("a.tind"), "earlier");
    EXPECT_EQ(files(), (std::set<std::string>{"a.tind", "mountains.asc", "whole.tind"}));
  }
}

}  // namespace
}  // namespace tind::test
