// SPDX-License-Identifier: GPL-3.0-or-later
// The parts of the report by themselves: sampling of a mesh, areas, hill-shade, drawing, PNG.
#include <cmath>
#include <limits>
#include <numbers>

#include <gmock/gmock.h>

#include "storage/readers/png_image.hpp"
#include "storage/report/chart.hpp"
#include "storage/report/hillshade.hpp"
#include "storage/report/source_grid.hpp"
#include "storage/report/surface_sampler.hpp"
#include "storage/report/svg.hpp"
#include "tests/support/test_field.hpp"

namespace tind::test {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

/// A tile of two triangles, 100 steps a side: z = x in the south-east half, a fold along the diagonal C0-C2.
VirtualNode folded_tile() {
  VirtualNode tile;
  tile.vertices = {{0, 0, 0}, {100, 0, 100}, {100, 100, 100}, {0, 100, 40}};
  tile.triangles = {{0, 1, 2}, {0, 2, 3}};
  return tile;
}

double folded_height(double x, double y) { return y <= x ? x : x + (y - x) * 0.4; }

TEST(SampleMesh, PlanesAreHitOnGridAndScattered) {
  const VirtualNode tile = folded_tile();
  const std::vector<double> xs = {0, 12.5, 50, 99.999, 100}, ys = {0, 0.25, 50, 100};
  const auto grid = sample_mesh(tile, 0.5, xs, ys);
  std::vector<MeshPosition> at;
  for (const double y : ys) {
    for (const double x : xs) at.push_back({x, y});
  }
  const auto scattered = sample_mesh(tile, 0.5, at);
  ASSERT_EQ(grid.size(), 20u);
  ASSERT_EQ(scattered.size(), 20u);
  for (std::size_t k = 0; k < at.size(); ++k) {
    EXPECT_NEAR(grid[k], 0.5 * folded_height(at[k].x, at[k].y), 1e-9) << at[k].x << ", " << at[k].y;
    EXPECT_EQ(scattered[k], grid[k]);
  }
}

TEST(SampleMesh, OutsideAndHolesAreNoNumbers) {
  VirtualNode tile = folded_tile();
  const std::vector<double> xs = {-1, 50, 101}, ys = {20, 80};
  auto z = sample_mesh(tile, 1, xs, ys);
  EXPECT_TRUE(std::isnan(z[0]) && std::isnan(z[2]) && !std::isnan(z[1]));
  tile.triangles.pop_back();  // north-west of the diagonal is now a hole
  z = sample_mesh(tile, 1, xs, ys);
  EXPECT_FALSE(std::isnan(z[1]));
  EXPECT_TRUE(std::isnan(z[4]));
  EXPECT_TRUE(std::isnan(sample_mesh(tile, 1, std::vector<MeshPosition>{{50, 80}})[0]));
  EXPECT_TRUE(sample_mesh(tile, 1, std::vector<MeshPosition>{}).empty());
}

TEST(SampleMesh, ThinTrianglesLeaveNoGapsAndAreNotExtrapolated) {
  // Slivers one step thick between the corners, heights that jump by 1000: a position a hair off a plane's edge must
  // not be flung away.
  VirtualNode tile;
  tile.vertices = {{0, 0, 0}, {1000003, 0, 0}, {1000003, 1000003, 0}, {0, 1000003, 0}, {500001, 500002, 1000}};
  tile.triangles = {{0, 1, 4}, {1, 2, 4}, {2, 3, 4}, {3, 0, 4}, {0, 4, 2}};
  for (int k = 0; k < 20000; ++k) {
    const double t = 1000003.0 * noise(9, k, 0);
    const double z = sample_mesh(tile, 1, std::vector<MeshPosition>{{t, t}})[0];
    ASSERT_FALSE(std::isnan(z)) << t;
    ASSERT_GE(z, 0);
    ASSERT_LE(z, 1000);
  }
}

TEST(CellArea, AllCellsOfAGlobeAreTheEllipsoid) {
  HeightField field;
  field.lattice.level = 2;
  field.n_rows = 181;
  field.n_cols = 360;
  field.dy = static_cast<double>(field.lattice.height()) / 180;
  field.dx = static_cast<double>(field.lattice.width()) / 360;
  field.wraps = true;
  double area = 0;
  for (std::int64_t r = 0; r < field.n_rows; ++r) area += cell_area_km2(field, r) * 360;
  EXPECT_NEAR(area, 510065621.724, 1);  // WGS 84: NIMA TR8350.2, table 3.6
  field.lattice.ellipsoid = {"sphere", 1000, std::numeric_limits<double>::infinity()};
  area = 0;
  for (std::int64_t r = 0; r < field.n_rows; ++r) area += cell_area_km2(field, r) * 360;
  EXPECT_NEAR(area, 4 * std::numbers::pi, 1e-9);
}

TEST(Hillshade, SlopesTowardsTheLightAreBrightest) {
  const auto shade = [](double east, double north) {
    std::vector<float> heights;
    for (int r = 0; r < 5; ++r) {
      for (int c = 0; c < 5; ++c) heights.push_back(static_cast<float>(10 * (east * c + north * r)));
    }
    return hillshade({5, 5, 10, 10, heights}, 1)[12];
  };
  EXPECT_EQ(shade(0, 0), std::lround(254 * std::numbers::sqrt2 / 2));
  // A slope of 45 degrees that falls to the north-west faces the light.
  EXPECT_EQ(shade(std::numbers::sqrt2 / 2, -std::numbers::sqrt2 / 2), 254);
  EXPECT_EQ(shade(-std::numbers::sqrt2 / 2, std::numbers::sqrt2 / 2), 0);
  EXPECT_EQ(shade(0.3, 0.3), shade(-0.3, -0.3));
}

TEST(Hillshade, NorthIsUpAndVoidsAreWhite) {
  std::vector<float> heights(6 * 4, 0);
  heights[0] = std::numeric_limits<float>::quiet_NaN();  // the south-western post
  const auto grey = hillshade({6, 4, 30, 30, heights}, 1);
  EXPECT_EQ(grey[5 * 4], 255);
  EXPECT_EQ(std::count(grey.begin(), grey.end(), 255), 1);
  EXPECT_EQ(visible_exaggeration({6, 4, 30, 30, heights}), 1);
  heights[13] = 1;  // gentle: must be exaggerated
  EXPECT_GT(visible_exaggeration({6, 4, 30, 30, heights}), 10);
}

TEST(Png, HeaderTellsTheSize) {
  const std::vector<std::uint8_t> pixels(7 * 3, 128);
  const auto png = encode_png(pixels, 3, 7);
  ASSERT_TRUE(png.has_value());
  const Bytes head(png->begin(), png->begin() + 26);
  EXPECT_EQ(head, (Bytes{0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n', 0, 0, 0, 13, 'I',
                         'H',  'D', 'R', 0,   0,    0,    7,    0,    0, 0, 3, 8,  0}));
}

TEST(SvgText, AnyBytesMakeWellFormedText) {
  Svg svg(10, 10);
  svg.text({1, 1}, "a<b&\"c'>\x01 \xff\xc3 \xc3\xa9 \xe2\x82\xac", {});
  EXPECT_THAT(svg.str(), HasSubstr(">a&lt;b&amp;&quot;c&apos;&gt; ?? \xc3\xa9 \xe2\x82\xac</text>"));
}

TEST(SvgImage, Base64IsPadded) {
  const auto encoded = [](const Bytes& bytes) {
    Svg svg(1, 1);
    svg.image({0, 0}, 1, 1, bytes);
    return svg.str();
  };
  EXPECT_THAT(encoded({'M'}), HasSubstr("base64,TQ==\""));
  EXPECT_THAT(encoded({'M', 'a'}), HasSubstr("base64,TWE=\""));
  EXPECT_THAT(encoded({'M', 'a', 'n'}), HasSubstr("base64,TWFu\""));
}

TEST(Chart, LeavesOutWhatALogarithmHasNot) {
  Svg svg(400, 400);
  Chart chart{"t", "m", true, {"1", "2", "3", "4"}, {"a", "b", "c", "d"}, "level", {}};
  chart.series.push_back({"s", "#000000", {}, false, {10.0, 5.0, 0.0, std::nullopt}});
  draw_chart(svg, chart, {0, 0}, 400, 200);
  const std::string text = svg.str();
  EXPECT_THAT(text, HasSubstr("<polyline points=\"93.75"));  // one line of two points
  EXPECT_THAT(text, Not(HasSubstr("nan")));
  EXPECT_THAT(text, Not(HasSubstr("inf")));
}

TEST(ShortNumber, HasThreeDigits) {
  EXPECT_EQ(short_number(0.0312), "0.0312");
  EXPECT_EQ(short_number(64), "64");
  EXPECT_EQ(short_number(1234), "1.23k");
  EXPECT_EQ(short_number(2.88e6), "2.88M");
}

}  // namespace
}  // namespace tind::test
