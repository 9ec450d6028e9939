// SPDX-License-Identifier: GPL-3.0-or-later
// tind-build report: what it refuses and what it says, the picture, the manual.
#include <cmath>
#include <filesystem>
#include <fstream>
#include <regex>
#include <set>
#include <sstream>

#include <fmt/format.h>
#include <gmock/gmock.h>

#include "storage/tile_store.hpp"
#include "storage/zstd_codec.hpp"
#include "tests/storage/report_world.hpp"

namespace tind::test {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

std::string read_file(const std::string& path) {
  std::ifstream file(path);
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

/// Elements of an XML text by name. Fails the test where tags are not balanced, a name or an attribute is malformed, or
/// a bare & or < is met.
std::map<std::string, int> elements(const std::string& xml) {
  std::map<std::string, int> counts;
  std::vector<std::string> open;
  const std::regex tag(R"(^<(/?)([A-Za-z][A-Za-z0-9]*)((?:\s+[A-Za-z][A-Za-z0-9:-]*="[^"<]*")*)\s*(/?)>)");
  const std::regex entity("^&(amp|lt|gt|quot|apos);");
  std::size_t i = xml.find("?>");
  EXPECT_EQ(xml.rfind("<?xml", 0), 0u);
  for (i += 2; i < xml.size(); ++i) {
    if (xml[i] == '&') {
      EXPECT_TRUE(std::regex_search(xml.begin() + static_cast<std::ptrdiff_t>(i), xml.end(), entity))
          << xml.substr(i, 20);
    }
    if (xml[i] != '<') continue;
    const std::size_t end = xml.find('>', i);
    std::string text = xml.substr(i, end - i + 1);
    // A picture's bytes are long for a regular expression; they are looked at on their own.
    if (const auto data = text.find("base64,"); data != std::string::npos) {
      const std::size_t from = data + 7, to = text.find('"', from);
      EXPECT_EQ(text.find_first_not_of("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/=", from), to);
      EXPECT_EQ(text.substr(from, 11), "iVBORw0KGgo");  // the first eight bytes of a PNG
      EXPECT_EQ((to - from) % 4, 0u);
      text.erase(from, to - from);
    }
    std::smatch match;
    if (!std::regex_search(text, match, tag)) {
      ADD_FAILURE() << "malformed tag " << text.substr(0, 80);
      return counts;
    }
    if (match[1] == "/") {
      EXPECT_TRUE(!open.empty() && open.back() == match[2]) << text;
      if (!open.empty()) open.pop_back();
    } else {
      ++counts[match[2]];
      if (match[4] != "/") open.push_back(match[2]);
    }
    i = end;
  }
  EXPECT_TRUE(open.empty());
  return counts;
}

class ReportCommandTest : public ReportTest {
 protected:
  void SetUp() override {
    ReportTest::SetUp();
    dem_ = write(mountains(), "dem.asc");
    file_ = build(options(dem_, "dem.tind"));
  }
  void expect_refused(const std::vector<std::string>& arguments, int status, const std::string& words) {
    const Output output = run(arguments);
    EXPECT_EQ(output.status, status) << output.err;
    EXPECT_THAT(output.err, HasSubstr(words));
    EXPECT_EQ(output.out, "");
  }
  /// A copy of the pyramid with a changed manifest.
  std::string with_manifest(const std::string& name, const std::function<void(Manifest&)>& change) const {
    const auto store = TileStore::open(file_);
    const auto snapshot = store->snapshot();
    Manifest manifest = decode_manifest(*unpack_value(*snapshot->find_manifest())).value();
    std::set<PieceKey> keys;
    for (const LevelInfo& level : manifest.levels) {
      for (const TileRun& run : level.rows) {
        for (std::uint32_t x = run.x_first; x <= run.x_last; ++x) {
          for (const PieceKey& key : pieces_of({static_cast<std::uint8_t>(level.level), x, run.y})) keys.insert(key);
        }
      }
    }
    change(manifest);
    auto writer = TileStoreWriter::create(path(name));
    for (const PieceKey& key : keys) EXPECT_TRUE(writer->append(key, *snapshot->find(key)).has_value());
    const std::string text = encode_manifest(manifest);
    EXPECT_TRUE(writer->finish(pack_value(Bytes(text.begin(), text.end()))).has_value());
    return path(name);
  }

