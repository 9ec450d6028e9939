// SPDX-License-Identifier: GPL-3.0-or-later
// tind-build report over tiny worlds: every figure is worked out again by brute force.
#include <cmath>
#include <fstream>
#include <numbers>

#include <fmt/format.h>
#include <gmock/gmock.h>

#include "core/drainage/compare.hpp"
#include "core/drainage/flow.hpp"
#include "storage/readers/gdal_raster.hpp"
#include "tests/storage/report_world.hpp"
#include "tests/support/test_field.hpp"

namespace tind::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

/// Sums of squared errors, once more.
struct Errors {
  double squares = 0, most = 0;
  int n = 0;

  void add(double e) {
    squares += e * e;
    most = std::max(most, std::abs(e));
    ++n;
  }
  double rmse() const { return std::sqrt(squares / n); }
};

void expect_errors(const json& figures, const Errors& errors, double tolerance) {
  EXPECT_EQ(figures["posts_measured"], errors.n);
  EXPECT_NEAR(figures["rmse_m"], errors.rmse(), tolerance);
  EXPECT_NEAR(figures["max_error_m"], errors.most, tolerance);
}

/// A raster of nodes over the world, as the manual describes it: straight from its words.
Errors bilinear_errors(const World& w, int rows, int cols, int& n_data) {
  std::vector<double> nodes;
  std::vector<bool> data;
  const auto lerp = [](double a, double b, double t) { return (1 - t) * a + t * b; };
  n_data = 0;
  for (int i = 0; i < rows; ++i) {
    for (int j = 0; j < cols; ++j) {
      const double v = i * (w.n_rows - 1.0) / (rows - 1), u = j * (w.n_cols - 1.0) / (cols - 1);
      // A node within a billionth of a post lies on it.
      const int r = static_cast<int>(v + 1e-9), c = static_cast<int>(u + 1e-9);
      const double fr = std::max(0.0, v - r) < 1e-9 ? 0 : v - r, fc = std::max(0.0, u - c) < 1e-9 ? 0 : u - c;
      const int r1 = fr > 0 ? r + 1 : r, c1 = fc > 0 ? c + 1 : c;
      const double z = lerp(lerp(w.at(r, c), w.at(r, c1), fc), lerp(w.at(r1, c), w.at(r1, c1), fc), fr);
      nodes.push_back(z);
      data.push_back(!std::isnan(z));
      n_data += !std::isnan(z);
    }
  }
  Errors errors;
  for (int r = 0; r < w.n_rows; ++r) {
    for (int c = 0; c < w.n_cols; ++c) {
      if (std::isnan(w.at(r, c))) continue;
      const double v = r * (rows - 1.0) / (w.n_rows - 1), u = c * (cols - 1.0) / (w.n_cols - 1);
      const int i = static_cast<int>(v + 1e-9), j = static_cast<int>(u + 1e-9);
      const double fi = v - i < 1e-9 ? 0 : v - i, fj = u - j < 1e-9 ? 0 : u - j;
      const int i1 = fi > 0 ? i + 1 : i, j1 = fj > 0 ? j + 1 : j;
      const auto z = [&](int a, int b) { return nodes[static_cast<std::size_t>(a * cols + b)]; };
      const double height = lerp(lerp(z(i, j), z(i, j1), fj), lerp(z(i1, j), z(i1, j1), fj), fi);
      if (!std::isnan(height)) errors.add(height - w.at(r, c));
    }
  }
  return errors;
}

