// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/storage/report_world.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <set>

#include <fmt/format.h>

#include "core/assembler.hpp"
#include "storage/piece_blob.hpp"
#include "storage/report/report_command.hpp"
#include "storage/tile_store.hpp"
#include "storage/zstd_codec.hpp"
#include "tests/support/test_field.hpp"

namespace tind::test {

Tiles::Tiles(const std::string& path) {
  const auto store = TileStore::open(path);
  const auto snapshot = store->snapshot();
  manifest = decode_manifest(*unpack_value(*snapshot->find_manifest())).value();
  for (const LevelInfo& level : manifest.levels) {
    for (const TileRun& run : level.rows) {
      for (std::uint32_t x = run.x_first; x <= run.x_last; ++x) {
        const TileKey key{static_cast<std::uint8_t>(level.level), x, run.y};
        const auto keys = pieces_of(key);
        TilePieces pieces;
        for (std::size_t k = 0; k < 9; ++k) {
          const Bytes record = unpack_value(*snapshot->find(keys[k])).value();
          if (k == 8) {
            pieces.body = decode_body(record).value();
          } else if (k % 2) {
            pieces.edges[k / 2] = decode_edge(record).value();
          } else {
            pieces.corners[k / 2] = decode_corner(record).value();
          }
        }
        nodes[{level.level, x, run.y}] = assemble(manifest.lattice, key, std::move(pieces)).value();
      }
    }
  }
}

double Tiles::height_m(int level, double x, double y) const {
  const double side = static_cast<double>(manifest.lattice.tile_side(level));
  for (const auto& [key, node] : nodes) {
    if (std::get<0>(key) != level) continue;
    const double px = x - side * std::get<1>(key), py = y - side * std::get<2>(key);
    if (px < 0 || py < 0 || px > side || py > side) continue;
    for (const Triangle& t : node.triangles) {
      const LocalVertex &a = node.vertices[t[0]], &b = node.vertices[t[1]], &c = node.vertices[t[2]];
      const auto cross = [](double ux, double uy, double vx, double vy) { return ux * vy - uy * vx; };
      const double ax = static_cast<double>(a.x), ay = static_cast<double>(a.y), bx = static_cast<double>(b.x) - ax,
                   by = static_cast<double>(b.y) - ay, cx = static_cast<double>(c.x) - ax,
                   cy = static_cast<double>(c.y) - ay;
      const double area = cross(bx, by, cx, cy);
      const double v = cross(px - ax, py - ay, cx, cy) / area, w = cross(bx, by, px - ax, py - ay) / area;
      constexpr double kSlack = 1e-9;
      if (v < -kSlack || w < -kSlack || v + w > 1 + kSlack) continue;
      return (double(a.z) + v * double(b.z - a.z) + w * double(c.z - a.z)) * manifest.lattice.height_unit_m();
    }
  }
  return std::numeric_limits<double>::quiet_NaN();
}

std::vector<std::array<std::int64_t, 2>> Tiles::vertices(int level) const {
  std::set<std::array<std::int64_t, 2>> all;
  const std::int64_t side = manifest.lattice.tile_side(level);
  for (const auto& [key, node] : nodes) {
    if (std::get<0>(key) != level) continue;
    for (const LocalVertex& v : node.vertices) {
      const std::int64_t y = side * std::get<2>(key) + v.y;
      std::int64_t x = (side * std::get<1>(key) + v.x) % manifest.lattice.width();
      // A pole is one point, but edges along it have vertices of their own; far from the data of these tests.
      all.insert({x, y});
    }
  }
  return {all.begin(), all.end()};
}

void ReportTest::SetUp() {
  std::string name = (std::filesystem::temp_directory_path() / "tind-report-XXXXXX").string();
  ASSERT_NE(mkdtemp(name.data()), nullptr);
  folder_ = name;
}

void ReportTest::TearDown() { std::filesystem::remove_all(folder_); }

World ReportTest::mountains() {
  World world{10.0003, 45.0001, 0.001, 48, 60, {}};
  const HeightAt rough = rough_terrain(3, 1500);
  for (int r = 0; r < world.n_rows; ++r) {
    for (int c = 0; c < world.n_cols; ++c) {
      const bool hole = r > 20 && r < 26 && c > 30 && c < 34;
      world.heights_m.push_back(hole ? std::numeric_limits<float>::quiet_NaN()
                                     : std::stof(fmt::format("{:.2f}", rough(r, c))));
    }
  }
  return world;
}

std::string ReportTest::write(const World& world, const std::string& name) const {
  std::string text = fmt::format("ncols {}\nnrows {}\nxllcenter {}\nyllcenter {}\ncellsize {}\nNODATA_value -9999\n",
                                 world.n_cols, world.n_rows, world.west, world.south, world.spacing);
  for (int r = world.n_rows - 1; r >= 0; --r) {
    for (int c = 0; c < world.n_cols; ++c)
      text += fmt::format("{:.2f} ", std::isnan(world.at(r, c)) ? -9999 : world.at(r, c));
    text += '\n';
  }
  std::ofstream(path(name)) << text;
  return path(name);
}

BuildOptions ReportTest::options(const std::string& input, const std::string& output) const {
  BuildOptions o;
  o.source.inputs = {input};
  o.output = path(output);
  o.threads = 2;
  o.falloff_posts = 12;
  o.levels.finest_m = 12;
  o.lines.drainage_cells = 8;
  o.lines.drainage_growth = 2;
  return o;
}

std::string ReportTest::build(const BuildOptions& options) const {
  Progress quiet(nullptr);
  const auto built = build_pyramid(options, quiet);
  EXPECT_TRUE(built.has_value()) << built.error().message;
  return options.output;
}

Output ReportTest::run(const std::vector<std::string>& arguments) {
  std::vector<std::string> words = {"report"};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (std::string& w : words) argv.push_back(w.data());
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  Output result;
  result.status = report_main(static_cast<int>(argv.size()), argv.data());
  std::fflush(stdout);
  result.out = ::testing::internal::GetCapturedStdout();
  result.err = ::testing::internal::GetCapturedStderr();
  return result;
}

nlohmann::json ReportTest::report(std::vector<std::string> arguments) {
  arguments.insert(arguments.end(), {"--json", "--quiet"});
  const Output result = run(arguments);
  EXPECT_EQ(result.status, 0) << result.err;
  return nlohmann::json::parse(result.out);
}

}  // namespace tind::test