  std::string dem_, file_;
};

TEST_F(ReportCommandTest, RefusesPyramidsThatAreNone) {
  expect_refused({path("none.tind"), "--source", dem_, "-q"}, 1, "none.tind: No such file");
  std::ofstream(path("text.tind")) << "no pyramid";
  expect_refused({path("text.tind"), "--source", dem_, "-q"}, 1, "text.tind");
  expect_refused({dem_, "--source", dem_, "-q"}, 1, "dem.asc");
  const std::string huge = with_manifest("huge.tind", [](Manifest& m) { m.levels[13].rows = {{0, 0, 16383, {}}}; });
  expect_refused({huge, "--source", dem_, "-q"}, 1, "lists more tiles of level 13 than the file holds");
  const std::string lost = with_manifest("lost.tind", [](Manifest& m) { ++m.levels[13].rows.back().x_last; });
  expect_refused({lost, "--source", dem_, "-q"}, 1, "is missing");
  const std::string odd = with_manifest("odd.tind", [](Manifest& m) { m.options_json = R"({"nodata":"many"})"; });
  expect_refused({odd, "--source", dem_, "-q"}, 1, "options are not those of a builder");
}

TEST_F(ReportCommandTest, RefusesSourcesThatAreNotThePyramids) {
  expect_refused({file_, "--source", path("none.tif"), "-q"}, 1, "none.tif: no such file");
  World other = mountains();
  other.heights_m[0] += 1;
  expect_refused({file_, "--source", write(other, "other.asc"), "-q"}, 1, "other.asc is not a source of the pyramid");
  World east = mountains();
  east.west += 0.06;
  const std::string second = write(east, "east.asc");
  expect_refused({file_, "--source", dem_, second, "-q"}, 1, "east.asc is not a source of the pyramid");
  BuildOptions both = options(dem_, "both.tind");
  both.source.inputs.push_back(second);
  expect_refused({build(both), "--source", dem_, "-q"}, 1, "also built from east.asc");
  expect_refused({file_, "--source", dem_, "--nodata", fmt::format("{:.2f}", mountains().at(0, 0)), "-q"}, 1,
                 "2879 posts were read, the pyramid was built from 2865");
  std::ofstream(path("points.xyz")) << "10 45 3\n10.1 45 3\n10 45.1 3\n10.1 45.1 4\n";
  expect_refused({file_, "--source", path("points.xyz"), "--source-crs", "EPSG:4326", "-q"}, 1,
                 "was built from rasters; give the very files");
}

TEST_F(ReportCommandTest, RefusesOptionsThatMakeNoSense) {
  expect_refused({file_}, 2, "--source");
  expect_refused({"--source", dem_}, 2, "PYRAMID");
  expect_refused({file_, "--source", dem_, "--compare", "cubic"}, 2, "cubic");
  for (const char* levels : {"a", "-", "3-x", "1-2-3", "", "1.5"}) {
    if (*levels) expect_refused({file_, "--source", dem_, "--levels", levels}, 2, "give levels as 8-12, 8- or 10");
  }
  expect_refused({file_, "--source", dem_, "--levels", "12-40", "-q"}, 1, "has levels 0 to 13, not 40");
  expect_refused({file_, "--source", dem_, "--levels", "12-9", "-q"}, 1, "must not be deeper than the last");
  expect_refused({file_, "--source", dem_, "--picture", path("a.png")}, 2, "name it FILE.svg");
  expect_refused({file_, "--source", dem_, "--picture", path("none/a.svg"), "-q"}, 1, "no such folder");
  expect_refused({file_, "--source", dem_, "--picture", path("a.svg"), "--picture-level", "99", "-q"}, 1, "not 99");
  expect_refused({file_, "--source", dem_, "--picture", path("a.svg"), "--picture-level", "2", "-q"}, 1,
                 "level 2 is not measured");
  expect_refused({file_, "--source", dem_, "--class", "ground"}, 2, "--class");
  EXPECT_FALSE(std::filesystem::exists(path("a.svg")));
}

TEST_F(ReportCommandTest, RefusesAnUnconstrainedFileThatDoesNotMatch) {
  expect_refused({file_, "--source", dem_, "--unconstrained", file_, "-q"}, 1, "follows lines, too");
  BuildOptions coarse = options(dem_, "coarse.tind");
  coarse.lines.drainage = false;
  coarse.levels.finest_m = 30;
  expect_refused({file_, "--source", dem_, "--unconstrained", build(coarse), "-q"}, 1, "has other tolerances than");
  World other = mountains();
  other.heights_m[0] += 1;
  BuildOptions foreign = options(write(other, "other.asc"), "foreign.tind");
  foreign.lines.drainage = false;
  expect_refused({file_, "--source", dem_, "--unconstrained", build(foreign), "-q"}, 1,
                 "was not built from the source");
  expect_refused({file_, "--source", dem_, "--unconstrained", path("none.tind"), "-q"}, 1, "none.tind");
}

TEST_F(ReportCommandTest, LeavesNothingBehind) {
  const auto files = [&] {
    std::set<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(folder_)) names.insert(entry.path().filename());
    return names;
  };
  const auto before = files();
  ASSERT_EQ(setenv("TMPDIR", folder_.c_str(), 1), 0);
  EXPECT_EQ(run({file_, "--source", dem_, "-q"}).status, 0);
  EXPECT_EQ(files(), before);
  unsetenv("TMPDIR");
}

