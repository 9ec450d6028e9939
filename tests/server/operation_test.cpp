// SPDX-License-Identifier: GPL-3.0-or-later
// The daemon in an operator's hands: reloads, swaps under load, the admin listener, service manager, logs, signals.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>
#include <sstream>
#include <thread>

#include "daemon_process.hpp"
#include "raw_client.hpp"
#include "test_site.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;
using test::DaemonProcess;
using test::RawAnswer;
using test::RawClient;
using testing::HasSubstr;
using testing::Not;

std::string read_file(const std::string& path) {
  std::ifstream in(path);
  return {std::istreambuf_iterator<char>(in), {}};
}

RawAnswer ask(std::uint16_t port, const std::string& method, const std::string& target) {
  RawClient client(port);
  client.send(method + " " + target + " HTTP/1.1\r\nHost: h\r\nUser-Agent: a \"test\"\r\n\r\n");
  return client.receive();
}
RawAnswer get(std::uint16_t port, const std::string& target) { return ask(port, "GET", target); }

template <class Condition>
bool soon(Condition condition, int limit_ms = 8000) {
  for (int k = 0; k < limit_ms / 10 && !condition(); ++k) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  return condition();
}

class OperationTest : public testing::Test {
 protected:
  void SetUp() override { put("world", 60); }
  std::string path(const std::string& file) const { return directory_.path + "/" + file; }
  void put(const std::string& name, std::uint32_t n_side) {
    fs::remove(path("made"));
    test::write_pyramid(path("made"), n_side);
    fs::last_write_time(path("made"), fs::file_time_type::clock::now() - std::chrono::hours(1));
    fs::rename(path("made"), path(name + ".tind"));
  }
  // The admin listener's port is in the log.
  std::uint16_t admin_port() {
    const std::string log = read_file(path("log"));
    std::smatch match;
    if (!std::regex_search(log, match, std::regex("admin listener on http://127.0.0.1:([0-9]+)"))) return 0;
    return static_cast<std::uint16_t>(std::stoi(match[1]));
  }
  std::uint16_t await_admin() {
    EXPECT_TRUE(soon([&] { return admin_port() != 0; }));
    return admin_port();
  }
  std::vector<std::string> arguments(std::vector<std::string> more = {}) const {
    std::vector<std::string> all = {path("world.tind"), "--listen", "127.0.0.1:0", "--threads", "2"};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  test::TemporaryDirectory directory_;
};

TEST_F(OperationTest, SwapsUnderLoadFailNoRequestAndMixNoVersions) {
  // Each version's answers, by entity tag.
  std::map<std::string, std::string> bodies;
  const std::string target = "/world/1/1/1.parts";
  for (const std::uint32_t n_side : {70u, 60u}) {
    put("world", n_side);
    DaemonProcess daemon(arguments());
    const RawAnswer answer = get(daemon.port, target);
    ASSERT_EQ(answer.status, 200);
    bodies[answer.field("ETag")] = answer.body;
  }
  ASSERT_EQ(bodies.size(), 2u);
  DaemonProcess daemon(arguments(), path("log"));
  std::atomic<bool> done = false;
  std::atomic<int> n_answers = 0, n_wrong = 0;
  std::vector<std::thread> clients;
  std::array<std::set<std::string>, 3> seen;
  for (auto& tags : seen) {
    clients.emplace_back([&] {
      RawClient client(daemon.port);
      while (!done) {
        client.send("GET " + target + " HTTP/1.1\r\nHost: h\r\n\r\n");
        const RawAnswer answer = client.receive();
        const auto known = bodies.find(answer.field("ETag"));
        if (answer.status != 200 || known == bodies.end() || known->second != answer.body) ++n_wrong;
        tags.insert(answer.field("ETag"));
        ++n_answers;
      }
    });
  }
  constexpr int kSwaps = 20;
  for (int k = 0; k < kSwaps; ++k) {
    const std::string before = get(daemon.port, target).field("ETag");
    put("world", k % 2 == 0 ? 70 : 60);
    EXPECT_TRUE(soon([&] { return get(daemon.port, target).field("ETag") != before; })) << k;
  }
  done = true;
  for (auto& client : clients) client.join();
  EXPECT_EQ(n_wrong, 0);
  EXPECT_GT(n_answers, 1000);
  for (const auto& tags : seen) EXPECT_EQ(tags.size(), 2u);
  const std::string maps = "/proc/" + std::to_string(daemon.pid()) + "/maps";
  EXPECT_TRUE(soon([&] { return read_file(maps).find("(deleted)") == std::string::npos; })) << read_file(maps);
  EXPECT_THAT(read_file(maps), HasSubstr("world.tind"));
  EXPECT_EQ(daemon.stop(SIGTERM), 0);
}

TEST_F(OperationTest, HangupAndReloadRereadFilesAndConfiguration) {
  put("second", 60);
  std::ofstream(path("config.json")) << nlohmann::json{{"datasets", {path("world.tind")}}};
  DaemonProcess daemon({"--config", path("config.json"), "--listen", "127.0.0.1:0", "--watch", "off", "--admin-listen",
                        "127.0.0.1:0", "--threads", "1"},
                       path("log"));
  const std::uint16_t admin = await_admin();
  EXPECT_EQ(get(daemon.port, "/second/meta.json").status, 404);
  std::ofstream(path("config.json")) << nlohmann::json{{"datasets", {path("world.tind"), path("second.tind")}}};
  daemon.send(SIGHUP);
  EXPECT_TRUE(soon([&] { return get(daemon.port, "/second/meta.json").status == 200; }));

  std::ofstream(path("config.json")) << nlohmann::json{{"datasets", {path("second.tind")}}, {"cache_mb", 7}};
  RawAnswer reload = ask(admin, "POST", "/-/reload");
  EXPECT_EQ(reload.status, 200);
  const auto report = nlohmann::json::parse(reload.body);
  EXPECT_EQ(report["ok"], true);
  EXPECT_EQ(report["removed"], nlohmann::json::array({"world"}));
  EXPECT_EQ(report["restart_needed"], nlohmann::json::array({"cache_mb"}));
  EXPECT_EQ(get(daemon.port, "/world/meta.json").status, 404);

  std::ofstream(path("config.json")) << "{";
  reload = ask(admin, "POST", "/-/reload");
  EXPECT_EQ(reload.status, 500);
  EXPECT_THAT(nlohmann::json::parse(reload.body)["settings_error"].get<std::string>(), HasSubstr("line 1"));
  EXPECT_EQ(get(daemon.port, "/second/meta.json").status, 200);
  EXPECT_EQ(daemon.stop(SIGTERM), 0);
}

TEST_F(OperationTest, ABrokenReplacementIsRefusedInOneLineAndTheDaemonGoesOn) {
  DaemonProcess daemon(arguments({"--admin-listen", "127.0.0.1:0"}), path("log"));
  const std::uint16_t admin = await_admin();
  const std::string before = get(daemon.port, "/world/meta.json").body;
  std::ofstream(path("broken")) << std::string(20000, 'x');
  fs::last_write_time(path("broken"), fs::file_time_type::clock::now() - std::chrono::hours(1));
  fs::rename(path("broken"), path("world.tind"));
  EXPECT_TRUE(soon([&] { return read_file(path("log")).find("stays in service") != std::string::npos; }));
  EXPECT_EQ(get(daemon.port, "/world/meta.json").body, before);
  EXPECT_THAT(get(admin, "/metrics").body, HasSubstr("tind_dataset_failures_total 1\n"));
  EXPECT_EQ(daemon.stop(SIGTERM), 0);
  const std::string log = read_file(path("log"));
  EXPECT_EQ(log.find("stays in service"), log.rfind("stays in service")) << log;
}

TEST_F(OperationTest, TheAdminListenerIsApartFromThePublicOne) {
  DaemonProcess daemon(arguments({"--admin-listen", "127.0.0.1:0"}), path("log"));
  const std::uint16_t admin = await_admin();
  for (const char* target : {"/metrics", "/-/reload", "/-/health", "/-/datasets"}) {
    EXPECT_EQ(get(daemon.port, target).status, 404) << target;
  }
  EXPECT_EQ(ask(daemon.port, "POST", "/-/reload").status, 405);
  EXPECT_EQ(get(admin, "/-/health").body, "ok\n");
  EXPECT_EQ(get(admin, "/-/reload").status, 405);
  EXPECT_EQ(get(admin, "/-/reload").field("Allow"), "POST");
  EXPECT_EQ(ask(admin, "POST", "/metrics").status, 405);
  EXPECT_EQ(get(admin, "/world/meta.json").status, 404);
  const auto list = nlohmann::json::parse(get(admin, "/-/datasets").body)["datasets"];
  ASSERT_EQ(list.size(), 1u);
  EXPECT_EQ(list[0]["name"], "world");
  EXPECT_EQ(list[0]["state"], "open");
  EXPECT_EQ(daemon.stop(SIGTERM), 0);
}

TEST_F(OperationTest, MetricsCountWhatHappened) {
  DaemonProcess daemon(arguments({"--admin-listen", "127.0.0.1:0"}), path("log"));
  const std::uint16_t admin = await_admin();
  for (int k = 0; k < 3; ++k) get(daemon.port, "/world/1/1/1.terrain");
  get(daemon.port, "/world/9/9/9.terrain");
  get(daemon.port, "/world/meta.json");
  {
    RawClient malformed(daemon.port);
    malformed.send("GET / HTTP/1.1\r\n\r\n");
    EXPECT_EQ(malformed.receive().status, 400);
  }
  std::string text;
  EXPECT_TRUE(soon([&] {
    text = get(admin, "/metrics").body;
    return text.find("tind_dataset_requests_total{dataset=\"world\"} 5\n") != text.npos;
  })) << text;
  for (const char* line :
       {"tind_http_requests_total{route=\"terrain\",status=\"200\",encoding=\"identity\"} 3\n",
        "tind_http_requests_total{route=\"terrain\",status=\"404\",encoding=\"identity\"} 1\n",
        "tind_http_requests_total{route=\"meta\",status=\"200\",encoding=\"identity\"} 1\n",
        "tind_http_requests_total{route=\"none\",status=\"400\",encoding=\"identity\"} 1\n",
        "tind_http_request_duration_seconds_bucket{le=\"+Inf\"} 6\n", "tind_http_request_duration_seconds_count 6\n",
        "tind_connections_accepted_total 6\n", "tind_cache_hits_total 2\n", "tind_datasets_open 1\n"}) {
    EXPECT_THAT(text, HasSubstr(line));
  }
  EXPECT_THAT(get(admin, "/metrics").field("Content-Type"), HasSubstr("version=0.0.4"));
  EXPECT_EQ(daemon.stop(SIGTERM), 0);
}

// Text format 0.0.4 as Prometheus' own documentation has it, and every family in docs/http.md.
TEST_F(OperationTest, MetricsAreWellFormedAndDocumented) {
  DaemonProcess daemon(arguments({"--admin-listen", "127.0.0.1:0"}), path("log"));
  const std::uint16_t admin = await_admin();
  get(daemon.port, "/world/1/1/1.terrain");
  const std::string documentation = read_file(TIND_DOCS_DIR "/http.md");
  std::istringstream lines(get(admin, "/metrics").body);
  const std::regex sample("([a-z_]+)(\\{([a-z_]+=\"([^\"\\\\]|\\\\.)*\",?)*\\})? ([0-9.e+-]+|\\+Inf)");
  std::map<std::string, std::string> types;
  std::set<std::string> samples;
  std::string family;
  double last_bucket = -1;
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::string hash, keyword, name, type;
    if (line.starts_with("# ")) {
      words >> hash >> keyword >> name >> type;
      if (keyword == "TYPE") {
        EXPECT_TRUE(types.emplace(name, type).second) << "twice: " << name;
        family = name;
        EXPECT_THAT(documentation, HasSubstr("`" + name + "`"));
      } else {
        EXPECT_EQ(keyword, "HELP");
      }
      continue;
    }
    std::smatch match;
    ASSERT_TRUE(std::regex_match(line, match, sample)) << line;
    EXPECT_TRUE(samples.insert(line.substr(0, line.rfind(' '))).second) << "twice: " << line;
    ASSERT_TRUE(match[1].str().starts_with(family)) << line << " is not of family " << family;
    const std::string suffix = match[1].str().substr(family.size());
    if (types[family] == "histogram") {
      EXPECT_THAT(suffix, testing::AnyOf("_bucket", "_sum", "_count"));
      if (suffix == "_bucket") {
        EXPECT_GE(std::stod(match[5]), last_bucket) << "buckets are cumulative";
        last_bucket = std::stod(match[5]);
      }
    } else {
      EXPECT_EQ(suffix, "") << line;
      EXPECT_TRUE(types[family] != "counter" || family.ends_with("_total")) << family;
    }
  }
  EXPECT_GT(types.size(), 25u);
}