TEST_F(ReportTest, EveryFigureOfTheSurfacesIsThatOfBruteForce) {
  const World w = mountains();
  const std::string dem = write(w, "dem.asc");
  const std::string file = build(options(dem, "dem.tind"));
  const json j = report({file, "--source", dem, "--compare", "bilinear", "--levels", "8-"});
  const Tiles tiles(file);
  const Lattice& lattice = tiles.manifest.lattice;
  int n_posts = 0;
  for (const float h : w.heights_m) n_posts += !std::isnan(h);
  EXPECT_EQ(j["posts"], n_posts);
  ASSERT_EQ(j["levels"].size(), static_cast<std::size_t>(tiles.manifest.bottom_level - 7));

  for (const json& level : j["levels"]) {
    const int l = level["level"];
    SCOPED_TRACE(fmt::format("level {}", l));
    const LevelInfo& info = tiles.manifest.levels[static_cast<std::size_t>(l)];
    Errors errors;
    for (int r = 0; r < w.n_rows; ++r) {
      for (int c = 0; c < w.n_cols; ++c) {
        if (std::isnan(w.at(r, c))) continue;
        errors.add(tiles.height_m(l, w.lattice_x(lattice, c), w.lattice_y(lattice, r)) - double{w.at(r, c)});
      }
    }
    expect_errors(level["tin"], errors, 1e-5);
    EXPECT_NEAR(level["tin"]["max_error_m"].get<double>(), info.max_error_m, 1e-4);
    EXPECT_NEAR(level["tin"]["rmse_m"].get<double>(), info.rmse_m, 1e-4);
    EXPECT_LE(level["tin"]["max_error_m"].get<double>(), info.tolerance_m);

    int in_data = 0, in_voids = 0, outside = 0;
    for (const auto& [x, y] : tiles.vertices(l)) {
      const double c = (lattice.longitude_deg(x) - w.west) / w.spacing,
                   r = (lattice.latitude_deg(y) - w.south) / w.spacing;
      const auto cc = std::lround(c), rr = std::lround(r);
      if (rr < 0 || cc < 0 || rr >= w.n_rows || cc >= w.n_cols) {
        ++outside;
      } else {
        ++(std::isnan(w.at(static_cast<int>(rr), static_cast<int>(cc))) ? in_voids : in_data);
      }
    }
    EXPECT_EQ(level["tin"]["points"], in_data);
    EXPECT_EQ(level["points_in_voids"], in_voids);
    EXPECT_EQ(level["points_outside"], outside);
    EXPECT_EQ(static_cast<std::uint64_t>(in_data + in_voids + outside), info.n_vertices);
    EXPECT_NEAR(level["tin"]["percent_of_posts"], 100.0 * in_data / n_posts, 1e-9);
    EXPECT_NEAR(level["tin"]["points_per_km2"].get<double>() * j["area_km2"].get<double>(), in_data, 1e-6);

    for (const char* raster : {"bilinear_same_spacing", "bilinear_same_points"}) {
      SCOPED_TRACE(raster);
      const json& figures = level[raster];
      int n_data = 0;
      const Errors of_raster = bilinear_errors(w, figures["nodes"][0], figures["nodes"][1], n_data);
      expect_errors(figures, of_raster, 2e-3);  // heights are floats: 1e-4 m each
      EXPECT_EQ(figures["points"], n_data);
    }
    // Nodes every 2^k posts, as many as fit.
    const double step = std::max(1.0, info.spacing_m / (w.spacing * 6378137 * std::numbers::pi / 180));
    EXPECT_NEAR(level["bilinear_same_spacing"]["nodes"][0].get<double>(), 1 + (w.n_rows - 1) / step, 0.5001);
    if (in_data > 30) {
      EXPECT_NEAR(level["bilinear_same_points"]["points"].get<double>() / in_data, 1, 0.1);
    }
  }
}

TEST_F(ReportTest, AreaIsThatOfTheCellsOnTheEllipsoid) {
  const World w = mountains();
  const std::string dem = write(w, "dem.asc");
  const json j = report({build(options(dem, "dem.tind")), "--source", dem, "--no-streams"});
  // Meridian and prime-vertical radii, a thousand slices a cell.
  const double a = 6378137, f = 1 / 298.257223563, e2 = f * (2 - f), rad = std::numbers::pi / 180;
  double area = 0;
  for (int r = 0; r < w.n_rows; ++r) {
    double cell = 0;
    for (int k = 0; k < 1000; ++k) {
      const double lat = (w.south + (r - 0.5 + (k + 0.5) / 1000) * w.spacing) * rad, s = std::sin(lat);
      const double n = a / std::sqrt(1 - e2 * s * s), m = a * (1 - e2) / std::pow(1 - e2 * s * s, 1.5);
      cell += m * n * std::cos(lat) * w.spacing * rad * w.spacing * rad / 1000;
    }
    for (int c = 0; c < w.n_cols; ++c) area += std::isnan(w.at(r, c)) ? 0 : cell / 1e6;
  }
  EXPECT_NEAR(j["area_km2"].get<double>(), area, 1e-6 * area);
}

