// SPDX-License-Identifier: GPL-3.0-or-later
// Streams and the user's lines on a made-up valley, and what whole builds make of them.
#include "storage/builder/surface_lines.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <numbers>
#include <optional>
#include <set>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "storage/builder/build.hpp"
#include "storage/piece_blob.hpp"
#include "storage/tile_store.hpp"
#include "storage/zstd_codec.hpp"
#include "tests/support/test_field.hpp"

namespace tind::test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr std::int64_t kPosts = 160;
constexpr double kSpacingDeg = 0.003;
constexpr double kWest = 10.0, kSouth = 45.0;
constexpr double kTolerance = 20;
constexpr double kMetresPerDegree = 6378137.0 * std::numbers::pi / 180;  // on the equator, as builds take it

/// Column of the valley's bottom.
double bottom_column(double row) { return 80 + 12 * std::sin(row / 15); }

/// A valley that winds south, 3 m lower each row, with side valleys and noise: raw heights rise and fall along it.
double valley(std::int64_t r, std::int64_t c) {
  const double row = static_cast<double>(r), off = static_cast<double>(c) - bottom_column(row);
  return 1500 + 3 * row + 14 * std::abs(off) + std::min(1.0, std::abs(off) / 15) * 90 * std::sin(row / 8) +
         9 * noise(5, r, c);
}

class SurfaceLinesTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-lines-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }

  static LevelTable table(double tolerance_m = kTolerance) {
    LevelOptions options;
    options.metres_per_degree = kMetresPerDegree;
    options.tolerance_m = tolerance_m;
    return make_level_table(kSpacingDeg, kSpacingDeg, options).value();
  }
  static TestField valley_field(const LevelTable& table, const HeightAt& height = valley) {
    GridPlace place;
    place.lattice_level = table.lattice_level;
    place.height_exponent = table.height_exponent;
    Lattice lattice;
    lattice.level = table.lattice_level;
    place.x0 = (kWest + 180) / lattice.step_deg();
    place.y0 = (kSouth + 90) / lattice.step_deg();
    place.dx = place.dy = kSpacingDeg / lattice.step_deg();
    place.n_rows = place.n_cols = kPosts;
    return TestField(place, height);
  }
  SurfaceLines lines_of(const HeightField& field, const LevelTable& table, const LineOptions& options,
                        int threads = 2) const {
    auto lines = make_surface_lines(field, table, options, {folder_.string()}, threads);
    EXPECT_TRUE(lines) << lines.error().message;
    return lines ? std::move(*lines) : SurfaceLines();
  }
  /// A GeoJSON file of line strings (or polygons), coordinates as text.
  std::string geojson(const std::string& name, const std::string& type,
                      const std::vector<std::string>& coordinates) const {
    std::string text = R"({"type": "FeatureCollection", "features": [)";
    for (const std::string& c : coordinates) {
      text +=
          fmt::format(R"({}{{"type": "Feature", "properties": {{}}, "geometry": {{"type": "{}", "coordinates": {}}}}})",
                      &c == &coordinates[0] ? "" : ",", type, c);
    }
    std::ofstream(path(name)) << text << "]}";
    return path(name);
  }
  /// A line across the whole valley, west to east.
  BreakLineFile road() const {
    return {geojson("road.geojson", "LineString", {"[[10.02, 45.25], [10.45, 45.26]]"}), false};
  }

  /// The valley as a file, for whole builds: rows [first, first + n).
  std::string write_valley(const std::string& name, std::int64_t first = 0, std::int64_t n = kPosts) const {
    std::string text = fmt::format("ncols {}\nnrows {}\nxllcenter {}\nyllcenter {}\ncellsize {}\n", kPosts, n, kWest,
                                   kSouth + static_cast<double>(first) * kSpacingDeg, kSpacingDeg);
    for (std::int64_t r = first + n - 1; r >= first; --r) {
      for (std::int64_t c = 0; c < kPosts; ++c) text += fmt::format("{:.2f} ", valley(r, c));
      text += '\n';
    }
    std::ofstream(path(name)) << text;
    return path(name);
  }
  BuildOptions build_options(std::vector<std::string> inputs, const std::string& output, int threads = 2) const {
    BuildOptions o;
    o.source.inputs = std::move(inputs);
    o.output = path(output);
    o.threads = threads;
    o.falloff_posts = 12;
    o.levels.tolerance_m = kTolerance;
    o.metres = BuildOptions::Metres::kEquator;
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

  fs::path folder_;
};