TEST_F(OperationTest, AccessLogHasALinePerRequest) {
  DaemonProcess daemon(arguments({"--access-log", path("access"), "--log-format", "json"}), path("log"));
  get(daemon.port, "/world/meta.json");
  get(daemon.port, "/nothing");
  EXPECT_TRUE(soon([&] { return std::ranges::count(read_file(path("access")), '\n') == 2; }));
  std::istringstream lines(read_file(path("access")));
  std::string line;
  std::getline(lines, line);
  const auto first = nlohmann::json::parse(line);
  EXPECT_EQ(first["address"], "127.0.0.1");
  EXPECT_EQ(first["method"], "GET");
  EXPECT_EQ(first["target"], "/world/meta.json");
  EXPECT_EQ(first["status"], 200);
  EXPECT_GT(first["bytes"], 500);
  EXPECT_GT(first["seconds"], 0);
  EXPECT_LT(first["seconds"], 5);
  EXPECT_EQ(first["user_agent"], "a \"test\"");
  fs::rename(path("access"), path("access.1"));
  daemon.send(SIGHUP);
  EXPECT_TRUE(soon([&] { return fs::exists(path("access")); }));
  get(daemon.port, "/health");
  EXPECT_TRUE(soon([&] { return read_file(path("access")).find("/health") != std::string::npos; }));
  EXPECT_EQ(daemon.stop(SIGTERM), 0);
  EXPECT_THAT(read_file(path("access.1")), Not(HasSubstr("/health")));
}

