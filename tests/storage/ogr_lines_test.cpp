// SPDX-License-Identifier: GPL-3.0-or-later
// Tiny vector files as text (GeoJSON, WKT in CSV, OGR VRT) through read_break_lines.
#include "storage/readers/ogr_lines.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <numbers>
#include <random>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "storage/readers/line_writer.hpp"
#include "storage/readers/noding.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

class OgrLinesTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-ogr-lines-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
    // 2 x 2 degrees with posts every 3 seconds.
    options_.lattice.level = 10;
    options_.dx = options_.dy = 1.0 / 1200 / options_.lattice.step_deg();
    options_.west_x = x(-106);
    options_.east_x = x(-104);
    options_.south_y = y(37);
    options_.north_y = y(39);
    options_.surface_m = [this](std::int64_t at_x, std::int64_t at_y) { return surface(at_x, at_y); };
    options_.max_change_m = 5;
  }
  void TearDown() override { fs::remove_all(folder_); }

  std::int64_t x(double lon) const { return std::llround((lon + 180) / options_.lattice.step_deg()); }
  std::int64_t y(double lat) const { return std::llround((lat + 90) / options_.lattice.step_deg()); }
  /// A plane: 1000 m at (-105, 38), 1 m up per 0.01 degrees east.
  double surface(std::int64_t at_x, std::int64_t) const {
    return 1000 + (options_.lattice.longitude_deg(at_x) + 105) * 100;
  }

  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ / name, std::ios::binary) << text;
    return path(name);
  }
  std::string bytes_of(const std::string& name) const {
    std::ifstream in(path(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  /// A GeoJSON file of geometries given as {type, coordinates}; ids count from 0.
  std::string write_json(const std::string& name,
                         const std::vector<std::pair<std::string, std::string>>& geometries) const {
    std::string features;
    for (const auto& [type, coordinates] : geometries) {
      features +=
          fmt::format(R"({}{{"type":"Feature","properties":{{}},"geometry":{}}})", features.empty() ? "" : ",",
                      type.empty() ? "null" : fmt::format(R"({{"type":"{}","coordinates":{}}})", type, coordinates));
    }
    return write(name, fmt::format(R"({{"type":"FeatureCollection","features":[{}]}})", features));
  }
  /// A CSV of WKT geometries without a CRS; ids count from 1.
  std::string write_csv(const std::string& name, const std::vector<std::string>& wkt) const {
    std::string text = "WKT,n\n";
    for (const std::string& g : wkt) text += fmt::format("\"{}\",1\n", g);
    return write(name, text);
  }
  /// The same with a CRS.
  std::string write_vrt(const std::string& name, const std::vector<std::string>& wkt, const std::string& crs) const {
    write_csv(name + ".csv", wkt);
    return write(
        name, fmt::format(
                  R"(<OGRVRTDataSource><OGRVRTLayer name="{0}"><SrcDataSource relativeToVRT="1">{0}.csv</SrcDataSource>
<LayerSRS>{1}</LayerSRS></OGRVRTLayer></OGRVRTDataSource>)",
                  name, crs));
  }

  Result<BreakLines> read(const std::string& spec, bool lakes = false) const {
    const BreakLineFile files[] = {{spec, lakes}};
    return read_break_lines(files, options_);
  }
  Error error_of(const std::string& spec, bool lakes = false) const {
    auto lines = read(spec, lakes);
    EXPECT_FALSE(lines);
    return lines ? Error{} : lines.error();
  }
  BreakLines lines_of(const std::string& spec, bool lakes = false) const {
    auto lines = read(spec, lakes);
    EXPECT_TRUE(lines) << lines.error().message;
    if (!lines) return {};
    check(*lines);
    return *lines;
  }
  /// What holds for every result.
  void check(const BreakLines& lines) const {
    std::vector<LatticeLine> chains;
    ASSERT_EQ(lines.is_shore.size(), lines.chains.size());
    for (const BreakChain& chain : lines.chains) {
      ASSERT_GE(chain.vertices.size(), 2U);
      EXPECT_EQ(chain.weight, options_.weight);
      for (std::size_t i = 0; i < chain.vertices.size(); ++i) {
        const BreakVertex& v = chain.vertices[i];
        EXPECT_TRUE(options_.west_x <= v.x && v.x <= options_.east_x && options_.south_y <= v.y &&
                    v.y <= options_.north_y);
        EXPECT_LE(std::abs(v.height_m - options_.surface_m(v.x, v.y)), options_.max_change_m + 1e-9);
        if (i == 0) continue;
        const BreakVertex& u = chain.vertices[i - 1];
        EXPECT_TRUE(u.x != v.x || u.y != v.y);
        EXPECT_LE(static_cast<double>(std::abs(u.x - v.x)), options_.dx * 65 / 64 + 2);
        EXPECT_LE(static_cast<double>(std::abs(u.y - v.y)), options_.dy * 65 / 64 + 2);
      }
      chains.push_back(chain.vertices);
    }
    const auto again = node_lines(chains);
    ASSERT_TRUE(again);
    EXPECT_TRUE(again->meetings.empty()) << "chains meet elsewhere than in their ends";
    EXPECT_TRUE(std::is_sorted(lines.chains.begin(), lines.chains.end(), [](const BreakChain& a, const BreakChain& b) {
      const auto key = [](const BreakVertex& v) { return std::pair{v.x, v.y}; };
      return std::min(key(a.vertices.front()), key(a.vertices.back())) <
             std::min(key(b.vertices.front()), key(b.vertices.back()));
    }));
  }

  fs::path folder_;
  BreakLineOptions options_;
};

// Lines and rings

TEST_F(OgrLinesTest, LineWithoutHeightsLiesOnTheSurfaceAtEveryPost) {
  const BreakLines lines = lines_of(write_json("a.json", {{"LineString", "[[-105.5,38],[-105.4,38.05]]"}}));
  ASSERT_EQ(lines.chains.size(), 1U);
  const std::vector<BreakVertex>& v = lines.chains.at(0).vertices;
  EXPECT_EQ(v.size(), 121U);  // 0.1 degrees are 120 posts
  EXPECT_EQ(v.front(), (BreakVertex{x(-105.5), y(38), surface(x(-105.5), 0)}));
  EXPECT_EQ(v.back(), (BreakVertex{x(-105.4), y(38.05), surface(x(-105.4), 0)}));
  for (const BreakVertex& p : v) EXPECT_EQ(p.height_m, surface(p.x, p.y));
  EXPECT_THAT(lines.notes, IsEmpty());
  ASSERT_EQ(lines.sources.size(), 1U);
  EXPECT_EQ(lines.sources[0].name, "a.json");
  EXPECT_EQ(lines.sources[0].sha256.size(), 64U);
}

TEST_F(OgrLinesTest, AllKindsOfLinesAreTaken) {
  const BreakLines lines = lines_of(write_csv(
      "a.csv",
      {"LINESTRING(-105.9 37.1,-105.8 37.1)", "MULTILINESTRING((-105.9 37.2,-105.8 37.2),(-105.9 37.3,-105.8 37.3))",
       "POLYGON((-105.9 37.4,-105.8 37.4,-105.8 37.49,-105.9 37.4),(-105.82 37.41,-105.81 37.41,-105.81 37.42,-105.82 "
       "37.41))",
       "MULTIPOLYGON(((-105.9 37.5,-105.8 37.5,-105.8 37.59,-105.9 37.5)))",
       "GEOMETRYCOLLECTION(POINT(-105 38),LINESTRING(-105.9 37.6,-105.8 37.6))",
       "CIRCULARSTRING(-105.9 37.7,-105.85 37.75,-105.8 37.7)",
       "COMPOUNDCURVE((-105.9 37.8,-105.8 37.8),CIRCULARSTRING(-105.8 37.8,-105.7 37.9,-105.6 37.8))",
       "CURVEPOLYGON(CIRCULARSTRING(-105.9 38.1,-105.8 38.2,-105.7 38.1,-105.8 38,-105.9 38.1))",
       "TIN(((-105.9 38.3,-105.8 38.3,-105.8 38.39,-105.9 38.3)))", "POINT(-105 38)",
       "MULTIPOINT(-105 38,-105.1 38)"}));
  EXPECT_EQ(lines.chains.size(), 11U);
  EXPECT_EQ(lines.counts.points, 4);
  EXPECT_THAT(lines.notes, Contains(HasSubstr("4 points were left out")));
  // The arc, not its chord.
  const auto arc = std::find_if(lines.chains.begin(), lines.chains.end(), [&](const BreakChain& c) {
    return c.vertices.front().y == y(37.7) && c.vertices.front().x == x(-105.9);
  });
  ASSERT_NE(arc, lines.chains.end());
  const auto top = std::max_element(arc->vertices.begin(), arc->vertices.end(),
                                    [](const BreakVertex& a, const BreakVertex& b) { return a.y < b.y; });
  EXPECT_NEAR(options_.lattice.latitude_deg(top->y), 37.75, 1e-4);
}

TEST_F(OgrLinesTest, RingIsOneClosedChain) {
  const BreakLines lines =
      lines_of(write_json("a.json", {{"Polygon", "[[[-105.5,38],[-105.4,38],[-105.4,38.1],[-105.5,38]]]"}}));
  ASSERT_EQ(lines.chains.size(), 1U);
  EXPECT_EQ(lines.chains.at(0).vertices.front(), lines.chains.at(0).vertices.back());
  EXPECT_FALSE(lines.is_shore[0]);
}

TEST_F(OgrLinesTest, LineIsCutAtTheDataAndMayComeBack) {
  const BreakLines lines = lines_of(
      write_json("a.json", {{"LineString", "[[-107,38],[-105.9,38],[-105.9,36.5],[-105.8,36.5],[-105.8,37.1]]"}}));
  ASSERT_EQ(lines.chains.size(), 2U);
  EXPECT_EQ(lines.chains.at(0).vertices.front().x, options_.west_x);
  EXPECT_EQ(lines.chains.at(0).vertices.back().y, options_.south_y);
  EXPECT_EQ(lines.chains.at(1).vertices.front().y, options_.south_y);
  EXPECT_EQ(lines.counts.cut, 1);
}

TEST_F(OgrLinesTest, LinesOutsideAreCounted) {
  const BreakLines lines = lines_of(
      write_json("a.json", {{"LineString", "[[-107,38],[-106.5,38]]"}, {"LineString", "[[-105,38],[-105.1,38]]"}}));
  EXPECT_EQ(lines.chains.size(), 1U);
  EXPECT_EQ(lines.counts.outside, 1);
}

// Repair

TEST_F(OgrLinesTest, RepeatedAndZeroLengthPiecesAreDroppedAndNamed) {
  const BreakLines lines =
      lines_of(write_json("a.json", {{"LineString", "[[-105.5,38],[-105.5,38],[-105.4,38],[-105.4000000001,38]]"},
                                     {"LineString", "[[-105.2,38],[-105.2,38],[-105.2,38]]"},
                                     {"LineString", "[[-105.1,38]]"}}));
  EXPECT_EQ(lines.chains.size(), 1U);
  EXPECT_EQ(lines.counts.repeated, 4);
  EXPECT_THAT(lines.notes,
              Contains(AllOf(HasSubstr("4 vertices on the same lattice point as the one before were dropped"),
                             HasSubstr("feature 0, feature 1"))));
  EXPECT_THAT(lines.notes, Contains(HasSubstr("1 lines that shrink to one lattice point were left out: feature 1")));
  EXPECT_THAT(lines.notes, Contains(HasSubstr("1 lines of one point were left out: feature 2")));
}

TEST_F(OgrLinesTest, NothingLeftIsSaid) {
  const BreakLines lines = lines_of(write_json("a.json", {{"LineString", "[[-105.2,38],[-105.2,38]]"}}));
  EXPECT_THAT(lines.chains, IsEmpty());
  EXPECT_THAT(lines.notes, Contains("break lines: nothing is left to follow"));
}

TEST_F(OgrLinesTest, MissingAndEmptyGeometriesAreNamed) {
  const BreakLines lines = lines_of(write_json(
      "a.json", {{"", ""}, {"LineString", "[[-105.5,38],[-105.4,38]]"}, {"LineString", "[]"}, {"Polygon", "[]"}}));
  EXPECT_EQ(lines.chains.size(), 1U);
  EXPECT_THAT(lines.notes,
              Contains(HasSubstr("3 features without a geometry were left out: feature 0, feature 2, feature 3")));
}

TEST_F(OgrLinesTest, VerticesThatAreNoNumbersCutTheLine) {
  // GDAL writes no such file, so numbers to be found again are overwritten.
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN(), kInf = std::numeric_limits<double>::infinity();
  constexpr double kForNan = -105.70001234, kForInf = -105.60001234, kForNanHeight = 1234.56789;
  const auto line = [](std::vector<std::array<double, 3>> vertices) {
    return OutputLine{std::move(vertices), "breakline", {}, {}, 0};
  };
  const OutputLayer layer{
      "lines",
      {line({{-105.9, 38, 1}, {-105.8, 38, 1}, {kForNan, 38, 1}, {-105.6, 38, 1}, {-105.5, 38, 1}}),
       line({{-105.9, 37, 1}, {kForInf, 37, 1}, {-105.8, 37, 1}}),
       line({{-105.9, 37.5, 1}, {-105.8, 37.5, kForNanHeight}}), line({{-105.9, 95, 1}, {-105.8, 37.5, 1}})}};
  ASSERT_TRUE(write_lines(path("a.gpkg"), std::vector<OutputLayer>{layer}, false));
  std::string bytes = bytes_of("a.gpkg");
  for (const auto& [from, to] : {std::pair{kForNan, kNan}, {kForInf, kInf}, {kForNanHeight, kNan}}) {
    const std::string pattern(reinterpret_cast<const char*>(&from), sizeof from);
    std::size_t n = 0;
    for (std::size_t at = 0; (at = bytes.find(pattern, at)) != std::string::npos; ++n)
      std::memcpy(&bytes[at], &to, sizeof to);
    ASSERT_GE(n, 1U);
  }
  const BreakLines lines = lines_of(write("b.gpkg", bytes));
  EXPECT_EQ(lines.chains.size(), 3U);
  EXPECT_THAT(lines.notes, Contains(HasSubstr("3 vertices that are no numbers or not on the globe were left out, the "
                                              "lines cut there: feature 1, feature 2, feature 4")));
  EXPECT_THAT(lines.notes, Contains(HasSubstr("3 lines of one point were left out: feature 2, feature 4")));
  EXPECT_THAT(lines.notes, Contains(HasSubstr("1 heights that are no numbers")));
}

TEST_F(OgrLinesTest, CrossingLinesAreCutAndNamed) {
  const BreakLines lines = lines_of(write_json(
      "a.json", {{"LineString", "[[-105.5,38],[-105.4,38.1]]"}, {"LineString", "[[-105.5,38.1],[-105.4,38]]"}}));
  EXPECT_EQ(lines.chains.size(), 4U);
  EXPECT_EQ(lines.counts.meetings, 1);
  EXPECT_THAT(lines.notes,
              Contains(AllOf(HasSubstr("1 places where lines cross, or touch elsewhere than in their ends: cut there"),
                             HasSubstr("a.json feature 0 and a.json feature 1 at -105.4"))));
}

TEST_F(OgrLinesTest, LinesOnTopOfEachOtherAreKeptOnce) {
  // The same border with and without a vertex in the middle, and once more backwards.
  const BreakLines lines = lines_of(write_json("a.json", {{"LineString", "[[-105.5,38],[-105.3,38]]"},
                                                          {"LineString", "[[-105.5,38],[-105.43,38],[-105.3,38]]"},
                                                          {"LineString", "[[-105.3,38],[-105.5,38]]"}}));
  std::size_t n = 0;
  for (const BreakChain& chain : lines.chains) n += chain.vertices.size() - 1;
  EXPECT_EQ(n, 240U);
  EXPECT_GT(lines.counts.shared, 0);
  EXPECT_THAT(lines.notes, Contains(AllOf(HasSubstr("stretches run on top of each other: kept once: "),
                                          HasSubstr("a.json feature 0 and a.json feature 1 from -105.5"))));
}

TEST_F(OgrLinesTest, NeighbouringPolygonsShareTheirBorder) {
  const std::string border = "-105.4 38.03,-105.41 38.071,-105.4 38.1";
  const std::string back = "-105.4 38.1,-105.41 38.071,-105.4 38.03";
  const BreakLines lines = lines_of(write_csv("a.csv", {fmt::format("POLYGON((-105.5 38,{},-105.5 38))", border),
                                                        fmt::format("POLYGON((-105.3 38,{},-105.3 38))", back)}));
  EXPECT_EQ(lines.chains.size(), 3U);
}

TEST_F(OgrLinesTest, FigureEightAndBowTieAreCutAtThemselves) {
  const BreakLines lines = lines_of(
      write_json("a.json", {{"LineString", "[[-105.5,38],[-105.4,38.1],[-105.4,38],[-105.5,38.1],[-105.5,38]]"},
                            {"Polygon", "[[[-105.3,38],[-105.2,38.1],[-105.2,38],[-105.3,38.1],[-105.3,38]]]"}}));
  EXPECT_EQ(lines.chains.size(), 4U);
  EXPECT_THAT(lines.notes, Contains(AllOf(HasSubstr("a.json feature 0 with itself at"),
                                          HasSubstr("a.json feature 1 with itself at"))));
}

TEST_F(OgrLinesTest, OrderOfFilesAndFeaturesDoesNotMatter) {
  std::mt19937_64 random(31);
  std::vector<std::pair<std::string, std::string>> features;
  for (int i = 0; i < 24; ++i) {
    std::string text;
    for (int j = 0; j < 4; ++j) {
      text +=
          fmt::format("{}[{:.7f},{:.7f},{}]", j == 0 ? "" : ",", -105.9 + static_cast<double>(random() % 1000) * 1e-3,
                      37.1 + static_cast<double>(random() % 1000) * 1e-3, 990 + static_cast<int>(random() % 20));
    }
    features.emplace_back("LineString", "[" + text + "]");
  }
  const auto half = [&](bool second) {
    const auto middle = features.begin() + 12;
    return std::vector(second ? middle : features.begin(), second ? features.end() : middle);
  };
  const BreakLineFile before[] = {{write_json("a.json", half(false)), false},
                                  {write_json("b.json", half(true)), false}};
  const auto first = read_break_lines(before, options_);
  std::shuffle(features.begin(), features.end(), random);
  const BreakLineFile after[] = {{write_json("c.json", half(false)), false}, {write_json("d.json", half(true)), false}};
  const auto second = read_break_lines(after, options_);
  ASSERT_TRUE(first && second);
  check(*first);
  ASSERT_EQ(first->chains.size(), second->chains.size());
  for (std::size_t i = 0; i < first->chains.size(); ++i)
    ASSERT_EQ(first->chains[i].vertices, second->chains[i].vertices) << "chain " << i;
}

TEST_F(OgrLinesTest, HundredThousandVerticesAreRead) {
  std::string text;
  for (int i = 0; i < 100'000; ++i) {
    const double t = i * 2e-3;
    text += fmt::format("{}{:.7f} {:.7f}", i == 0 ? "" : ",", -105 + 0.9 * std::cos(t) * std::cos(t / 200),
                        38 + 0.9 * std::sin(t * 1.001) * std::cos(t / 200));
  }
  const auto lines = read(write_csv("a.csv", {"LINESTRING(" + text + ")"}));
  ASSERT_TRUE(lines) << lines.error().message;
  EXPECT_GT(lines->counts.meetings, 10);
  EXPECT_GT(lines->counts.vertices, 100'000);
}

// Heights

TEST_F(OgrLinesTest, HeightsOfTheLineAreKeptWithinThePromise) {
  const BreakLines lines = lines_of(write_json("a.json", {{"LineString", "[[-105.01,38,1003],[-105,38,998]]"}}));
  EXPECT_EQ(lines.chains.at(0).vertices.front().height_m, 1003);
  EXPECT_EQ(lines.chains.at(0).vertices.back().height_m, 998);
  EXPECT_NEAR(lines.chains.at(0).vertices[6].height_m, 1000.5, 0.01);
  EXPECT_EQ(lines.counts.limited, 0);
  EXPECT_THAT(lines.notes, IsEmpty());
}

TEST_F(OgrLinesTest, HeightsBeyondThePromiseAreLimitedAndNamed) {
  const BreakLines lines =
      lines_of(write_json("a.json", {{"LineString", "[[-105.01,38,999],[-105,38,1000]]"},
                                     {"LineString", "[[-105.01,38.1,1100],[-105.0000005,38.1,1300]]"}}));
  EXPECT_EQ(lines.chains.at(1).vertices.front().height_m, surface(x(-105.01), 0) + 5);
  EXPECT_NEAR(lines.chains.at(1).vertices.back().height_m, 1005, 1e-3);
  EXPECT_EQ(lines.counts.limited, static_cast<std::int64_t>(lines.chains.at(1).vertices.size()));
  EXPECT_NEAR(lines.counts.largest_change_m, 295, 1e-3);
  EXPECT_THAT(lines.notes, Contains(AllOf(HasSubstr("off the surface by more than 5 m"),
                                          HasSubstr("a.json feature 1 by 300.00 m at -105.00000"))));
}

TEST_F(OgrLinesTest, LowerOfTwoLinesGivesTheHeightOfTheirNode) {
  const BreakLines lines = lines_of(write_json("a.json", {{"LineString", "[[-105.01,38,1002],[-104.99,38,1002]]"},
                                                          {"LineString", "[[-105,37.99,998],[-105,38.01,999]]"}}));
  ASSERT_EQ(lines.chains.size(), 4U);
  int n = 0;
  for (const BreakChain& chain : lines.chains) {
    for (const BreakVertex& v : chain.vertices) {
      if (v.x != x(-105) || v.y != y(38)) continue;
      ++n;
      EXPECT_NEAR(v.height_m, 998.5, 1e-3);
    }
  }
  EXPECT_EQ(n, 4);
}

TEST_F(OgrLinesTest, LowerOfTwoHeightsOfOnePointCounts) {
  const BreakLines lines = lines_of(
      write_json("a.json", {{"LineString", "[[-105.0005,38,1001],[-105,38,1002],[-105,38,998],[-104.9995,38,1001]]"}}));
  const auto& v = lines.chains.at(0).vertices;
  EXPECT_EQ(std::count_if(v.begin(), v.end(), [](const BreakVertex& p) { return p.height_m == 998; }), 1);
}

TEST_F(OgrLinesTest, ZeroHeightsThroughoutAreNone) {
  const BreakLines lines = lines_of(write_json("a.json", {{"LineString", "[[-105.01,38,0],[-105,38,0]]"}}));
  EXPECT_NEAR(lines.chains.at(0).vertices.back().height_m, 1000, 1e-3);
  EXPECT_EQ(lines.counts.limited, 0);
  EXPECT_THAT(lines.notes, Contains("a.json: all heights are 0: taken as lines without heights"));
}

TEST_F(OgrLinesTest, AbsurdHeightsAreLeftOut) {
  const BreakLines lines =
      lines_of(write_csv("a.csv", {"LINESTRING Z(-105.02 38 1001,-105.01 38 -3.4e38,-105 38 1001,-104.99 38 -1e39)"}));
  EXPECT_EQ(lines.counts.limited, 0);
  EXPECT_EQ(lines.chains.at(0).vertices.back().height_m, surface(x(-104.99), 0));
  EXPECT_THAT(lines.notes,
              Contains(HasSubstr("2 heights that are no numbers or beyond +-30000 m were left out: feature 1")));
}

TEST_F(OgrLinesTest, HeightsInFeetAreConverted) {
  const std::string wkt = "LINESTRING Z(-105.01 38 3280.83,-105 38 3280.83)";  // 1000 m
  EXPECT_NEAR(lines_of(write_vrt("ft.vrt", {wkt}, "EPSG:4326+6360")).chains.at(0).vertices.back().height_m, 1000, 0.01);
  EXPECT_NEAR(lines_of(write_vrt("m.vrt", {wkt}, "EPSG:4326+5703")).chains.at(0).vertices.back().height_m, 1005, 1e-3);
  options_.metres_per_unit = 0.3048;
  EXPECT_NEAR(lines_of(write_vrt("m.vrt", {wkt}, "EPSG:4326+5703")).chains.at(0).vertices.back().height_m, 999.997,
              0.001);
}

TEST_F(OgrLinesTest, UnitOfHeightsInFootCrsIsNamedAsTaken) {
  const BreakLines lines =
      lines_of(write_vrt("a.vrt", {"LINESTRING Z(3144000 1485000 1000,3145000 1485000 1000)"}, "EPSG:2233"));
  EXPECT_THAT(lines.notes, Contains(HasSubstr("is not in metres and says nothing about heights: taken as metres")));
}

TEST_F(OgrLinesTest, ShiftIsAddedToGivenHeightsAlone) {
  options_.shift_m = [](double lon, double lat) { return lon + lat + 67 + 2; };
  const BreakLines lines = lines_of(write_json("a.json", {{"LineString", "[[-105.01,38,1000],[-105,38,1000]]"},
                                                          {"LineString", "[[-105.01,38.1],[-105,38.1]]"}}));
  EXPECT_NEAR(lines.chains.at(0).vertices.back().height_m, 1002, 1e-9);
  EXPECT_NEAR(lines.chains.at(1).vertices.back().height_m, 1000, 1e-3);
}

// Lakes

constexpr char kLake[] = "[[[-105.01,38],[-104.99,38],[-104.99,38.01],[-105.01,38.01],[-105.01,38]]]";

TEST_F(OgrLinesTest, LakeWithoutHeightsGetsTheMedianOfItsShore) {
  const BreakLines lines = lines_of(write_json("a.json", {{"Polygon", kLake}}), true);
  ASSERT_EQ(lines.chains.size(), 1U);
  EXPECT_TRUE(lines.is_shore[0]);
  for (const BreakVertex& v : lines.chains.at(0).vertices) EXPECT_NEAR(v.height_m, 1000, 0.09);
  const double height_m = lines.chains.at(0).vertices[0].height_m;
  for (const BreakVertex& v : lines.chains.at(0).vertices) EXPECT_EQ(v.height_m, height_m);
  EXPECT_EQ(lines.counts.limited, 0);
}

TEST_F(OgrLinesTest, LakeHeightIsLimitedByThePromise) {
  options_.max_change_m = 0.5;
  const BreakLines lines = lines_of(write_json("a.json", {{"Polygon", kLake}}), true);
  EXPECT_GT(lines.counts.limited, 0);
  EXPECT_NEAR(lines.counts.largest_change_m, 0.5, 0.09);
  EXPECT_THAT(lines.notes, Contains(HasSubstr("a.json feature 0 by")));
}

TEST_F(OgrLinesTest, LakeKeepsItsGivenHeightOnAllRings) {
  const BreakLines lines = lines_of(
      write_csv("a.csv",
                {"POLYGON Z((-105.01 38 1001,-104.99 38 1001,-104.99 38.01 1001,-105.01 38.01 1001,-105.01 38 1001),"
                 "(-105.005 38.002 1001,-105 38.002 1001,-105 38.008 1001,-105.005 38.002 1001))"}),
      true);
  ASSERT_EQ(lines.chains.size(), 2U);
  for (const BreakChain& chain : lines.chains) {
    for (const BreakVertex& v : chain.vertices) EXPECT_EQ(v.height_m, 1001);
  }
}

TEST_F(OgrLinesTest, LakeWithDifferentHeightsGetsTheirMedianAndIsNamed) {
  const BreakLines lines = lines_of(
      write_csv("a.csv",
                {"POLYGON Z((-105.01 38 999,-104.99 38 999,-104.99 38.01 999,-105.01 38.01 1010,-105.01 38 999))"}),
      true);
  for (const BreakVertex& v : lines.chains.at(0).vertices) EXPECT_EQ(v.height_m, 999);
  EXPECT_THAT(lines.notes, Contains(HasSubstr("lakes have shores at different heights: the median was taken: feature 1 "
                                              "(999.00 to 1010.00 m)")));
}

TEST_F(OgrLinesTest, ShoreWinsOverLinesThatReachIt) {
  const BreakLineFile files[] = {
      {write_csv("line.csv", {"LINESTRING Z(-105 37.99 997,-105 38.005 997)"}), false},
      {write_csv(
           "lake.csv",
           {"POLYGON Z((-105.01 38 1001,-104.99 38 1001,-104.99 38.01 1001,-105.01 38.01 1001,-105.01 38 1001))"}),
       true}};
  const auto lines = read_break_lines(files, options_);
  ASSERT_TRUE(lines);
  check(*lines);
  int n = 0;
  for (const BreakChain& chain : lines->chains) {
    for (const BreakVertex& v : chain.vertices) {
      if (v.x != x(-105) || v.y != y(38)) continue;
      ++n;
      EXPECT_EQ(v.height_m, 1001);
    }
  }
  EXPECT_GE(n, 3);
  EXPECT_EQ(std::count(lines->is_shore.begin(), lines->is_shore.end(), true), 1);
  EXPECT_TRUE(lines->sources[1].lakes);
}

TEST_F(OgrLinesTest, LowerOfTwoLakesThatTouchGetsTheirNode) {
  const BreakLines lines =
      lines_of(write_csv("a.csv", {"POLYGON Z((-105 38 1002,-105.01 38 1002,-105.01 38.01 1002,-105 38 1002))",
                                   "POLYGON Z((-105 38 999,-104.99 38 999,-104.99 38.01 999,-105 38 999))"}),
               true);
  int n = 0;
  for (const BreakChain& chain : lines.chains) {
    for (const BreakVertex& v : chain.vertices) {
      const bool is_node = v.x == x(-105) && v.y == y(38);
      n += is_node ? 1 : 0;
      EXPECT_EQ(v.height_m, is_node || v.x > x(-105) ? 999 : 1002);
    }
  }
  EXPECT_EQ(n, 4);
}

TEST_F(OgrLinesTest, LineAmongLakesIsABreakLine) {
  const BreakLines lines =
      lines_of(write_json("a.json", {{"Polygon", kLake}, {"LineString", "[[-105.5,38],[-105.4,38]]"}}), true);
  EXPECT_EQ(std::count(lines.is_shore.begin(), lines.is_shore.end(), true), 1);
  EXPECT_THAT(lines.notes, Contains(HasSubstr("1 lines that enclose no lake were taken as break lines: feature 1")));
}

// Coordinate reference systems

TEST_F(OgrLinesTest, ProjectedLineStaysOnItselfWithinAnEighthOfAPost) {
  // A straight line of Mercator is a rhumb line: latitude = gudermannian of y.
  constexpr double kRadius = 6378137;
  const auto mercator_y = [](double lat_deg) {
    const double lat = lat_deg * std::numbers::pi / 180;
    return kRadius * std::log(std::tan(std::numbers::pi / 4 + lat / 2));
  };
  const double west = kRadius * -105.9 * std::numbers::pi / 180, east = kRadius * -104.1 * std::numbers::pi / 180;
  const double south = mercator_y(37.1), north = mercator_y(38.9);
  const BreakLines lines = lines_of(write_vrt(
      "a.vrt", {fmt::format("LINESTRING({:.6f} {:.6f},{:.6f} {:.6f})", west, south, east, north)}, "EPSG:3857"));
  ASSERT_EQ(lines.chains.size(), 1U);
  const std::vector<BreakVertex>& v = lines.chains.at(0).vertices;
  double worst_posts = 0, chord_posts = 0;
  for (std::size_t i = 1; i < v.size(); ++i) {
    const double lon = options_.lattice.longitude_deg(v[i].x), lat = options_.lattice.latitude_deg(v[i].y);
    const double my = south + (north - south) * (lon + 105.9) / 1.8;
    const double expected = (2 * std::atan(std::exp(my / kRadius)) - std::numbers::pi / 2) * 180 / std::numbers::pi;
    worst_posts = std::max(worst_posts, std::abs(lat - expected) * 1200);
    const double chord = 37.1 + (lon + 105.9);
    chord_posts = std::max(chord_posts, std::abs(expected - chord) * 1200);
  }
  EXPECT_LE(worst_posts, 0.125);
  EXPECT_GT(chord_posts, 2);  // it would be off without vertices in between
}

TEST_F(OgrLinesTest, UtmLineIsWhereItShouldBe) {
  // EPSG:32613 has its central meridian at -105: easting 500000. Northing of 38 degrees there: 4205815.02 m.
  const BreakLines lines =
      lines_of(write_vrt("a.vrt", {"LINESTRING(500000 4205815.02,500000 4216910.32)"}, "EPSG:32613"));
  const std::vector<BreakVertex>& v = lines.chains.at(0).vertices;
  EXPECT_EQ(v.front().x, x(-105));
  EXPECT_NEAR(options_.lattice.latitude_deg(v.front().y), 38.0, 1e-5);
  EXPECT_NEAR(options_.lattice.latitude_deg(v.back().y), 38.1, 1e-5);
}

TEST_F(OgrLinesTest, NoCrsButDegreesIsNoted) {
  const BreakLines lines = lines_of(write_csv("a.csv", {"LINESTRING(-105.9 37.1,-105.8 37.1)"}));
  EXPECT_THAT(lines.notes, Contains("a.csv: has no CRS: taken as longitude and latitude on WGS 84"));
}

TEST_F(OgrLinesTest, NoCrsAndMetresIsRefused) {
  const Error error = error_of(write_csv("a.csv", {"LINESTRING(500000 4205000,500100 4205000)"}));
  EXPECT_EQ(error.kind, ErrorKind::kInvalidInput);
  EXPECT_THAT(error.message, AllOf(HasSubstr("a.csv: has no CRS, and feature 1 has a vertex at (500000, 4205000)"),
                                   HasSubstr("ogr2ogr -a_srs")));
}

TEST_F(OgrLinesTest, LocalCrsIsRefused) {
  const Error error = error_of(
      write_vrt("a.vrt", {"LINESTRING(1 2,3 4)"}, "LOCAL_CS[&quot;site grid&quot;,UNIT[&quot;metre&quot;,1]]"));
  EXPECT_THAT(error.message, HasSubstr("'site grid' has no relation to the globe"));
}

TEST_F(OgrLinesTest, LongitudesBeyond180AreTheSame) {
  const BreakLines lines = lines_of(write_json("a.json", {{"LineString", "[[254.5,38],[254.6,38]]"}}));
  EXPECT_EQ(lines.chains.at(0).vertices.front().x, x(-105.5));
}

TEST_F(OgrLinesTest, LineCrosses180TheShortWay) {
  options_.west_x = x(179);
  options_.east_x = x(181);
  const BreakLines lines = lines_of(write_json("a.json", {{"LineString", "[[179.9,38],[-179.9,38]]"}}));
  ASSERT_EQ(lines.chains.size(), 1U);
  EXPECT_EQ(lines.chains.at(0).vertices.front().x, x(179.9));
  EXPECT_EQ(lines.chains.at(0).vertices.back().x, x(180.1));
}

TEST_F(OgrLinesTest, GlobalFieldCutsLinesAtItsSeam) {
  options_.west_x = x(-180);
  options_.east_x = x(180);
  options_.wraps = true;
  const BreakLines lines = lines_of(write_json("a.json", {{"LineString", "[[179.9,38],[-179.9,38.2]]"}}));
  ASSERT_EQ(lines.chains.size(), 2U);
  EXPECT_EQ(lines.chains.at(0).vertices.front().x, options_.west_x);
  EXPECT_EQ(lines.chains.at(1).vertices.back().x, options_.east_x);
  EXPECT_EQ(lines.chains.at(0).vertices.front().y, lines.chains.at(1).vertices.back().y);
  // With a vertex on it, too.
  EXPECT_EQ(lines_of(write_json("c.json", {{"LineString", "[[179.9,38],[180,38.1],[-179.9,38.2]]"}})).chains.size(),
            2U);
  // What runs along the seam is there once.
  EXPECT_EQ(lines_of(write_json("b.json", {{"LineString", "[[180,38],[-180,38.2]]"}})).chains.size(), 1U);
}

TEST_F(OgrLinesTest, SpiralAroundTheGlobePassesOncePerTurn) {
  std::string text;
  for (int i = 0; i < 3000; ++i)
    text += fmt::format("{}[{},{:.6f}]", i == 0 ? "" : ",", i % 3 * 120 - 180, 30 + i * 0.01);
  const BreakLines lines = lines_of(write_json("a.json", {{"LineString", "[" + text + "]"}}));
  EXPECT_EQ(lines.chains.size(), 66U);  // 2 degrees at 0.03 a turn
  EXPECT_EQ(lines.counts.meetings, 0);
}

TEST_F(OgrLinesTest, WindowOfAFieldIsItsDataWithoutTheFalloff) {
  std::vector<float> heights(30, 7);
  std::vector<PostOrigin> origins(30, PostOrigin::kFalloff);
  for (const int i : {8, 9, 14, 15}) origins[static_cast<std::size_t>(i)] = PostOrigin::kSource;
  origins[20] = PostOrigin::kFilled;
  HeightField field;
  field.lattice.level = 10;
  field.n_rows = 5;
  field.n_cols = 6;
  field.x0 = 100.5;
  field.y0 = 200;
  field.dx = field.dy = 10;
  field.heights_m = heights.data();
  field.origins = origins.data();
  const BreakLineOptions options = break_line_options(field, 3);
  EXPECT_EQ(options.west_x, 121);
  EXPECT_EQ(options.east_x, 130);
  EXPECT_EQ(options.south_y, 210);
  EXPECT_EQ(options.north_y, 230);
  EXPECT_EQ(options.surface_m(125, 215), 7);
  EXPECT_EQ(options.max_change_m, 3);
}

// Files

TEST_F(OgrLinesTest, MissingFileIsSaid) {
  const Error error = error_of(path("no.shp"));
  EXPECT_EQ(error.kind, ErrorKind::kNotFound);
  EXPECT_THAT(error.message, HasSubstr("no.shp: no such file"));
  EXPECT_THAT(error_of(path("no.gpkg:roads")).message, HasSubstr("no.gpkg: no such file (taken as FILE:LAYER from"));
}

TEST_F(OgrLinesTest, OtherFilesAreNotVectorFiles) {
  for (const std::string& file : {write("a.txt", "hello"), write("b.shp", "hello"), write("c.json", "{\"type\": "),
                                  write("d.gpkg", ""), std::string(TIND_TEST_DATA "/sangre_de_cristo.tif")}) {
    EXPECT_THAT(error_of(file).message, HasSubstr("not a vector file that OGR reads")) << file;
  }
  fs::create_directory(folder_ / "empty");
  EXPECT_THAT(error_of(path("empty")).message, HasSubstr("empty: "));
}

TEST_F(OgrLinesTest, LayersAreListed) {
  const OutputLine line{{{-105.5, 38, 0}, {-105.4, 38, 0}}, "stream", {}, {}, 0};
  ASSERT_TRUE(write_lines(path("a.gpkg"), std::vector<OutputLayer>{{"roads", {line}}, {"rivers", {line}}}, false));
  EXPECT_THAT(error_of(path("a.gpkg")).message,
              AllOf(HasSubstr("has 2 layers (roads, rivers)"), HasSubstr("a.gpkg:roads")));
  EXPECT_THAT(error_of(path("a.gpkg:lakes")).message, HasSubstr("no layer 'lakes'; it has: roads, rivers"));
  const BreakLines lines = lines_of(path("a.gpkg:rivers"));
  EXPECT_EQ(lines.chains.size(), 1U);
  EXPECT_EQ(lines.sources[0].name, "a.gpkg:rivers");
}

TEST_F(OgrLinesTest, NameWithAColonIsAFile) {
  const BreakLines lines = lines_of(write_json("a:b.json", {{"LineString", "[[-105.5,38],[-105.4,38]]"}}));
  EXPECT_EQ(lines.sources[0].name, "a:b.json");
}

TEST_F(OgrLinesTest, ZipIsLookedInto) {
  write_json("a.json", {{"LineString", "[[-105.5,38],[-105.4,38]]"}});
  ASSERT_EQ(std::system(fmt::format("cd '{}' && python3 -m zipfile -c a.zip a.json", folder_.string()).c_str()), 0);
  EXPECT_EQ(lines_of(path("a.zip")).chains.size(), 1U);
  EXPECT_EQ(lines_of("/vsizip/" + path("a.zip") + "/a.json").chains.size(), 1U);
  write("readme.txt", "hello");
  ASSERT_EQ(std::system(fmt::format("cd '{}' && python3 -m zipfile -c b.zip readme.txt", folder_.string()).c_str()), 0);
  EXPECT_THAT(error_of(path("b.zip")).message, HasSubstr("the archive holds no vector file"));
  ASSERT_EQ(std::system(fmt::format("cd '{0}' && cp a.json b.json && python3 -m zipfile -c c.zip a.json b.json",
                                    folder_.string())
                            .c_str()),
            0);
  EXPECT_THAT(error_of(path("c.zip")).message, HasSubstr("the archive holds 2 vector files; name one"));
  EXPECT_THAT(error_of(write("d.zip", "hello")).message, HasSubstr("not a zip archive"));
}

TEST_F(OgrLinesTest, FileWithoutLinesIsRefused) {
  EXPECT_THAT(error_of(write_json("a.json", {{"Point", "[-105,38]"}, {"", ""}})).message,
              HasSubstr("holds no lines or polygons to use (2 features, 1 points)"));
  EXPECT_THAT(error_of(write_json("b.json", {})).message, HasSubstr("holds no lines or polygons to use (0 features"));
  EXPECT_THAT(error_of(write("c.csv", "name,n\nx,1\n")).message, HasSubstr("holds no lines or polygons to use"));
}

TEST_F(OgrLinesTest, AllOutsideIsRefusedAndBothBoundsAreNamed) {
  const Error error = error_of(write_json("a.json", {{"LineString", "[[8,50],[9,51]]"}}));
  EXPECT_EQ(error.kind, ErrorKind::kInvalidInput);
  EXPECT_THAT(error.message, AllOf(HasSubstr("all its lines lie outside the data"), HasSubstr("they reach from 8.0"),
                                   HasSubstr("the data from -105.999999, 37.000000 to -103.999999, 39.000000")));
}

TEST_F(OgrLinesTest, ContentHashFollowsTheCoordinates) {
  const auto hash = [&](const std::string& coordinates) {
    return lines_of(write_json("a.json", {{"LineString", coordinates}})).sources[0].sha256;
  };
  EXPECT_EQ(hash("[[-105.5,38],[-105.4,38]]"), hash("[[-105.50,38],[-105.4,38.0]]"));
  EXPECT_NE(hash("[[-105.5,38],[-105.4,38]]"), hash("[[-105.5,38],[-105.4,38.0000001]]"));
}

TEST_F(OgrLinesTest, DamagedFilesNeverCrash) {
  const OutputLine line{{{-105.5, 38, 1000}, {-105.4, 38, 1000}, {-105.3, 38.1, 1000}}, "stream", 2, 3.0, 0};
  ASSERT_TRUE(write_lines(path("a.gpkg"), std::vector<OutputLayer>{{"roads", {line, line}}}, false));
  write_json("a.json",
             {{"Polygon", kLake}, {"MultiLineString", "[[[-105.5,38],[-105.4,38,7]],[[-105.1,38],[-105.2,38]]]"}});
  write_csv("a.csv", {"LINESTRING Z(-105.5 38 1,-105.4 38 2)",
                      "CURVEPOLYGON(CIRCULARSTRING(-105.9 38.1,-105.8 38.2,-105.9 38.1))"});
  std::mt19937_64 random(33);
  int n_read = 0, n_refused = 0;
  for (const std::string name : {"a.gpkg", "a.json", "a.csv"}) {
    const std::string bytes = bytes_of(name);
    for (int run = 0; run < 150; ++run) {
      std::string damaged = bytes;
      if (run % 5 == 0) damaged.resize(random() % bytes.size());
      for (std::uint64_t n = 1 + random() % 20; n > 0 && !damaged.empty(); --n) {
        // In the GeoPackage mostly where its geometries are.
        const std::size_t blob = damaged.find(std::string("GP\0", 3));
        const bool near_blob = blob != std::string::npos && random() % 4 != 0;
        const std::size_t at =
            near_blob ? std::min(blob + random() % 120, damaged.size() - 1) : random() % damaged.size();
        damaged[at] = static_cast<char>(run % 2 == 0 ? random() % 256 : "0123456789.,-[]{}()e\"n"[random() % 22]);
      }
      const auto lines = read(write("damaged-" + name, damaged), run % 3 == 0);
      ++(lines ? n_read : n_refused);
      if (!lines) {
        EXPECT_THAT(lines.error().message, HasSubstr("damaged-" + name));
      }
      for (const char* suffix : {"-journal", "-wal", "-shm"}) fs::remove(path("damaged-" + name + suffix));
    }
  }
  EXPECT_GT(n_read, 20);
  EXPECT_GT(n_refused, 20);
}

}  // namespace
}  // namespace tind
