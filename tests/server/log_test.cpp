// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/log.hpp"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>

#include "test_site.hpp"

namespace tind {
namespace {

std::string read_file(const std::string& path) {
  std::ifstream in(path);
  return {std::istreambuf_iterator<char>(in), {}};
}

TEST(Log, AFullPipeCostsLinesAndNoTime) {
  int ends[2];
  ASSERT_EQ(pipe(ends), 0);  // nobody reads
  const auto begin = std::chrono::steady_clock::now();
  std::uint64_t n_dropped = 0;
  {
    LineSink sink(ends[1], 100000);
    const std::string line(99, 'x');
    for (int k = 0; k < 10000; ++k) sink.write(line);
    n_dropped = sink.n_dropped();
    EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::milliseconds(500));
  }
  EXPECT_GT(n_dropped, 7000u) << "the pipe takes 64 KiB, the queue 1000 lines, twice";
  EXPECT_LT(n_dropped, 9500u);
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(3)) << "nor does the end wait for long";
  close(ends[0]);
  close(ends[1]);
}

TEST(Log, AFullDiskCostsLinesOnly) {
  const int full = open("/dev/full", O_WRONLY);
  ASSERT_GE(full, 0);
  auto sink = std::make_unique<LineSink>(full);
  for (int k = 0; k < 10; ++k) sink->write("a line");
  for (int k = 0; k < 500 && sink->n_dropped() < 10; ++k) usleep(10000);
  EXPECT_EQ(sink->n_dropped(), 10u);
  sink.reset();
  close(full);
}

TEST(Log, AFileIsOpenedAgainAfterItWasMovedAway) {
  const test::TemporaryDirectory directory;
  const std::string path = directory.path + "/access.log";
  auto sink = LineSink::open(path);
  ASSERT_TRUE(sink.has_value());
  (*sink)->write("one");
  for (int k = 0; k < 500 && read_file(path).empty(); ++k) usleep(10000);
  std::filesystem::rename(path, path + ".1");
  (*sink)->reopen();
  (*sink)->write("two");
  (*sink).reset();  // writes what waits
  EXPECT_EQ(read_file(path + ".1"), "one\n");
  EXPECT_EQ(read_file(path), "two\n");
  EXPECT_FALSE(LineSink::open(directory.path + "/none/access.log").has_value());
}

TEST(Log, LinesAreOneLineOfTextOrJson) {
  const auto json = nlohmann::json::parse(format_log_line(LogLevel::kWarning, LogFormat::kJson, "a \"b\"\n\xff"));
  EXPECT_EQ(json["level"], "warning");
  EXPECT_EQ(json["message"], "a \"b\"\n\xEF\xBF\xBD");
  EXPECT_THAT(json["time"].get<std::string>(), testing::EndsWith("Z"));
  const std::string text = format_log_line(LogLevel::kError, LogFormat::kText, "a\nforged line");
  EXPECT_THAT(text, testing::EndsWith(" error a?forged line"));
}

TEST(Log, LevelsBelowTheLeastAreSilent) {
  testing::internal::CaptureStderr();
  set_log_level(LogLevel::kWarning);
  log_info("silent");
  log_warning("heard");
  set_log_level(LogLevel::kDebug);
  log_debug("heard too");
  set_log_level(LogLevel::kInfo);
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_THAT(log, testing::Not(testing::HasSubstr("silent")));
  EXPECT_THAT(log, testing::HasSubstr("warning heard\n"));
  EXPECT_THAT(log, testing::HasSubstr("debug heard too\n"));
  for (const char* word : {"debug", "info", "warning", "error"}) {
    EXPECT_THAT(format_log_line(log_level_of(word), LogFormat::kText, "m"), testing::HasSubstr(word));
  }
}

}  // namespace
}  // namespace tind
