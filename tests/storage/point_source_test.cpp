// SPDX-License-Identifier: GPL-3.0-or-later
// Point files through PointSource: what they say about their coordinates, which points count, how far apart they are.
#include "storage/readers/point_source.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "storage/readers/occupied_cells.hpp"
#include "storage/readers/point_crs.hpp"
#include "tests/storage/test_las.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;
using test::LasTestPoint;
using test::LasTestSpec;
using ::testing::Contains;
using ::testing::HasSubstr;

constexpr double kMetresPerDegree = 111319.49079327358;
constexpr char kUtmWkt[] =
    "PROJCS[\"WGS 84 / UTM zone 32N\",GEOGCS[\"WGS 84\",DATUM[\"WGS_1984\",SPHEROID[\"WGS "
    "84\",6378137,298.257223563]],PRIMEM[\"Greenwich\",0],UNIT[\"degree\",0.0174532925199433]],PROJECTION[\"Transverse_"
    "Mercator\"],PARAMETER[\"latitude_of_origin\",0],PARAMETER[\"central_meridian\",9],PARAMETER[\"scale_factor\",0."
    "9996],PARAMETER[\"false_easting\",500000],PARAMETER[\"false_northing\",0],UNIT[\"metre\",1]]";

/// A block of ground points in UTM zone 32N, 2 m apart, whose south-west corner is at 9 E.
std::vector<LasTestPoint> ground(int n = 20) {
  std::vector<LasTestPoint> points;
  for (int r = 0; r < n; ++r) {
    for (int c = 0; c < n; ++c) points.push_back({500000 + 2.0 * c, 5300000 + 2.0 * r, 100.0 + r, 2, false});
  }
  return points;
}

class PointSourceTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-point-source-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { fs::remove_all(folder_); }

  std::string write(const std::string& name, const std::string& text) {
    std::ofstream(folder_ / name, std::ios::binary) << text;
    return (folder_ / name).string();
  }
  std::string write_las(const std::string& name, const LasTestSpec& spec, const std::vector<LasTestPoint>& points) {
    const auto bytes = make_las(spec, points);
    return write(name, {bytes.begin(), bytes.end()});
  }
  static LasTestSpec utm() {
    LasTestSpec spec;
    spec.offset = {500000, 5300000, 0};
    spec.geo_keys = test::keys_of_epsg(32632);
    return spec;
  }
  static std::string message(const std::vector<std::string>& paths, const PointOptions& options = {}) {
    const auto source = PointSource::open(paths, options);
    return source ? "" : source.error().message;
  }
  static std::vector<GeoPoint> points_of(const PointSource& source) {
    std::vector<GeoPoint> all;
    const auto ok = source.read([&](std::span<const GeoPoint> points) -> Result<void> {
      all.insert(all.end(), points.begin(), points.end());
      return {};
    });
    EXPECT_TRUE(ok) << ok.error().message;
    return all;
  }
  static std::vector<GeoPoint> points_of(const std::string& path, const PointOptions& options = {}) {
    const auto source = PointSource::open({path}, options);
    EXPECT_TRUE(source) << source.error().message;
    return source ? points_of(*source) : std::vector<GeoPoint>{};
  }

  fs::path folder_;
};

TEST_F(PointSourceTest, NamesOfPointFiles) {
  for (const char* name : {"a.las", "B.LAZ", "c.xyz", "/x/d.CSV", "e.txt"})
    EXPECT_TRUE(PointSource::is_point_file(name));
  for (const char* name : {"a.tif", "las", "a.las.tif", ""}) EXPECT_FALSE(PointSource::is_point_file(name));
}

TEST_F(PointSourceTest, ClassFilterIsParsed) {
  EXPECT_EQ(parse_class_filter("2")->count(), 1u);
  EXPECT_TRUE(parse_class_filter("2,9,255")->test(255));
  EXPECT_EQ(parse_class_filter("2,9,9")->count(), 2u);
  EXPECT_TRUE(parse_class_filter("all")->all());
  for (const char* text : {"", "ground", "2,", ",2", "-1", "256", "2 9", "2.5"}) {
    const auto filter = parse_class_filter(text);
    ASSERT_FALSE(filter) << text;
    EXPECT_THAT(filter.error().message, HasSubstr("try 2, or 2,9, or all"));
  }
}

