// SPDX-License-Identifier: GPL-3.0-or-later
// A build that is stopped in any way and gone on with has the bytes of one that was not.
#include <signal.h>
#include <sys/mount.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <optional>
#include <random>
#include <thread>

#include "tests/e2e/build_program.hpp"

namespace tind::test {
namespace {

using ::testing::HasSubstr;
namespace fs = std::filesystem;

constexpr int kInterrupted = 1;

// How often each stop is tried; TIND_KILLS=100 is the long run.
int n_kills() {
  const char* text = std::getenv("TIND_KILLS");
  return text ? std::max(1, std::atoi(text)) : 12;
}

class BuildInterrupted : public BuildProgram {
 protected:
  void SetUp() override {
    for (const char* name : {"N36W118", "N36W119", "N37W118", "N37W119"}) {
      const std::string path = fmt::format("{}/raster/sierra-2x2/{}.hgt", TIND_SHARED_DATA, name);
      if (!fs::exists(path)) GTEST_SKIP() << path << " is not there";
      inputs_.push_back(path);
    }
    const auto start = std::chrono::steady_clock::now();
    whole_ = folder.file("whole.tind");
    ASSERT_EQ(build(command(whole_)).status, 0);
    seconds_ = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    bytes_ = read_file(whole_);
    ASSERT_GT(bytes_.size(), 4'000'000u) << "too little to be on disk before the end";
  }

  std::vector<std::string> command(const std::string& to, const std::vector<std::string>& more = {}) const {
    std::vector<std::string> arguments = inputs_;
    arguments.insert(arguments.end(), {"-o", to, "--tolerance", "20"});
    arguments.insert(arguments.end(), more.begin(), more.end());
    return arguments;
  }