/// Streams of a surface over the posts of a world, by the parts of core that have tests of their own. Voids take part
/// and carry no stream.
std::vector<StreamPost> streams_of(const World& w, std::vector<float> heights, const std::vector<float>& latitudes,
                                   double cells) {
  std::vector<std::uint8_t> marks(heights.size()), directions(heights.size()), mask(heights.size());
  FlowGrid g = make_flow_grid(heights.data(), w.n_rows, w.n_cols, 1, 1, marks.data());
  const double a = 6378137, f = 1 / 298.257223563, e2 = f * (2 - f), step = w.spacing * std::numbers::pi / 180;
  const auto sizes = [&](double lat_deg) {
    const double lat = lat_deg * std::numbers::pi / 180, s = 1 - e2 * std::sin(lat) * std::sin(lat);
    return std::pair(a / std::sqrt(s) * std::cos(lat) * step, a * (1 - e2) / std::pow(s, 1.5) * step);
  };
  const auto middle = sizes((latitudes.front() + latitudes.back()) / 2);
  for (int r = 0; r < w.n_rows; ++r) {
    const auto i = static_cast<std::size_t>(r);
    g.east_m[i] = sizes(double{latitudes[i]}).first;
    g.north_m[i] = sizes(double{latitudes[i]} + w.spacing / 2).second;
    const double share = g.east_m[i] * g.north_m[i] / (middle.first * middle.second);
    g.share[i] = static_cast<std::uint64_t>(std::llround(share * double{kCell}));
  }
  mark_outlets(g);
  std::vector<float> filled(heights.size());
  std::vector<FlatSteps> steps(heights.size());
  std::vector<std::uint64_t> sums(heights.size());
  fill_depressions(g, kBlockSide, filled.data());
  direct_flow(g, kBlockSide, filled.data(), steps.data(), directions.data());
  accumulate_flow(g, kBlockSide, directions.data(), sums.data());
  for (std::size_t i = 0; i < mask.size(); ++i) {
    mask[i] = !std::isnan(w.heights_m[i]) && static_cast<double>(sums[i]) >= cells * double{kCell};
  }
  return stream_posts(w.n_rows, w.n_cols, mask.data(), directions.data());
}

TEST_F(ReportTest, StreamsAreThoseOfTheSampledSurfaces) {
  World w = mountains();
  // A slope without basins (no stream is looked for there) and voids (their filling is the builder's affair).
  const HeightAt rough = rough_terrain(4, 300);
  for (int r = 0; r < w.n_rows; ++r) {
    for (int c = 0; c < w.n_cols; ++c) {
      w.heights_m[static_cast<std::size_t>(r * w.n_cols + c)] = std::stof(fmt::format("{:.2f}", rough(r, c) + 15 * r));
    }
  }
  const std::string dem = write(w, "dem.asc");
  const std::string file = build(options(dem, "dem.tind"));
  const json j = report({file, "--source", dem, "--compare", "bilinear"});
  const Tiles tiles(file);
  std::vector<float> latitudes;
  for (int r = 0; r < w.n_rows; ++r) latitudes.push_back(static_cast<float>(w.south + r * w.spacing));
  int n_compared = 0;
  for (const json& level : j["levels"]) {
    const int l = level["level"];
    SCOPED_TRACE(fmt::format("level {}", l));
    const double cells = 8 * std::pow(2, tiles.manifest.bottom_level - l);
    EXPECT_EQ(level["stream_threshold_cells"], cells);
    std::vector<float> tin;
    for (int r = 0; r < w.n_rows; ++r) {
      for (int c = 0; c < w.n_cols; ++c) {
        tin.push_back(static_cast<float>(
            tiles.height_m(l, w.lattice_x(tiles.manifest.lattice, c), w.lattice_y(tiles.manifest.lattice, r))));
      }
    }
    const auto reference = streams_of(w, w.heights_m, latitudes, cells),
               extracted = streams_of(w, tin, latitudes, cells);
    const StreamMatch match = compare_streams(w.n_rows, w.n_cols, extracted, reference, 2);
    const json& streams = level["tin"]["streams"];
    // A height that differs in its last bit may turn one post's water: one post in a hundred.
    EXPECT_NEAR(streams["quality"], match.quality(), 0.01);
    EXPECT_NEAR(streams["completeness"], match.completeness(), 0.01);
    EXPECT_NEAR(streams["correctness"], match.correctness(), 0.01);
    EXPECT_NEAR(streams["mean_distance_cells"], match.mean_distance, 0.05);
    EXPECT_NEAR(streams["reference_length_cells"], match.reference_length, 1e-9);
    EXPECT_TRUE(level.contains("unconstrained"));
    n_compared += match.reference_length > 0 && match.quality() > 0 && match.quality() < 1;
  }
  EXPECT_GE(n_compared, 3);
  // The raster with the posts' own spacing is the source.
  const json& same = j["levels"].back()["bilinear_same_spacing"];
  EXPECT_EQ(same["rmse_m"], 0);
  EXPECT_EQ(same["streams"]["quality"], 1);
  EXPECT_EQ(same["streams"]["mean_distance_cells"], 0);
}

TEST_F(ReportTest, BufferAndThresholdsAreTheUsers) {
  const World w = mountains();
  const std::string dem = write(w, "dem.asc"), file = build(options(dem, "dem.tind"));
  const json near = report({file, "--source", dem, "--levels", "11", "--buffer", "0"});
  const json far = report({file, "--source", dem, "--levels", "11", "--buffer", "4"});
  EXPECT_LT(near["levels"][0]["tin"]["streams"]["quality"], far["levels"][0]["tin"]["streams"]["quality"]);
  EXPECT_EQ(near["levels"][0]["tin"]["streams"]["mean_distance_cells"], 0);
  const json few =
      report({file, "--source", dem, "--levels", "13", "--drainage-cells", "100", "--drainage-growth", "3"});
  EXPECT_EQ(few["levels"][0]["stream_threshold_cells"], 100);
  EXPECT_LT(few["levels"][0]["tin"]["streams"]["reference_length_cells"],
            near["levels"][0]["tin"]["streams"]["reference_length_cells"]);
}