TEST_F(PointSourceTest, CrsComesFromKeysOrWktOrTheUser) {
  LasTestSpec keys = utm(), wkt = utm(), both = utm(), none = utm();
  wkt.geo_keys.clear();
  wkt.wkt = kUtmWkt;
  both.geo_keys = test::keys_of_epsg(32633);  // wrong: the WKT wins
  both.wkt = kUtmWkt;
  none.geo_keys.clear();
  PointOptions user;
  user.source_crs = "EPSG:32632";
  const std::vector<std::vector<GeoPoint>> all = {
      points_of(write_las("k.las", keys, ground())), points_of(write_las("w.las", wkt, ground())),
      points_of(write_las("b.las", both, ground())), points_of(write_las("n.las", none, ground()), user)};
  for (const auto& points : all) {
    ASSERT_EQ(points.size(), 400u);
    EXPECT_NEAR(points[0].lon_deg, 9.0, 1e-9);
    EXPECT_NEAR(points[0].lat_deg, 47.8528, 1e-3);
    for (std::size_t i = 0; i < points.size(); ++i) {
      ASSERT_NEAR(points[i].lon_deg, all[0][i].lon_deg, 1e-9);
      ASSERT_NEAR(points[i].lat_deg, all[0][i].lat_deg, 1e-9);
      ASSERT_EQ(points[i].height_m, all[0][i].height_m);
    }
  }
  const auto source = PointSource::open({(folder_ / "k.las").string()}, {});
  ASSERT_TRUE(source);
  EXPECT_EQ(source->files[0].crs, "WGS 84 / UTM zone 32N (EPSG:32632)");
  EXPECT_EQ(source->files[0].name, "k.las");
  EXPECT_EQ(source->files[0].sha256.size(), 64u);
}

TEST_F(PointSourceTest, BadCrsIsRefusedWithAReason) {
  LasTestSpec none = utm(), nonsense = utm(), odd_keys = utm(), local = utm();
  none.geo_keys.clear();
  nonsense.wkt = "PROJCS[\"half";
  odd_keys.geo_keys = {1, 1, 0, 1, 1024, 0, 1};
  odd_keys.geo_keys.resize(12, 0xffff);
  local.wkt = "LOCAL_CS[\"site\",UNIT[\"metre\",1]]";
  EXPECT_THAT(message({write_las("n.las", none, ground())}),
              HasSubstr("n.las: says nothing about its CRS; say what it is with --source-crs"));
  EXPECT_THAT(message({write_las("w.las", nonsense, ground())}),
              HasSubstr("w.las: the words (WKT) of its CRS make no sense"));
  EXPECT_THAT(message({write_las("k.las", odd_keys, ground())}), HasSubstr("--source-crs EPSG:n"));
  EXPECT_THAT(message({write_las("l.las", local, ground())}), HasSubstr("--source-crs EPSG:n"));
  PointOptions options;
  options.source_crs = "EPSG:1";
  EXPECT_THAT(message({(folder_ / "n.las").string()}, options), HasSubstr("CRS \"EPSG:1\" is not known"));
  options.source_crs = "EPSG:4978";
  EXPECT_THAT(message({(folder_ / "n.las").string()}, options), HasSubstr("neither geographic nor projected"));
}