using Point = std::tuple<std::int64_t, std::int64_t, std::int32_t>;

std::vector<Point> points_of(const DrawnLine& line) {
  std::vector<Point> points;
  for (const LatticePoint& p : line.vertices) points.emplace_back(p.x, p.y, p.z);
  return points;
}

std::set<std::pair<std::int64_t, std::int64_t>> places_of(const SurfaceLines& lines, int level, const char* kind) {
  std::set<std::pair<std::int64_t, std::int64_t>> places;
  const auto drawn = lines.pyramid.drawn(level);
  for (const OutputLayer& layer : lines.layers) {
    if (layer.name != fmt::format("level_{:02}", level)) continue;
    EXPECT_EQ(layer.lines.size(), drawn.size());
    for (std::size_t k = 0; k < drawn.size(); ++k) {
      if (layer.lines[k].kind != kind) continue;
      for (const LatticePoint& p : drawn[k].vertices) places.insert({p.x, p.y});
    }
  }
  return places;
}

TEST_F(SurfaceLinesTest, StreamRunsDownTheValleyWithinHalfTheTolerance) {
  const LevelTable t = table();
  const TestField world = valley_field(t);
  const HeightField& field = world.field;
  LineOptions options;
  options.drainage_cells = 300;
  const SurfaceLines lines = lines_of(field, t, options);
  EXPECT_GT(lines.counts.streams, 5u);
  EXPECT_EQ(lines.counts.given, 0u);
  EXPECT_EQ(lines.drainage_cells, 300);

  // A vertex on a post is the post's own but for conditioning.
  const double unit = field.lattice.height_unit_m();
  std::map<std::pair<std::int64_t, std::int64_t>, double> own;
  for (std::int64_t r = 0; r < kPosts; ++r) {
    for (std::int64_t c = 0; c < kPosts; ++c)
      own[{std::llround(field.post_x(c)), std::llround(field.post_y(r))}] = field.height_at(r, c);
  }
  const auto is_rim = [&](const LatticePoint& p) {
    return std::min({std::abs(p.x - std::llround(field.x0)), std::abs(p.x - std::llround(field.post_x(kPosts - 1))),
                     std::abs(p.y - std::llround(field.y0)), std::abs(p.y - std::llround(field.post_y(kPosts - 1)))}) ==
           0;
  };
  std::uint64_t n_vertices = 0, n_conditioned = 0, n_rising_without = 0;
  double length_in_valley = 0;
  for (int level = 0; level <= t.bottom_level(); ++level) {
    for (const DrawnLine& line : lines.pyramid.drawn(level)) {
      // Lines are drawn either way round; two streams that end in one post of the rim are drawn as one line.
      const auto by_height = [](const LatticePoint& a, const LatticePoint& b) { return a.z < b.z; };
      const auto lowest = std::min_element(line.vertices.begin(), line.vertices.end(), by_height);
      EXPECT_TRUE(std::is_sorted(lowest, line.vertices.end(), by_height)) << "level " << level;
      EXPECT_TRUE(std::is_sorted(std::reverse_iterator(lowest), line.vertices.rend(), by_height)) << "level " << level;
      EXPECT_TRUE(lowest->z == line.vertices.front().z || lowest->z == line.vertices.back().z || is_rim(*lowest));
      std::optional<double> own_before;
      for (std::size_t k = 0; k < line.vertices.size(); ++k) {
        const LatticePoint& v = line.vertices[k];
        const auto post = own.find({v.x, v.y});
        if (post == own.end()) continue;
        const double height_m = field.lattice.height_m(v.z);
        EXPECT_NEAR(height_m, post->second, kTolerance / 2 + unit);
        n_conditioned += std::abs(height_m - post->second) > 2 * unit;
        n_rising_without += own_before && post->second > *own_before;
        own_before = post->second;
      }
      if (level != t.bottom_level()) continue;
      n_vertices += line.vertices.size();
      for (std::size_t k = 1; k < line.vertices.size(); ++k) {
        const double row = (static_cast<double>(line.vertices[k].y) - field.y0) / field.dy;
        const double column = (static_cast<double>(line.vertices[k].x) - field.x0) / field.dx;
        if (std::abs(column - bottom_column(row)) > 6) continue;
        length_in_valley += std::abs(static_cast<double>(line.vertices[k].y - line.vertices[k - 1].y)) / field.dy;
      }
    }
  }
  EXPECT_EQ(lines.counts.vertices, n_vertices);
  EXPECT_GT(n_conditioned, 10u);
  EXPECT_GT(n_rising_without, 5u) << "the raw heights would not have run downhill";
  EXPECT_GT(length_in_valley, 120) << "rows of the valley that have the stream";
  EXPECT_EQ(lines.drainage.uphill_steps, 0);
}

