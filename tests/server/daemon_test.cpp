// SPDX-License-Identifier: GPL-3.0-or-later
// The program `tind` itself: what it prints, how it ends, what it links.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <fstream>
#include <thread>

#include "daemon_process.hpp"
#include "raw_client.hpp"
#include "test_site.hpp"

namespace tind {
namespace {

using test::DaemonProcess;
using test::RawClient;
using testing::HasSubstr;

const std::string kProgram = TIND_BIN_DIR "/tind";

struct Finished {
  int status = -1;
  std::string out;  // stdout and stderr
};
Finished run(const std::string& command) {
  Finished finished;
  FILE* pipe = popen((command + " 2>&1").c_str(), "r");
  std::array<char, 4096> chunk;
  while (const std::size_t n = fread(chunk.data(), 1, chunk.size(), pipe)) finished.out.append(chunk.data(), n);
  const int status = pclose(pipe);
  finished.status = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return finished;
}

class DaemonTest : public testing::Test {
 protected:
  void SetUp() override { test::write_pyramid(world_); }
  test::TemporaryDirectory directory_;
  std::string world_ = directory_.path + "/world.tind";
};

TEST_F(DaemonTest, SaysWhereItListensServesAndEndsWithZeroOnSignals) {
  for (const int signal : {SIGTERM, SIGINT}) {
    DaemonProcess daemon({world_, "--listen", "127.0.0.1:0", "--threads", "3"});
    EXPECT_EQ(daemon.first_line, "tind: listening on http://127.0.0.1:" + std::to_string(daemon.port));
    ASSERT_GT(daemon.port, 0);
    // Many connections, so that every worker gets some.
    std::vector<std::thread> clients;
    for (int t = 0; t < 4; ++t) {
      clients.emplace_back([&daemon] {
        for (int k = 0; k < 30; ++k) {
          RawClient client(daemon.port);
          client.send("GET /world/1/1/1.terrain?extensions=octvertexnormals HTTP/1.1\r\nHost: h\r\n\r\n");
          EXPECT_EQ(client.receive().status, 200);
        }
      });
    }
    for (auto& client : clients) client.join();
    RawClient open(daemon.port);
    EXPECT_EQ(daemon.stop(signal), 0);
  }
}

TEST_F(DaemonTest, ASecondDaemonOnOnePortFailsInOneLine) {
  DaemonProcess daemon({world_, "--listen", "127.0.0.1:0"});
  const auto second = run(kProgram + " " + world_ + " --listen 127.0.0.1:" + std::to_string(daemon.port));
  EXPECT_EQ(second.status, 1);
  EXPECT_THAT(second.out, HasSubstr("cannot listen on"));
  EXPECT_EQ(std::count(second.out.begin(), second.out.end(), '\n'), 1);
}

TEST_F(DaemonTest, FailuresAreOneLineWithTheirExitStatus) {
  std::ofstream(directory_.path + "/text.tind") << std::string(10000, 'x');
  std::ofstream(directory_.path + "/empty.tind");
  const struct {
    std::string arguments;
    int status;
    std::string says;
  } cases[] = {
      {"", 2, "no dataset"},
      {"--nonsense", 2, "--help"},
      {directory_.path + "/none.tind", 1, "none.tind"},
      {directory_.path + "/text.tind", 1, "text.tind"},
      {directory_.path + "/empty.tind", 1, "empty.tind"},
      {directory_.path + "/none", 1, "/none: no such file"},
      {world_ + " " + world_, 1, "twice"},
      {world_ + " --listen nonsense", 1, "HOST:PORT"},
      {world_ + " --listen 127.0.0.1:99999", 1, "HOST:PORT"},
      {world_ + " --listen 192.0.2.1:0", 1, "cannot listen"},
      {world_ + " --cesium " + directory_.path, 1, "Cesium.js"},
      {world_ + " --threads zero", 2, "--threads"},
  };
  for (const auto& c : cases) {
    const Finished finished = run(kProgram + " " + c.arguments);
    EXPECT_EQ(finished.status, c.status) << c.arguments;
    EXPECT_THAT(finished.out, HasSubstr(c.says));
    EXPECT_EQ(std::count(finished.out.begin(), finished.out.end(), '\n'), 1) << finished.out;
    EXPECT_THAT(finished.out, testing::StartsWith("tind: "));
  }
  EXPECT_EQ(run(kProgram + " --help").status, 0);
}

TEST_F(DaemonTest, LinksNeitherCgalNorGdal) {
  const Finished ldd = run("ldd " + kProgram);
  ASSERT_EQ(ldd.status, 0) << ldd.out;
  EXPECT_THAT(ldd.out, HasSubstr("liblmdb"));
  for (const char* library : {"libgdal", "libgmp", "libmpfr", "libCGAL"}) {
    EXPECT_THAT(ldd.out, testing::Not(HasSubstr(library)));
  }
  // CGAL is header-only: its code would be in the program itself.
  EXPECT_NE(run("grep -c CGAL " + kProgram).status, 0);
}

}  // namespace
}  // namespace tind