TEST_F(PointSourceTest, UnitOfHeights) {
  const auto height = [&](const LasTestSpec& spec, const PointOptions& options = {}) {
    const auto points = points_of(write_las("u.las", spec, ground()), options);
    return points.empty() ? -1.0 : static_cast<double>(points[0].height_m);
  };
  LasTestSpec feet = utm();
  feet.geo_keys = test::keys_of_epsg(2285);  // NAD83 / Washington North (ftUS)
  EXPECT_EQ(height(utm()), 100);
  EXPECT_NEAR(height(feet), 100 * 1200.0 / 3937, 1e-5);
  // A vertical unit of its own counts more than the plan's.
  LasTestSpec plan_in_feet = feet;
  plan_in_feet.geo_keys[3] = 4;
  plan_in_feet.geo_keys.insert(plan_in_feet.geo_keys.end(), {4099, 0, 1, 9001});
  EXPECT_EQ(height(plan_in_feet), 100);
  LasTestSpec compound = utm();
  compound.wkt = fmt::format(
      "COMPD_CS[\"both\",{},VERT_CS[\"NAVD88 height (ftUS)\",VERT_DATUM[\"North American Vertical Datum "
      "1988\",2005],UNIT[\"US survey foot\",0.304800609601219],AXIS[\"Up\",UP]]]",
      kUtmWkt);
  EXPECT_NEAR(height(compound), 100 * 1200.0 / 3937, 1e-5);
  const auto source = PointSource::open({(folder_ / "u.las").string()}, {});
  ASSERT_TRUE(source);
  EXPECT_EQ(source->vertical_datum, "NAVD88 height (ftUS)");
  EXPECT_EQ(source->height_kind, "orthometric");
  EXPECT_THAT(source->notes, Contains(HasSubstr("heights are in units of 0.30480061 m")));
  PointOptions metres;
  metres.metres_per_unit = 2;
  EXPECT_EQ(height(compound, metres), 200);
  metres.metres_per_unit = -1;
  EXPECT_THAT(message({(folder_ / "u.las").string()}, metres), HasSubstr("must be positive numbers"));
}

TEST_F(PointSourceTest, GeographicFileWithVerticalUnitKey) {
  LasTestSpec spec;
  spec.scale = {1e-7, 1e-7, 0.01};
  spec.geo_keys = test::keys_of_geographic(4326, 9002);
  const auto points = points_of(write_las("g.las", spec, {{9, 47, 10}, {9.001, 47, 20}, {9, 47.001, 30}}));
  ASSERT_EQ(points.size(), 3u);
  EXPECT_NEAR(points[1].lon_deg, 9.001, 1e-9);
  EXPECT_NEAR(points[2].height_m, 30 * 0.3048, 1e-5);
}

TEST_F(PointSourceTest, OnlyWantedPointsCount) {
  auto points = ground();
  points[1].classification = 9;
  points[2].classification = 1;
  points[3].withheld = true;
  points[4].z = 40000;
  points[5].x = 2000000;
  const auto path = write_las("c.las", utm(), points);
  const auto source = PointSource::open({path}, {});
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_EQ(source->files[0].n_points, 400u);
  EXPECT_EQ(source->n_used, 396u);
  EXPECT_THAT(source->notes, Contains("1 points are marked as withheld and left out"));
  EXPECT_THAT(source->notes, Contains(HasSubstr("1 points have heights beyond +-30000 m")));
  PointOptions options;
  options.classes = *parse_class_filter("2,9");
  EXPECT_EQ(PointSource::open({path}, options)->n_used, 397u);
  options.classes = *parse_class_filter("all");
  EXPECT_EQ(PointSource::open({path}, options)->n_used, 398u);
  options.classes = *parse_class_filter("7");
  EXPECT_THAT(message({path}, options),
              HasSubstr("c.las: no point is of the wanted class; there are classes 1 (1 points), 2 "
                        "(397 points), 9 (1 points); choose with --class"));
}

TEST_F(PointSourceTest, PointsBeyondTheirCrsAreLeftOut) {
  LasTestSpec spec = utm();
  spec.geo_keys = test::keys_of_epsg(3413);  // north polar stereographic: the plane has no far side
  spec.scale = {1, 1, 0.001};
  auto points = ground();
  for (auto& p : points) p.x -= 1500000;
  const auto path = write_las("p.las", spec, points);
  EXPECT_EQ(message({path}), "");
  spec.geo_keys.clear();
  PointOptions options;
  options.source_crs = "+proj=ortho +lat_0=47 +lon_0=9 +datum=WGS84";
  spec.offset = {0, 0, 0};
  points = ground();
  for (auto& p : points) p.x -= 500000, p.y -= 5300000;
  points[0].x = 9e6;  // off the disc that this projection shows of the globe
  const auto source = PointSource::open({write_las("o.las", spec, points)}, options);
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_EQ(source->n_used, 399u);
  EXPECT_THAT(source->notes, Contains(HasSubstr("1 points lie where their CRS has no longitude and latitude")));
  for (auto& p : points) p.x = 9e6;
  EXPECT_THAT(message({write_las("q.las", spec, points)}, options),
              HasSubstr("no point can be used: 400 points lie where"));
}