TEST_F(ReportCommandTest, TellsWhenTheManifestIsWrong) {
  const Output honest = run({file_, "--source", dem_, "--no-streams", "-q"});
  EXPECT_THAT(honest.out, Not(HasSubstr("by the file's manifest")));
  const std::string liar = with_manifest("liar.tind", [](Manifest& m) { m.levels[12].max_error_m *= 0.999; });
  EXPECT_THAT(run({liar, "--source", dem_, "--no-streams", "-q"}).out, HasSubstr("note: level 12: RMSE"));
  const std::string broken = with_manifest("broken.tind", [](Manifest& m) { m.levels[12].tolerance_m *= 0.9; });
  EXPECT_THAT(run({broken, "--source", dem_, "--no-streams", "-q"}).out, HasSubstr("is above E_L"));
}

TEST_F(ReportCommandTest, PictureIsWellFormedAndHoldsWhatItShould) {
  // A name that XML must escape.
  std::filesystem::rename(file_, path("a<b>&\"c\".tind"));
  file_ = path("a<b>&\"c\".tind");
  ASSERT_EQ(run({file_, "--source", dem_, "--compare", "bilinear", "--picture", path("all.svg"), "-q"}).status, 0);
  const std::string all = read_file(path("all.svg"));
  auto counts = elements(all);
  EXPECT_EQ(counts["svg"], 1);
  EXPECT_EQ(counts["image"], 2);
  EXPECT_EQ(counts["polyline"], 6 + 3 + 4);  // errors, points, streams
  EXPECT_THAT(all, HasSubstr("a&lt;b&gt;&amp;&quot;c&quot;: TIN pyramid, E = 11.1 m at level 13"));
  EXPECT_THAT(all, HasSubstr("TIN, level 13: E = 11.1 m"));
  for (const char* words : {"metres", "points", "quality", "level (below: E_L, m)", "dem.asc", "TIN without lines"}) {
    EXPECT_THAT(all, HasSubstr(words));
  }
  ASSERT_EQ(run({file_, "--source", dem_, "--no-streams", "--picture", path("few.svg"), "--picture-level", "12", "-q"})
                .status,
            0);
  const std::string few = read_file(path("few.svg"));
  counts = elements(few);
  EXPECT_EQ(counts["image"], 2);
  EXPECT_EQ(counts["polyline"], 3 + 1);
  EXPECT_THAT(few, HasSubstr("TIN, level 12"));
  EXPECT_THAT(few, Not(HasSubstr("quality")));
}

TEST_F(ReportCommandTest, ProgressGoesToStandardErrorOnly) {
  const Output output = run({file_, "--source", dem_});
  EXPECT_THAT(output.err, HasSubstr("ETA"));
  EXPECT_THAT(output.err, HasSubstr("building the unconstrained TIN"));
  EXPECT_THAT(output.out, Not(HasSubstr("ETA")));
}

TEST(ReportManual, ListsTheOptionsOfTheHelp) {
  const auto options_in = [](const std::string& text) {
    std::set<std::string> names;
    const std::regex option(R"(--[a-z][a-z-]+)");
    for (auto it = std::sregex_iterator(text.begin(), text.end(), option); it != std::sregex_iterator(); ++it) {
      names.insert(it->str());
    }
    return names;
  };
  struct Caller : ReportTest {
    using ReportTest::run;
    void TestBody() override {}
  };
  const Output help = Caller::run({"--help"});
  EXPECT_EQ(help.status, 0);
  const std::string manual = read_file(TIND_DOCS_DIR "/man/tind-build-report.1.md");
  ASSERT_FALSE(manual.empty());
  EXPECT_EQ(options_in(manual), options_in(help.out));
}

}  // namespace
}  // namespace tind::test