TEST_F(ReportTest, UnconstrainedFileGivesTheFiguresOfTheOneBuiltHere) {
  const World w = mountains();
  const std::string dem = write(w, "dem.asc"), file = build(options(dem, "dem.tind"));
  BuildOptions plain = options(dem, "plain.tind");
  plain.lines.drainage = false;
  const std::string other = build(plain);
  const json here = report({file, "--source", dem}), given = report({file, "--source", dem, "--unconstrained", other});
  EXPECT_EQ(here, given);
  const json of_other = report({other, "--source", dem});
  EXPECT_FALSE(of_other["levels"].back().contains("unconstrained"));
  EXPECT_THAT(of_other["notes"].dump(), HasSubstr("no unconstrained TIN"));
  EXPECT_EQ(of_other["levels"].back()["tin"]["points"], here["levels"].back()["unconstrained"]["points"]);
  EXPECT_NE(here["levels"].back()["tin"]["points"], here["levels"].back()["unconstrained"]["points"]);
}

TEST_F(ReportTest, FiguresDoNotDependOnThreads) {
  const std::string dem = write(mountains(), "dem.asc"), file = build(options(dem, "dem.tind"));
  const Output one = run({file, "--source", dem, "--compare", "bilinear", "--threads", "1", "-q"});
  const Output four = run({file, "--source", dem, "--compare", "bilinear", "--threads", "4", "-q"});
  EXPECT_EQ(one.status, 0) << one.err;
  EXPECT_EQ(one.out, four.out);
  EXPECT_EQ(one.err, "");
}

TEST_F(ReportTest, TableIsAtMost130ColumnsWideAndSaysWhatItsWordsMean) {
  const std::string dem = write(mountains(), "dem.asc"), file = build(options(dem, "dem.tind"));
  const Output table = run({file, "--source", dem, "--compare", "bilinear", "-q"});
  ASSERT_EQ(table.status, 0) << table.err;
  std::istringstream lines(table.out);
  for (std::string line; std::getline(lines, line);) EXPECT_LE(line.size(), 130u) << line;
  for (const char* word :
       {"% posts", "per km2", "RMSE m", "E_max m", "bilinear, as many points", "compl: share", "R/E:"}) {
    EXPECT_THAT(table.out, HasSubstr(word));
  }
}

TEST_F(ReportTest, PointsAreMeasuredAtTheirOwnPlaces) {
  // A text file of points, 1 / 40 of a spacing off a grid.
  const HeightAt rough = rough_terrain(5, 200);
  std::vector<std::array<double, 3>> points;
  std::string text = "lon,lat,height\n";
  for (int r = 0; r < 40; ++r) {
    for (int c = 0; c < 40; ++c) {
      const double lon = 7 + 0.0005 * (c + noise(1, r, c) / 40), lat = 46 + 0.0004 * (r + noise(2, r, c) / 40);
      const std::string line = fmt::format("{:.9f},{:.9f},{:.2f}\n", lon, lat, rough(r, c));
      text += line;
      points.push_back({std::stod(fmt::format("{:.9f}", lon)), std::stod(fmt::format("{:.9f}", lat)),
                        double{std::stof(fmt::format("{:.2f}", rough(r, c)))}});
    }
  }
  std::ofstream(path("points.csv")) << text;
  BuildOptions o = options(path("points.csv"), "points.tind");
  o.levels.finest_m.reset();
  o.source.points.source_crs = "EPSG:4326";
  const std::string file = build(o);
  const json j = report({file, "--source", path("points.csv"), "--compare", "bilinear", "--no-streams"});
  const Tiles tiles(file);
  EXPECT_EQ(j["posts"], points.size());
  EXPECT_EQ(j["source_kind"], "points");
  for (const json& level : j["levels"]) {
    Errors errors;
    for (const auto& [lon, lat, height] : points) {
      const double step = tiles.manifest.lattice.step_deg();
      errors.add(tiles.height_m(level["level"], (lon + 180) / step, (lat + 90) / step) - height);
    }
    expect_errors(level["tin"], errors, 1e-4);
    EXPECT_GT(level["bilinear_same_points"]["rmse_m"].get<double>(), 0);
    EXPECT_LE(level["bilinear_same_points"]["posts_measured"], points.size());
    EXPECT_GT(level["bilinear_same_points"]["posts_measured"].get<double>(), 0.8 * static_cast<double>(points.size()));
  }
}

}  // namespace
}  // namespace tind::test