TEST_F(SurfaceLinesTest, PitsDeeperThanTheToleranceKeepTheirHeights) {
  const LevelTable t = table();
  // A dam of 80 m across the valley: water stands behind it, the stream's posts do not move by half as much.
  const TestField world = valley_field(t, [](auto r, auto c) { return valley(r, c) + (r == 70 ? 80 : 0); });
  const HeightField& field = world.field;
  LineOptions options;
  options.drainage_cells = 300;
  const SurfaceLines lines = lines_of(field, t, options);
  EXPECT_GT(lines.drainage.deep_posts, 0);
  std::map<std::pair<std::int64_t, std::int64_t>, double> own;
  for (std::int64_t r = 0; r < kPosts; ++r) {
    for (std::int64_t c = 0; c < kPosts; ++c)
      own[{std::llround(field.post_x(c)), std::llround(field.post_y(r))}] = field.height_at(r, c);
  }
  std::size_t n = 0;
  for (const LatticePoint& p : lines.pyramid.vertices()) {
    const auto post = own.find({p.x, p.y});
    if (post == own.end()) continue;
    ++n;
    EXPECT_NEAR(field.lattice.height_m(p.z), post->second, kTolerance / 2 + field.lattice.height_unit_m());
  }
  EXPECT_GT(n, 300u);
}

TEST_F(SurfaceLinesTest, CoarserLevelsDrawFewerStreamsAndShareTheirVertices) {
  const LevelTable t = table();
  const TestField world = valley_field(t);
  LineOptions options;
  options.drainage_cells = 100;
  const SurfaceLines lines = lines_of(world.field, t, options);
  options.drainage_growth = 1;
  const SurfaceLines same_at_all = lines_of(world.field, t, options);
  const int bottom = t.bottom_level();
  const auto length = [](const SurfaceLines& l, int level) {
    double sum = 0;
    for (const DrawnLine& line : l.pyramid.drawn(level)) {
      for (std::size_t k = 1; k < line.vertices.size(); ++k) {
        sum += std::hypot(static_cast<double>(line.vertices[k].x - line.vertices[k - 1].x),
                          static_cast<double>(line.vertices[k].y - line.vertices[k - 1].y));
      }
    }
    return sum;
  };
  EXPECT_LT(length(lines, bottom - 1), 0.8 * length(lines, bottom));
  EXPECT_LT(length(lines, bottom - 2), 0.8 * length(lines, bottom - 1));
  EXPECT_GT(length(same_at_all, bottom - 2), 0.8 * length(same_at_all, bottom));
  for (int level = 1; level <= bottom; ++level) {
    std::set<std::pair<std::int64_t, std::int64_t>> fine;
    for (const DrawnLine& line : lines.pyramid.drawn(level)) {
      for (const LatticePoint& p : line.vertices) fine.insert({p.x, p.y});
    }
    for (const DrawnLine& line : lines.pyramid.drawn(level - 1)) {
      for (const LatticePoint& p : line.vertices) EXPECT_TRUE(fine.contains({p.x, p.y})) << level;
    }
  }
}

