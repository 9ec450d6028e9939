// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <tuple>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "core/virtual_node.hpp"
#include "storage/builder/build.hpp"
#include "storage/manifest.hpp"

namespace tind::test {

/// What a run of `tind-build report` left.
struct Output {
  int status = 0;
  std::string out, err;
};

/// All tiles of a `.tind` file, read for a test: looked at by brute force.
struct Tiles {
  Manifest manifest;
  std::map<std::tuple<int, std::uint32_t, std::uint32_t>, VirtualNode> nodes;

  explicit Tiles(const std::string& path);
  /// Height in metres of the level's surface at a real lattice position: every triangle of the level is tried with
  /// barycentric coordinates. NaN: in none.
  double height_m(int level, double x, double y) const;
  /// All vertices of a level, each once: lattice positions.
  std::vector<std::array<std::int64_t, 2>> vertices(int level) const;
};

/// Posts of an ASCII grid as the test itself knows them.
struct World {
  double west = 0, south = 0, spacing = 0;
  int n_rows = 0, n_cols = 0;
  std::vector<float> heights_m;  ///< NaN: void. Row 0 southernmost.

  float at(int r, int c) const { return heights_m[static_cast<std::size_t>(r * n_cols + c)]; }
  double lattice_x(const Lattice& l, double c) const { return (west + c * spacing + 180) / l.step_deg(); }
  double lattice_y(const Lattice& l, double r) const { return (south + r * spacing + 90) / l.step_deg(); }
};

/// Builds tiny pyramids in a folder of its own and runs the report on them.
class ReportTest : public ::testing::Test {
 protected:
  void SetUp() override;
  void TearDown() override;

  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  /// Rough mountains with a void in the middle.
  static World mountains();
  std::string write(const World& world, const std::string& name) const;
  BuildOptions options(const std::string& input, const std::string& output) const;
  /// Builds and expects that to work.
  std::string build(const BuildOptions& options) const;
  /// tind-build report ARGUMENTS.
  static Output run(const std::vector<std::string>& arguments);
  /// The same with --json, expected to work.
  static nlohmann::json report(std::vector<std::string> arguments);

  std::filesystem::path folder_;
};

}  // namespace tind::test
