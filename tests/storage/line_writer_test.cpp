// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/line_writer.hpp"

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "storage/readers/ogr_lines.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class LineWriterTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-line-writer-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  static std::string bytes(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  std::size_t n_files() const {
    return static_cast<std::size_t>(std::distance(fs::directory_iterator(folder_), fs::directory_iterator()));
  }

  fs::path folder_;
};

std::vector<OutputLayer> two_layers() {
  OutputLine stream{{{-105.25, 37.5, 3000.25}, {-105.24, 37.5, 2990}, {-105.23, 37.51, 2980.5}}, "stream", 3, 12.5, 9};
  OutputLine shore{{{-105.2, 37.4, 1}, {-105.1, 37.4, 1}, {-105.1, 37.45, 1}, {-105.2, 37.4, 1}}, "shore", {}, {}, 10};
  return {{"level_9", {stream}}, {"level_10", {stream, shore}}};
}

TEST_F(LineWriterTest, LinesComeBackAsTheyWere) {
  ASSERT_TRUE(write_lines(path("a.gpkg"), two_layers(), false));
  EXPECT_EQ(n_files(), 1U);  // nothing unfinished beside it
  BreakLineOptions options;
  options.lattice.level = 12;
  options.dx = options.dy = 1e9;
  options.east_x = options.lattice.width();
  options.north_y = options.lattice.height();
  options.surface_m = [](std::int64_t, std::int64_t) { return 0.0; };
  options.max_change_m = 1e5;
  const BreakLineFile both[] = {{path("a.gpkg"), false}};
  const auto ambiguous = read_break_lines(both, options);
  ASSERT_FALSE(ambiguous);
  EXPECT_THAT(ambiguous.error().message, HasSubstr("has 2 layers (level_9, level_10); name one"));
  const BreakLineFile one[] = {{path("a.gpkg") + ":level_9", false}};
  const auto lines = read_break_lines(one, options);
  ASSERT_TRUE(lines) << lines.error().message;
  ASSERT_EQ(lines->chains.size(), 1U);
  ASSERT_EQ(lines->chains[0].vertices.size(), 3U);
  const BreakVertex& last = lines->chains[0].vertices[2];
  EXPECT_NEAR(options.lattice.longitude_deg(last.x), -105.23, options.lattice.step_deg());
  EXPECT_NEAR(options.lattice.latitude_deg(last.y), 37.51, options.lattice.step_deg());
  EXPECT_EQ(last.height_m, 2980.5);
}

TEST_F(LineWriterTest, SameLinesGiveTheSameBytes) {
  ASSERT_TRUE(write_lines(path("a.gpkg"), two_layers(), false));
  ASSERT_TRUE(write_lines(path("b.gpkg"), two_layers(), false));
  EXPECT_EQ(bytes(path("a.gpkg")), bytes(path("b.gpkg")));
  EXPECT_THAT(bytes(path("a.gpkg")), HasSubstr("2000-01-01T00:00:00.000Z"));  // no clock
  auto other = two_layers();
  other[0].lines[0].strahler = 4;
  ASSERT_TRUE(write_lines(path("c.gpkg"), other, false));
  EXPECT_NE(bytes(path("a.gpkg")), bytes(path("c.gpkg")));
}

TEST_F(LineWriterTest, ExistingFileIsKeptUnlessForced) {
  std::ofstream(path("a.gpkg")) << "mine";
  const auto refused = write_lines(path("a.gpkg"), two_layers(), false);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kInvalidInput);
  EXPECT_THAT(refused.error().message, HasSubstr("exists"));
  EXPECT_EQ(bytes(path("a.gpkg")), "mine");
  ASSERT_TRUE(write_lines(path("a.gpkg"), two_layers(), true));
  EXPECT_NE(bytes(path("a.gpkg")), "mine");
}

TEST_F(LineWriterTest, LeftoverOfAnInterruptedRunIsOverwritten) {
  std::ofstream(path("a.partial.gpkg")) << "half a file";
  EXPECT_TRUE(write_lines(path("a.gpkg"), two_layers(), false));
  EXPECT_EQ(n_files(), 1U);
}

TEST_F(LineWriterTest, MissingFolderIsSaid) {
  const auto refused = write_lines(path("no/such/a.gpkg"), two_layers(), false);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kIo);
  EXPECT_THAT(refused.error().message, HasSubstr("cannot write it"));
}

TEST_F(LineWriterTest, OtherEndingsAreRefused) {
  const auto refused = write_lines(path("a.shp"), two_layers(), false);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("name it .gpkg"));
}

TEST_F(LineWriterTest, LayersNeedNamesOfTheirOwn) {
  auto layers = two_layers();
  layers[1].name = layers[0].name;
  const auto refused = write_lines(path("a.gpkg"), layers, false);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("'level_9'"));
  EXPECT_EQ(n_files(), 0U);
}

TEST_F(LineWriterTest, EmptyLayersAreWritten) {
  const std::vector<OutputLayer> layers{{"level_3", {}}};
  EXPECT_TRUE(write_lines(path("a.gpkg"), layers, false));
  EXPECT_EQ(n_files(), 1U);
}

}  // namespace
}  // namespace tind