  // Runs the build and sends it `signal` as soon as `is_time` says so; its status.
  static int build_and_kill(const std::vector<std::string>& arguments, int signal,
                            const std::function<bool()>& is_time) {
    const pid_t child = fork();
    if (child == 0) {
      std::vector<std::string> all = arguments;
      all.emplace_back("-q");
      const std::string path = std::string(TIND_BIN_DIR) + "/tind-build";
      std::vector<char*> argv = {const_cast<char*>(path.c_str())};
      for (const auto& a : all) argv.push_back(const_cast<char*>(a.c_str()));
      argv.push_back(nullptr);
      if (!std::freopen("/dev/null", "w", stderr)) _exit(126);
      execv(path.c_str(), argv.data());
      _exit(127);
    }
    int status = 0;
    while (!is_time()) {
      if (waitpid(child, &status, WNOHANG) == child) return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    kill(child, signal);
    waitpid(child, &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }

  // After a while; says nothing about how far a build has come on a machine that others use.
  static std::function<bool()> after(double seconds) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
    return [end] { return std::chrono::steady_clock::now() >= end; };
  }
  // When so much of the output is on disk.
  static std::function<bool()> when_stored(const std::string& to, std::uintmax_t n_bytes) {
    return [to, n_bytes] {
      std::error_code code;
      const auto size = fs::file_size(to + ".partial", code);
      return !code && size >= n_bytes;
    };
  }

  // The same command with --resume ends with the whole build's bytes and leaves nothing beside them.
  void expect_resumed(const std::string& to, const std::string& how) const {
    const auto resumed = build(command(to, {"--resume"}));
    EXPECT_EQ(resumed.status, 0) << how << ": " << resumed.err;
    EXPECT_TRUE(read_file(to) == bytes_) << how;
    EXPECT_FALSE(fs::exists(to + ".partial")) << how;
    EXPECT_FALSE(fs::exists(to + ".partial.json")) << how;
  }

  std::vector<std::string> inputs_;
  std::string whole_, bytes_;
  double seconds_ = 0;
};

TEST_F(BuildInterrupted, KilledAtAnyMomentItGoesOnToTheSameBytes) {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> when(0, 1);
  int n_with_work = 0, n_stopped = 0;
  for (int k = 0; k < n_kills(); ++k) {
    const std::string to = folder.file(fmt::format("killed{}.tind", k));
    const int signal = k % 3 == 2 ? SIGTERM : SIGKILL;
    // At a moment of the work, or of the clock: the work leaves out what comes before the first tile.
    const double share = when(random);
    const bool by_clock = k % 4 == 1;
    const int status = build_and_kill(
        command(to), signal,
        by_clock ? after(share * seconds_)
                 : when_stored(to, static_cast<std::uintmax_t>(share * 0.9 * static_cast<double>(bytes_.size()))));
    n_stopped += status != 0;
    std::error_code code;
    n_with_work += fs::file_size(to + ".partial", code) > 1'000'000 && !code;
    // Now and then the second run is killed, too.
    if (k % 4 == 3) build_and_kill(command(to, {"--resume"}), SIGKILL, after(when(random) * seconds_));
    expect_resumed(to, fmt::format("signal {} at {:.3f} of the {}", signal, share, by_clock ? "time" : "work"));
    fs::remove(to);
  }
  EXPECT_GT(n_stopped, n_kills() / 2);
  EXPECT_GT(n_with_work, 0) << "no kill came when there was something to go on with";
}

TEST_F(BuildInterrupted, BrokenDiskThenGoesOn) {
  std::mt19937 random(5);
  std::uniform_int_distribution<int> when(1, 24);
  for (int k = 0; k < std::max(2, n_kills() / 4); ++k) {
    const std::string to = folder.file(fmt::format("broken{}.tind", k));
    const int after = when(random);
    const auto failed = build(command(to), [after] {
      setenv("LD_PRELOAD", TIND_FAILING_WRITES, 1);
      setenv("TIND_FAIL_AFTER", std::to_string(after).c_str(), 1);
    });
    EXPECT_EQ(failed.status, 1) << "after " << after << " writes: " << failed.err;
    EXPECT_EQ(count_lines(failed.err), 1u) << failed.err;
    EXPECT_FALSE(fs::exists(to));
    expect_resumed(to, fmt::format("EIO after {} writes", after));
    fs::remove(to);
  }
}

TEST_F(BuildInterrupted, FullDiskThenGoesOn) {
  const std::string disk = folder.file("disk");
  fs::create_directory(disk);
  if (mount("tind-e2e", disk.c_str(), "tmpfs", 0, "size=600m") != 0) {
    GTEST_SKIP() << "cannot mount a small tmpfs here (needs root): the full disk was not tried";
  }
  std::mt19937 random(6);
  std::uniform_int_distribution<int> fill(1, 6);
  int n_full = 0;
  for (int k = 0; k < std::max(2, n_kills() / 4); ++k) {
    const std::string to = disk + "/full.tind";
    // Room for the working copy of the posts and a few megabytes of the pyramid; the disk fills while it is written.
    const std::string ballast = disk + "/ballast";
    const auto first = build(command(to), [&] {
      const pid_t filler = fork();
      if (filler != 0) return;
      // Takes all but a few megabytes as soon as the posts have their place.
      for (int waited = 0; waited < 1000 && !fs::exists(to + ".partial"); ++waited) usleep(5000);
      usleep(400'000);
      const auto space = fs::space(disk);
      const auto keep = static_cast<std::uintmax_t>(fill(random)) << 20;
      std::FILE* file = std::fopen(ballast.c_str(), "wb");
      const std::vector<char> megabyte(1 << 20);
      for (std::uintmax_t n = keep; file && n < space.available; n += megabyte.size()) {
        if (std::fwrite(megabyte.data(), 1, megabyte.size(), file) != megabyte.size()) break;
      }
      if (file) std::fclose(file);
      _exit(0);
    });
    if (first.status != 0) {
      ++n_full;
      EXPECT_EQ(first.status, 1);
      EXPECT_THAT(first.err, testing::AnyOf(HasSubstr("space"), HasSubstr("full"))) << first.err;
    }
    fs::remove(ballast);
    if (first.status != 0) expect_resumed(to, "full disk");
    fs::remove(to);
  }
  EXPECT_EQ(umount(disk.c_str()), 0);
  EXPECT_GT(n_full, 0) << "the disk never filled in time";
}

TEST_F(BuildInterrupted, StoppedBuildIsNotDroppedWithoutAWord) {
  const std::string to = folder.file("stopped.tind");
  ASSERT_EQ(build_and_kill(command(to), SIGKILL, when_stored(to, bytes_.size() / 2)), 128 + SIGKILL);
  ASSERT_TRUE(fs::exists(to + ".partial"));
  const auto again = build(command(to));
  EXPECT_EQ(again.status, 1);
  EXPECT_THAT(again.err, HasSubstr("--resume"));
  EXPECT_TRUE(fs::exists(to + ".partial"));
  // Another option, another input: refused by name, and what is there stays.
  const auto other = build(command(to, {"--resume", "--base-height", "7"}));
  EXPECT_EQ(other.status, 1);
  EXPECT_THAT(other.err, HasSubstr("base_height_m was 0.0, is 7.0"));
  inputs_.pop_back();
  const auto fewer = build(command(to, {"--resume"}));
  EXPECT_EQ(fewer.status, 1);
  EXPECT_THAT(fewer.err, HasSubstr("N37W119.hgt"));
  EXPECT_TRUE(fs::exists(to + ".partial"));
  inputs_.push_back(std::string(TIND_SHARED_DATA) + "/raster/sierra-2x2/N37W119.hgt");
  expect_resumed(to, "after refusals");
  // Done is done.
  EXPECT_EQ(build(command(to, {"--resume"})).status, 0);
  EXPECT_TRUE(read_file(to) == bytes_);
}

TEST_F(BuildInterrupted, TermStopsWithinSecondsAndSaysHowToGoOn) {
  const std::string to = folder.file("term.tind");
  std::optional<std::chrono::steady_clock::time_point> told;
  const auto is_time = [&told, stored = when_stored(to, bytes_.size() / 3)] {
    if (stored()) told = std::chrono::steady_clock::now();
    return told.has_value();
  };
  EXPECT_EQ(build_and_kill(command(to), SIGTERM, is_time), kInterrupted);
  ASSERT_TRUE(told);
  EXPECT_LT(std::chrono::steady_clock::now() - *told, std::chrono::seconds(10));
  EXPECT_FALSE(fs::exists(to));
  expect_resumed(to, "SIGTERM");
}

TEST_F(BuildInterrupted, ShardsJoinToTheWhole) {
  std::vector<std::string> merge = {"merge"};
  for (int k = 0; k < 4; ++k) {
    const std::string to = folder.file(fmt::format("shard{}.tind", k));
    ASSERT_EQ(build(command(to, {"--shard", fmt::format("{}/4", k)})).status, 0);
    EXPECT_LT(fs::file_size(to), bytes_.size());
    merge.push_back(to);
  }
  const std::string joined = folder.file("joined.tind");
  std::vector<std::string> missing(merge.begin(), merge.end() - 1);
  missing.insert(missing.end(), {"-o", joined});
  const auto refused = build(missing);
  EXPECT_EQ(refused.status, 1);
  EXPECT_THAT(refused.err, HasSubstr("shards are missing: 3/4"));
  EXPECT_FALSE(fs::exists(joined));
  std::swap(merge[1], merge[3]);  // any order
  merge.insert(merge.end(), {"-o", joined});
  const auto merged = build(merge);
  EXPECT_EQ(merged.status, 0) << merged.err;
  EXPECT_TRUE(read_file(joined) == bytes_);
  // A whole pyramid is no shard; a shard of another build does not match.
  EXPECT_THAT(build({"merge", whole_, "-o", folder.file("x.tind")}).err, HasSubstr("no shard"));
  ASSERT_EQ(build(command(merge[1], {"--shard", "3/4", "--force", "--base-height", "3"})).status, 0);
  const auto mixed = build([&] {
    auto arguments = merge;
    arguments.emplace_back("--force");
    return arguments;
  }());
  EXPECT_EQ(mixed.status, 1);
  EXPECT_THAT(mixed.err, HasSubstr("base_height_m"));
  EXPECT_TRUE(read_file(joined) == bytes_);
}

TEST_F(BuildInterrupted, UpdateBuildsWhatAPatchChangesAndNoMore) {
  for (std::string& input : inputs_) {
    const std::string copy = folder.file(fs::path(input).filename().string());
    fs::copy_file(input, copy);
    fs::permissions(copy, fs::perms::owner_write, fs::perm_options::add);
    input = copy;
  }
  const std::string file = folder.file("kept.tind"), tiles = folder.file("tiles.txt"), report = folder.file("r.json");
  const std::vector<std::string> plain = {"--no-drainage"};
  ASSERT_EQ(build(command(file, plain)).status, 0);
  const std::string before = read_file(file);
  // Nothing changed: the file is left alone.
  const auto first = fs::last_write_time(file);
  ASSERT_EQ(build({"update", file, "--changed", inputs_[0]}).status, 0);
  EXPECT_EQ(fs::last_write_time(file), first);
  // Three by three posts in the middle of one input, 37 m up.
  std::string posts = read_file(inputs_[0]);
  constexpr std::size_t kSide = 1201;
  for (std::size_t r = 600; r < 603; ++r) {
    for (std::size_t c = 700; c < 703; ++c) {
      char* at = &posts[2 * (r * kSide + c)];
      const int height = static_cast<unsigned char>(at[0]) << 8 | static_cast<unsigned char>(at[1]);
      at[0] = static_cast<char>((height + 37) >> 8);
      at[1] = static_cast<char>(height + 37);
    }
  }
  write_file(inputs_[0], posts);
  const std::string rebuilt = folder.file("rebuilt.tind");
  ASSERT_EQ(build(command(rebuilt, plain)).status, 0);
  const auto updated = build({"update", file, "--changed", inputs_[0], "--changed-tiles", tiles, "--report", report});
  ASSERT_EQ(updated.status, 0) << updated.err;
  EXPECT_TRUE(read_file(file) != before);
  EXPECT_TRUE(read_file(file) == read_file(rebuilt));
  // The patch lies inside one tile of every level.
  const auto levels = nlohmann::json::parse(read_file(report))["levels"];
  for (const auto& level : levels) EXPECT_EQ(level["tiles_built"], 1) << level["level"];
  EXPECT_GE(count_lines(read_file(tiles)), 1u);
  EXPECT_LE(count_lines(read_file(tiles)), levels.size());
  // Damage is not taken over.
  const std::string sound = read_file(file);
  std::string damaged = sound;
  constexpr std::size_t kPage = 4096;
  const std::size_t middle = damaged.size() / 2 / kPage * kPage;
  for (std::size_t k = 0; k < 20; ++k) damaged[middle + k * kPage + kPage / 2] ^= 0x10;  // most of it are bodies
  write_file(file, damaged);
  const auto refused = build({"update", file});
  EXPECT_EQ(refused.status, 1);
  EXPECT_THAT(refused.err, HasSubstr("damaged"));
  EXPECT_TRUE(read_file(file) == damaged);
  write_file(file, sound);
  // An input that is nowhere is named.
  fs::remove(inputs_[1]);
  const auto missing = build({"update", file});
  EXPECT_EQ(missing.status, 1);
  EXPECT_THAT(missing.err, HasSubstr(fs::path(inputs_[1]).filename().string()));
  EXPECT_TRUE(read_file(file) == read_file(rebuilt));
}

}  // namespace
}  // namespace tind::test