TEST_F(PointSourceTest, TextFilesTakeDegreesForGranted) {
  std::string degrees = "lon,lat,height\n", metres = "x,y,z\n";
  for (int i = 0; i < 100; ++i) {
    degrees += fmt::format("{},{},{}\n", 9 + 1e-4 * (i % 10), 47 + 1e-4 * (i / 10), i);
    metres += fmt::format("{},{},{}\n", 500000 + 10 * (i % 10), 5300000 + 10 * (i / 10), i);
  }
  degrees += "9,47,nan\n";
  const auto source = PointSource::open({write("d.csv", degrees)}, {});
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_EQ(source->n_used, 100u);
  EXPECT_EQ(source->files[0].crs, "WGS 84 (EPSG:4326)");
  EXPECT_EQ(source->west_deg, 9);
  EXPECT_EQ(source->vertical_datum, "unknown");
  EXPECT_THAT(source->notes, Contains("d.csv: no CRS; its degrees are taken as EPSG:4326"));
  EXPECT_THAT(source->notes, Contains(HasSubstr("1 points have a coordinate that is no finite number")));
  const auto path = write("m.csv", metres);
  EXPECT_THAT(message({path}), HasSubstr("m.csv: says nothing about its CRS, and 500000, 5300000 are not degrees"));
  PointOptions options;
  options.source_crs = "EPSG:32632";
  const auto placed = PointSource::open({path}, options);
  ASSERT_TRUE(placed) << placed.error().message;
  EXPECT_NEAR(placed->west_deg, 9, 1e-9);
  EXPECT_NEAR(placed->spacing_m, 9, 0.5);  // sqrt(90 x 90 m / 100)
}

TEST_F(PointSourceTest, FilesThatAreNoneAreNamed) {
  EXPECT_THAT(message({}), HasSubstr("no point file given"));
  EXPECT_THAT(message({(folder_ / "none.las").string()}), HasSubstr("none.las: no such file"));
  EXPECT_THAT(message({write("e.las", "")}), HasSubstr("e.las: is an empty file"));
  EXPECT_THAT(message({write("t.las", "no points here")}), HasSubstr("t.las: is not a LAS file"));
  EXPECT_THAT(message({write("b.xyz", "1 2 3\n4 5 x\n")}), HasSubstr("b.xyz: line 2: z is not a number"));
  fs::create_directory(folder_ / "f.las");
  EXPECT_THAT(message({(folder_ / "f.las").string()}), HasSubstr("is a folder"));
  EXPECT_THAT(message({write_las("0.las", utm(), {})}), HasSubstr("0.las: holds no points"));
}

TEST_F(PointSourceTest, SpacingFollowsFromTheOccupiedArea) {
  // Two towns 50 km apart: the land between them does not count.
  auto points = ground(60);
  auto far = points;
  for (auto& p : far) p.y += 50000;
  const auto one = PointSource::open({write_las("1.las", utm(), points)}, {});
  points.insert(points.end(), far.begin(), far.end());
  const auto two = PointSource::open({write_las("2.las", utm(), points)}, {});
  std::shuffle(points.begin(), points.end(), std::mt19937(1));
  const auto shuffled = PointSource::open({write_las("3.las", utm(), points)}, {});
  ASSERT_TRUE(one && two && shuffled);
  EXPECT_NEAR(one->spacing_m, 2, 0.1);
  EXPECT_NEAR(two->spacing_m, 2, 0.3);
  EXPECT_EQ(shuffled->spacing_m, two->spacing_m);
  EXPECT_NEAR(one->lat_spacing_deg * kMetresPerDegree, one->spacing_m, 1e-9);
  EXPECT_NEAR(one->lon_spacing_deg * kMetresPerDegree * std::cos(one->south_deg * M_PI / 180), one->spacing_m, 1e-4);
  PointOptions options;
  options.spacing_m = 5;
  EXPECT_EQ(PointSource::open({(folder_ / "1.las").string()}, options)->spacing_m, 5);
}