TEST_F(SurfaceLinesTest, ThreadsDoNotChangeTheLines) {
  const LevelTable t = table();
  const TestField world = valley_field(t);
  LineOptions options;  // sizes are estimated, on several threads
  options.given = {road()};
  options.lines_out = path("lines.gpkg");
  const SurfaceLines one = lines_of(world.field, t, options, 1), three = lines_of(world.field, t, options, 3);
  EXPECT_GT(one.counts.streams, 0u);
  EXPECT_EQ(one.drainage_cells, three.drainage_cells);
  EXPECT_EQ(one.lake_area_m2, three.lake_area_m2);
  ASSERT_EQ(one.layers.size(), three.layers.size());
  for (int level = 0; level <= t.bottom_level(); ++level) {
    const auto a = one.pyramid.drawn(level), b = three.pyramid.drawn(level);
    ASSERT_EQ(a.size(), b.size()) << level;
    for (std::size_t k = 0; k < a.size(); ++k) {
      EXPECT_EQ(points_of(a[k]), points_of(b[k]));
      EXPECT_EQ(a[k].chain, b[k].chain);
    }
  }
}

TEST_F(SurfaceLinesTest, UsersLineAndStreamAreCutAtEachOther) {
  const LevelTable t = table();
  const TestField world = valley_field(t);
  LineOptions options;
  options.drainage_cells = 300;
  options.given = {road()};
  options.lines_out = path("lines.gpkg");
  const SurfaceLines lines = lines_of(world.field, t, options);
  EXPECT_EQ(lines.counts.given, 1u);
  EXPECT_EQ(lines.given.features, 1);
  ASSERT_EQ(lines.given_sources.size(), 1u);
  EXPECT_EQ(lines.given_sources[0].name, "road.geojson");
  for (int level = 0; level <= t.bottom_level(); ++level) EXPECT_EQ(lines.pyramid.n_dropped(level), 0u) << level;

  // The road is whole at the bottom level, and the streams that it crosses share a vertex with it.
  const auto road_at = places_of(lines, t.bottom_level(), "breakline");
  const auto streams_at = places_of(lines, t.bottom_level(), "stream");
  ASSERT_FALSE(road_at.empty());
  const HeightField& field = world.field;
  const auto column = [&](std::int64_t x) { return (static_cast<double>(x) - field.x0) / field.dx; };
  EXPECT_LT(column(road_at.begin()->first), 8);
  EXPECT_GT(column(road_at.rbegin()->first), 148);
  std::size_t n_shared = 0;
  for (const auto& [x, y] : road_at) {
    if (!streams_at.contains({x, y})) continue;
    ++n_shared;
  }
  EXPECT_GE(n_shared, 1u);
  // No piece of a stream crosses a piece of the road but in its ends.
  const double road_west = kWest + 0.02, road_east = kWest + 0.45;
  const auto side_of_road = [&](const std::pair<std::int64_t, std::int64_t>& p) {
    const double lon = field.lattice.longitude_deg(p.first), lat = field.lattice.latitude_deg(p.second);
    const double off = lat - (45.25 + 0.01 * (lon - road_west) / (road_east - road_west));
    return std::abs(off) < 1e-5 ? 0 : off > 0 ? 1 : -1;
  };
  const auto drawn = lines.pyramid.drawn(t.bottom_level());
  const OutputLayer& layer = lines.layers.back();
  ASSERT_EQ(layer.lines.size(), drawn.size());
  int n_passed = 0;
  for (std::size_t k = 0; k < drawn.size(); ++k) {
    if (layer.lines[k].kind != "stream") continue;
    for (std::size_t i = 1; i < drawn[k].vertices.size(); ++i) {
      const int a = side_of_road({drawn[k].vertices[i - 1].x, drawn[k].vertices[i - 1].y});
      const int b = side_of_road({drawn[k].vertices[i].x, drawn[k].vertices[i].y});
      EXPECT_NE(a * b, -1) << "a stream crosses the road without a vertex there";
      n_passed += a * b == 0;
    }
  }
  EXPECT_GE(n_passed, 1);
}