TEST_F(OperationTest, SeveralAddressesAndUnixSockets) {
  const std::string socket_path = path("s");
  {
    DaemonProcess daemon({path("world.tind"), "--listen", "127.0.0.1:0,unix:" + socket_path + ",127.0.0.2:0"});
    EXPECT_EQ(get(daemon.port, "/health").status, 200);
    const int fd = socket(AF_UNIX, SOCK_STREAM, 0);
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    socket_path.copy(address.sun_path, sizeof address.sun_path - 1);
    ASSERT_EQ(connect(fd, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
    const std::string request = "GET /health HTTP/1.1\r\nHost: h\r\nConnection: close\r\n\r\n";
    ASSERT_EQ(write(fd, request.data(), request.size()), static_cast<ssize_t>(request.size()));
    std::string answer(1000, '\0');
    EXPECT_GT(read(fd, answer.data(), answer.size()), 0);
    EXPECT_THAT(answer, testing::StartsWith("HTTP/1.1 200"));
    close(fd);
    daemon.stop(SIGKILL);
  }
  EXPECT_TRUE(fs::exists(socket_path)) << "left by the one that was killed";
  DaemonProcess next({path("world.tind"), "--listen", "unix:" + socket_path});
  EXPECT_EQ(next.first_line, "tind: listening on unix:" + socket_path);
  EXPECT_EQ(next.stop(SIGTERM), 0);
  EXPECT_FALSE(fs::exists(socket_path));
}

TEST_F(OperationTest, SpeaksWithTheServiceManager) {
  const int notify = socket(AF_UNIX, SOCK_DGRAM, 0);
  sockaddr_un notify_address{};
  notify_address.sun_family = AF_UNIX;
  path("notify").copy(notify_address.sun_path, sizeof notify_address.sun_path - 1);
  ASSERT_EQ(bind(notify, reinterpret_cast<sockaddr*>(&notify_address), sizeof notify_address), 0);
  const timeval patience{8, 0};
  setsockopt(notify, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  const auto next_state = [&] {
    std::string text(1000, '\0');
    const ssize_t n = recv(notify, text.data(), text.size(), 0);
    text.resize(static_cast<std::size_t>(std::max<ssize_t>(n, 0)));
    return text;
  };
  const int listening = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t length = sizeof address;
  ASSERT_EQ(bind(listening, reinterpret_cast<sockaddr*>(&address), sizeof address), 0);
  ASSERT_EQ(listen(listening, 10), 0);
  getsockname(listening, reinterpret_cast<sockaddr*>(&address), &length);
  // A client that comes before the daemon does is served all the same.
  RawClient early(ntohs(address.sin_port));
  early.send("GET /health HTTP/1.1\r\nHost: h\r\n\r\n");
  DaemonProcess daemon(arguments(), path("log"), [&] {
    dup2(listening, 3);
    setenv("LISTEN_PID", std::to_string(getpid()).c_str(), 1);
    setenv("LISTEN_FDS", "1", 1);
    setenv("NOTIFY_SOCKET", notify_address.sun_path, 1);
    setenv("WATCHDOG_USEC", "1000000", 1);
  });
  EXPECT_EQ(daemon.port, ntohs(address.sin_port)) << "the socket passed wins over --listen";
  EXPECT_EQ(early.receive().body, "ok\n");
  std::set<std::string> states;
  for (int k = 0; k < 4; ++k) states.insert(next_state());
  EXPECT_THAT(states, testing::Contains("READY=1"));
  EXPECT_THAT(states, testing::Contains("WATCHDOG=1"));
  daemon.send(SIGHUP);
  std::string state;
  do {
    state = next_state();
  } while (state == "WATCHDOG=1");
  EXPECT_THAT(state, testing::StartsWith("RELOADING=1\nMONOTONIC_USEC="));
  do {
    state = next_state();
  } while (state == "WATCHDOG=1");
  EXPECT_EQ(state, "READY=1");
  daemon.send(SIGTERM);
  do {
    state = next_state();
  } while (state == "WATCHDOG=1");
  EXPECT_EQ(state, "STOPPING=1");
  EXPECT_EQ(daemon.wait(), 0);
  close(notify);
  close(listening);
}

TEST_F(OperationTest, ASecondSignalEndsADrainAtOnce) {
  DaemonProcess daemon(arguments({"--drain-timeout-s", "60", "--request-timeout-s", "60"}), path("log"));
  RawClient half(daemon.port);
  half.send("GET /health HTTP/1.1\r\nHo");
  EXPECT_EQ(get(daemon.port, "/health").status, 200);
  const auto begin = std::chrono::steady_clock::now();
  daemon.send(SIGTERM);
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  EXPECT_EQ(daemon.stop(SIGTERM), 0);
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(5));
}

}  // namespace
}  // namespace tind