TEST_F(PointSourceTest, PointsWithoutASpacingNeedOneFromTheUser) {
  PointOptions options;
  options.spacing_m = 3;
  std::string line, place;
  for (int i = 0; i < 50; ++i) {
    line += fmt::format("9 {} 5\n", 47 + 1e-4 * i);
    place += "9 47 5\n";
  }
  for (const std::string& text : {std::string("9 47 5\n9.1 47.1 6\n"), line, place}) {
    const auto path = write("s.xyz", text);
    EXPECT_THAT(message({path}), HasSubstr("say what it is with --spacing M"));
    EXPECT_EQ(message({path}, options), "");
  }
}

TEST_F(PointSourceTest, OccupiedCellsAreBoundedAndDoNotDependOnOrder) {
  std::mt19937 random(2);
  std::uniform_real_distribution<double> lon(10, 10.5), lat(40, 40.5);
  std::vector<std::pair<double, double>> points(OccupiedCells::kMaxCells + 300000);
  for (auto& p : points) p = {lon(random), lat(random)};
  OccupiedCells a, b;
  for (const auto& p : points) a.add(p.first, p.second);
  std::reverse(points.begin(), points.end());
  for (const auto& p : points) b.add(p.first, p.second);
  const double area = a.area_m2(points.size(), kMetresPerDegree);
  EXPECT_EQ(area, b.area_m2(points.size(), kMetresPerDegree));
  EXPECT_NEAR(area / (0.5 * kMetresPerDegree * 0.5 * kMetresPerDegree * std::cos(40.25 * M_PI / 180)), 1, 0.02);
}

TEST_F(PointSourceTest, PointsMayCrossLongitude180) {
  std::string text;
  for (int i = 0; i < 400; ++i) {
    const double lon = 179.99 + 1e-3 * (i % 20);
    text += fmt::format("{:.6f} {} {}\n", lon < 180 ? lon : lon - 360, -17 + 1e-3 * (i / 20), i);
  }
  const auto source = PointSource::open({write("f.xyz", text)}, {});
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_NEAR(source->west_deg, 179.99, 1e-9);
  EXPECT_NEAR(source->east_deg, 180.009, 1e-9);
  for (const GeoPoint& p : points_of(*source)) {
    ASSERT_GE(p.lon_deg, source->west_deg);
    ASSERT_LE(p.lon_deg, source->east_deg);
  }
  // The same place in degrees from 0 to 360.
  std::string from_0;
  for (int i = 0; i < 400; ++i)
    from_0 += fmt::format("{:.6f} {} {}\n", 179.99 + 1e-3 * (i % 20), -17 + 1e-3 * (i / 20), i);
  const auto other = PointSource::open({write("g.xyz", from_0)}, {});
  ASSERT_TRUE(other);
  EXPECT_NEAR(other->east_deg, source->east_deg, 1e-9);
}

TEST_F(PointSourceTest, OrderAndRepetitionOfFilesDoNotMatter) {
  auto west = ground(), east = ground();
  for (auto& p : east) p.x += 40;
  const auto a = write_las("a.las", utm(), west), b = write_las("b.las", utm(), east),
             c = write_las("c.las", utm(), west);
  const auto one = PointSource::open({a, b}, {}), two = PointSource::open({b, c, a}, {});
  ASSERT_TRUE(one && two);
  EXPECT_THAT(two->notes, Contains("1 inputs given twice are used once"));
  ASSERT_EQ(two->files.size(), 2u);
  EXPECT_EQ(one->files[0].sha256, two->files[0].sha256);
  EXPECT_EQ(one->spacing_m, two->spacing_m);
  const auto p = points_of(*one), q = points_of(*two);
  ASSERT_EQ(p.size(), q.size());
  for (std::size_t i = 0; i < p.size(); ++i)
    ASSERT_TRUE(p[i].lon_deg == q[i].lon_deg && p[i].height_m == q[i].height_m);
}

TEST_F(PointSourceTest, FileThatChangesBetweenTwoReadsIsNoticed) {
  const auto path = write_las("a.las", utm(), ground());
  const auto source = PointSource::open({path}, {});
  ASSERT_TRUE(source);
  write_las("a.las", utm(), ground(19));
  const auto read = source->read([](std::span<const GeoPoint>) -> Result<void> { return {}; });
  ASSERT_FALSE(read);
  EXPECT_EQ(read.error().kind, ErrorKind::kIo);
  EXPECT_THAT(read.error().message, HasSubstr("changed while it was read"));
}