TEST_F(SurfaceLinesTest, SizesAreTheUsersOrFollowFromTheVertices) {
  const LevelTable t = table();
  const TestField world = valley_field(t);
  LineOptions options;
  options.drainage_cells = 123;
  options.lake_area_m2 = 45678;
  const SurfaceLines given = lines_of(world.field, t, options);
  EXPECT_EQ(given.drainage_cells, 123);
  EXPECT_EQ(given.lake_area_m2, 45678);

  // Against the vertices of whole builds without lines.
  std::int64_t cells_before = 0;
  for (const double tolerance_m : {5.0, 20.0}) {
    BuildOptions o = build_options({write_valley("valley.asc")}, "a.tind");
    o.force = true;
    o.levels.tolerance_m = tolerance_m;
    const auto with = build(o);
    ASSERT_TRUE(with) << with.error().message;
    o.lines.drainage = false;
    const auto plain = build(o);
    ASSERT_TRUE(plain) << plain.error().message;
    EXPECT_EQ(plain->drainage_cells, 0);
    const LevelInfo& bottom = plain->manifest.levels.back();
    const double cells = 44.0 * kPosts * kPosts / static_cast<double>(bottom.n_vertices);
    EXPECT_NEAR(static_cast<double>(with->drainage_cells), cells, 0.3 * cells);
    EXPECT_GT(with->drainage_cells, cells_before) << "fewer vertices, fewer streams";
    cells_before = with->drainage_cells;
  }
  EXPECT_GE(lines_of(world.field, t, LineOptions()).lake_area_m2, 250'000);
}

TEST_F(SurfaceLinesTest, LayersSayWhatEachLevelDraws) {
  const LevelTable t = table();
  const TestField world = valley_field(t);
  LineOptions options;
  options.drainage_cells = 300;
  options.given = {road(),
                   {geojson("lake.geojson", "Polygon",
                            {"[[[10.05, 45.35], [10.1, 45.35], [10.1, 45.4], [10.05, 45.4], [10.05, 45.35]]]"}),
                    true}};
  EXPECT_TRUE(lines_of(world.field, t, options).layers.empty()) << "no file is asked for";
  options.lines_out = path("lines.gpkg");
  const SurfaceLines lines = lines_of(world.field, t, options);
  ASSERT_FALSE(lines.layers.empty());
  EXPECT_EQ(lines.layers.back().name, fmt::format("level_{:02}", t.bottom_level()));
  std::set<std::string> kinds;
  for (const OutputLayer& layer : lines.layers) {
    const int level = std::stoi(layer.name.substr(6));
    EXPECT_EQ(layer.lines.size(), lines.pyramid.drawn(level).size());
    for (const OutputLine& line : layer.lines) {
      kinds.insert(line.kind);
      EXPECT_LE(line.first_level, level);
      EXPECT_EQ(line.strahler.has_value(), line.kind == "stream");
      EXPECT_EQ(line.area_km2.has_value(), line.kind == "stream");
      if (line.kind == "stream") {
        EXPECT_GE(*line.strahler, 1);
        EXPECT_GT(*line.area_km2, 300 * 0.05) << "300 posts of some 0.08 km2";
      }
      ASSERT_GE(line.vertices.size(), 2u);
      for (const auto& [lon, lat, height_m] : line.vertices) {
        EXPECT_TRUE(lon >= kWest - 1e-6 && lon <= kWest + kPosts * kSpacingDeg) << lon;
        EXPECT_TRUE(lat >= kSouth - 1e-6 && lat <= kSouth + kPosts * kSpacingDeg) << lat;
        EXPECT_TRUE(height_m > 1400 && height_m < 4000) << height_m;
      }
    }
  }
  EXPECT_EQ(kinds, (std::set<std::string>{"breakline", "shore", "stream"}));
}

TEST_F(SurfaceLinesTest, NothingAskedForIsNothing) {
  const LevelTable t = table();
  const TestField world = valley_field(t);
  LineOptions options;
  options.drainage = false;
  options.lines_out = path("lines.gpkg");
  const SurfaceLines lines = lines_of(world.field, t, options);
  EXPECT_TRUE(lines.pyramid.empty());
  EXPECT_TRUE(lines.layers.empty());
  EXPECT_EQ(lines.counts.vertices, 0u);
  EXPECT_EQ(lines.drainage_cells, 0);
  options.given = {road()};  // break lines need no drainage
  EXPECT_FALSE(lines_of(world.field, t, options).pyramid.empty());
}

TEST_F(SurfaceLinesTest, NoScratchAndNoFileAreErrors) {
  const LevelTable t = table();
  const TestField world = valley_field(t);
  const auto no_scratch = make_surface_lines(world.field, t, LineOptions(), {path("no/such/folder")}, 1);
  ASSERT_FALSE(no_scratch);
  EXPECT_EQ(no_scratch.error().kind, ErrorKind::kIo);
  EXPECT_THAT(no_scratch.error().message, HasSubstr("no/such/folder"));
  LineOptions options;
  options.given = {{path("nowhere.gpkg"), false}};
  const auto no_file = make_surface_lines(world.field, t, options, {folder_.string()}, 1);
  ASSERT_FALSE(no_file);
  EXPECT_THAT(no_file.error().message, HasSubstr("nowhere.gpkg"));
}

TEST_F(SurfaceLinesTest, BuildsHaveTheSameBytesForAnyThreadsAndOrder) {
  const std::string south = write_valley("south.asc", 0, 80), north = write_valley("north.asc", 80, 80);
  const BreakLineFile lake = {
      geojson("lake.geojson", "Polygon",
              {"[[[10.05, 45.35], [10.1, 45.35], [10.1, 45.4], [10.05, 45.4], [10.05, 45.35]]]"}),
      true};
  const auto options = [&](bool turned, int threads, const std::string& output) {
    BuildOptions o = build_options(turned ? std::vector{north, south} : std::vector{south, north}, output, threads);
    o.lines.given = turned ? std::vector{lake, road()} : std::vector{road(), lake};
    o.lines.lines_out = path(output + ".gpkg");
    return o;
  };
  const auto first = build(options(false, 1, "1.tind"));
  ASSERT_TRUE(first) << first.error().message;
  EXPECT_GT(first->manifest.lines.streams, 0u);
  const auto three = build(options(false, 3, "3.tind"));
  ASSERT_TRUE(three) << three.error().message;
  EXPECT_TRUE(bytes_of("1.tind") == bytes_of("3.tind"));
  EXPECT_TRUE(bytes_of("1.tind.gpkg") == bytes_of("3.tind.gpkg"));
  const auto turned = build(options(true, 2, "turned.tind"));
  ASSERT_TRUE(turned) << turned.error().message;
  EXPECT_EQ(first->manifest.content_hash, turned->manifest.content_hash);
  EXPECT_TRUE(bytes_of("1.tind.gpkg") == bytes_of("turned.tind.gpkg"));
}

TEST_F(SurfaceLinesTest, StreamsCrossTileBordersInBorderVertices) {
  BuildOptions o = build_options({write_valley("valley.asc")}, "a.tind");
  o.levels.tolerance_m.reset();
  o.levels.finest_m = kTolerance;  // four levels below the posts' own: tiles of 16 posts
  o.lines.drainage_cells = 100;
  o.lines.given = {road()};
  const auto report = build(o);
  ASSERT_TRUE(report) << report.error().message;
  const Manifest& m = report->manifest;

  // The same lines again, from the same posts.
  auto source = ElevationSource::open(o.source);
  ASSERT_TRUE(source) << source.error().message;
  LevelOptions level_options = o.levels;
  level_options.metres_per_degree = kMetresPerDegree;
  const LevelTable t = make_level_table(kSpacingDeg, kSpacingDeg, level_options).value();
  ASSERT_EQ(t.lattice_level, m.lattice.level);
  ASSERT_TRUE(source->load(m.lattice, 0, o.falloff_posts, folder_.string(), 1, [](double) {}));
  const SurfaceLines lines = lines_of(source->field(), t, o.lines);
  EXPECT_EQ(m.lines.streams, lines.counts.streams);
  EXPECT_EQ(m.lines.shores, lines.counts.shores);
  EXPECT_EQ(m.lines.given, lines.counts.given);
  EXPECT_EQ(m.lines.vertices, lines.counts.vertices);
  std::map<std::pair<std::int64_t, std::int64_t>, std::int32_t> heights;
  for (const LatticePoint& p : lines.pyramid.vertices()) heights[{p.x, p.y}] = p.z;

  const auto store = TileStore::open(path("a.tind"));
  ASSERT_TRUE(store) << store.error().message;
  const auto snapshot = store->snapshot();
  const auto edge_of = [&](const PieceKey& key) {
    const auto value = snapshot->find(key);
    return value ? decode_edge(unpack_value(*value).value()).value() : EdgeChain();
  };
  int n_crossings = 0, n_not_posts = 0;
  for (const LevelInfo& level : m.levels) {
    const std::int64_t side = m.lattice.tile_side(level.level);
    for (const TileRun& run : level.rows) {
      for (std::uint32_t x = run.x_first; x <= run.x_last; ++x) {
        for (const bool vertical : {false, true}) {
          const auto l = static_cast<std::uint8_t>(level.level);
          const PieceKey key{vertical ? PieceKind::kEdgeV : PieceKind::kEdgeH, l, x, run.y};
          const std::int64_t at = side * (vertical ? x : run.y), start = side * (vertical ? run.y : x);
          const EdgeChain edge = edge_of(key);
          for (const LineCrossing& c : lines.pyramid.crossings(vertical, at, start, start + side)) {
            if (c.entry > level.level) continue;
            ++n_crossings;
            const auto found = std::find_if(edge.inner.begin(), edge.inner.end(),
                                            [&](const EdgeVertex& v) { return v.t == c.t - start; });
            ASSERT_NE(found, edge.inner.end()) << "level " << level.level << ": no border vertex at a crossing";
            EXPECT_LE(found->entry, c.entry);
            const std::pair place = vertical ? std::pair(at, c.t) : std::pair(c.t, at);
            EXPECT_EQ(found->z, heights.at(place));
            const double row = (static_cast<double>(place.second) - source->field().y0) / source->field().dy;
            n_not_posts += std::abs(row - std::round(row)) > 0.01;
          }
        }
      }
    }
    EXPECT_LE(level.max_error_m, level.tolerance_m) << level.level;
  }
  EXPECT_GT(n_crossings, 10);
  EXPECT_GT(n_not_posts, 3);
  EXPECT_GT(report->breakdown.back().of_lines, 20u);
  EXPECT_GT(report->breakdown.back().line_pieces, 50u);
  for (const LevelBreakdown& level : report->breakdown) EXPECT_EQ(level.left_out, 0u);
}

}  // namespace
}  // namespace tind::test