TEST_F(PointSourceTest, HeightsBecomeEllipsoidalWithAGeoid) {
  if (!fs::exists("/usr/share/proj/egm96_15.gtx")) GTEST_SKIP() << "needs Debian's proj-data";
  // A test value of NGA for EGM96: N = -31.628 m at 38.628155 N, 90.220845 W.
  std::string text;
  for (int i = 0; i < 100; ++i)
    text += fmt::format("{} {} 100\n", -90.220845 + 1e-5 * (i % 10), 38.628155 + 1e-5 * (i / 10));
  PointOptions options;
  options.vertical_datum = "EPSG:5773";
  const auto path = write("n.xyz", text);
  const auto source = PointSource::open({path}, options);
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_EQ(source->height_kind, "ellipsoidal");
  EXPECT_THAT(source->vertical_datum, HasSubstr("WGS 84 ellipsoid"));
  EXPECT_NEAR(points_of(*source)[0].height_m, 100 - 31.628, 0.05);
  EXPECT_EQ(points_of(path)[0].height_m, 100);
  options.vertical_datum = "EPSG:32632";
  EXPECT_NE(message({path}, options), "");
}

TEST_F(PointSourceTest, AutzenByItsWktAndByItsKeys) {
  const fs::path path = fs::path(TIND_SHARED_DATA) / "lidar/autzen_trim.las";
  if (!fs::exists(path)) GTEST_SKIP() << "needs " << path;
  const auto source = PointSource::open({path.string()}, {});
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_EQ(source->files[0].n_points, 110000u);
  EXPECT_EQ(source->n_used, 26107u);
  // Eugene, Oregon.
  EXPECT_NEAR(source->west_deg, -123.0735, 1e-4);
  EXPECT_NEAR(source->north_deg, 44.0514, 1e-4);
  EXPECT_NEAR(source->spacing_m, 1.3, 0.1);
  for (const GeoPoint& p : points_of(*source)) {
    ASSERT_GT(p.height_m, 406 * 0.3048);
    ASSERT_LT(p.height_m, 435 * 0.3048);
  }
  // User-defined Lambert by GeoTIFF keys with parameters.
  auto bytes = open_bytes(path.string());
  ASSERT_TRUE(bytes);
  auto header = read_las_header(**bytes, "autzen");
  ASSERT_TRUE(header);
  ASSERT_FALSE(header->crs.wkt.empty());
  const auto by_wkt = PointCrs::from_las(header->crs, "autzen");
  header->crs.wkt.clear();
  const auto by_keys = PointCrs::from_las(header->crs, "autzen");
  ASSERT_TRUE(by_wkt && *by_wkt);
  ASSERT_TRUE(by_keys && *by_keys);
  std::vector<double> x = {636001.76, 637179.22}, y = {848935.2, 849497.9}, u = x, v = y;
  EXPECT_EQ((*by_wkt)->to_degrees(x, y), 0u);
  EXPECT_EQ((*by_keys)->to_degrees(u, v), 0u);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_NEAR(x[i], u[i], 1e-8);
    EXPECT_NEAR(y[i], v[i], 1e-8);
  }
  EXPECT_NEAR((*by_keys)->metres_per_z_unit.value(), 0.3048, 1e-12);
}

TEST_F(PointSourceTest, TopographyLiesInQuebec) {
  const fs::path path = fs::path(TIND_SHARED_DATA) / "lidar/Topography.las";
  if (!fs::exists(path)) GTEST_SKIP() << "needs " << path;
  const auto source = PointSource::open({path.string()}, {});
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_EQ(source->n_used, 8159u);
  EXPECT_EQ(source->files[0].crs, "NAD83(CSRS) / MTM zone 7 (EPSG:2949)");
  EXPECT_NEAR(source->west_deg, -70.918, 1e-3);
  EXPECT_NEAR(source->south_deg, 47.6076, 1e-3);
  for (const GeoPoint& p : points_of(*source)) {
    ASSERT_GT(p.height_m, 788);
    ASSERT_LT(p.height_m, 830);
  }
}

}  // namespace
}  // namespace tind
