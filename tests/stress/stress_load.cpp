// SPDX-License-Identifier: GPL-3.0-or-later
// usage: stress_load PORT LIST CONNECTIONS REQUESTS [PROGRESS]
// Keeps CONNECTIONS connections to 127.0.0.1:PORT busy, one request at a time on each, until REQUESTS answers came.
// LIST has one request a line: path, then for each right answer a tab and VERSION:TAG:LENGTH:HASH (entity tag, body
// bytes, FNV-1a of the body in hexadecimal). An answer that is none of these is wrong; one whose tag is of one version
// and whose body is of another is mixed. Prints "at N" each PROGRESS answers, and at the end one line of JSON. Exit 0
// unless the usage is wrong.
#include <arpa/inet.h>
#include <netinet/tcp.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace {

using Clock = std::chrono::steady_clock;

struct Right {
  std::string version, tag;
  std::size_t length = 0;
  std::uint64_t hash = 0;
};
struct Asked {
  std::string request, path;
  std::vector<Right> rights;
};
struct Connection {
  int fd = -1;
  std::size_t asked = 0, sent = 0;
  std::string in;
  Clock::time_point began;
};
struct Totals {
  std::uint64_t answers = 0, wrong = 0, mixed = 0, broken = 0, closed_politely = 0;
  std::map<std::string, std::uint64_t> of_version;
  std::vector<std::uint32_t> micros;
};

std::uint64_t fnv1a(std::string_view bytes) {
  std::uint64_t hash = 0xcbf29ce484222325;
  for (const char c : bytes) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3;
  return hash;
}

std::vector<Asked> read_list(const char* path) {
  std::vector<Asked> list;
  std::ifstream in(path);
  for (std::string line; std::getline(in, line);) {
    std::istringstream words(line);
    Asked asked;
    std::getline(words, asked.path, '\t');
    asked.request = "GET " + asked.path + " HTTP/1.1\r\nHost: h\r\nAccept-Encoding: gzip\r\n\r\n";
    for (std::string word; std::getline(words, word, '\t');) {
      std::istringstream parts(word);
      Right right;
      std::string length, hash;
      std::getline(parts, right.version, ':');
      std::getline(parts, right.tag, ':');
      std::getline(parts, length, ':');
      std::getline(parts, hash, ':');
      right.length = std::strtoull(length.c_str(), nullptr, 10);
      right.hash = std::strtoull(hash.c_str(), nullptr, 16);
      asked.rights.push_back(std::move(right));
    }
    list.push_back(std::move(asked));
  }
  return list;
}

std::string_view field(std::string_view head, std::string_view name) {
  const auto at = head.find(name);
  if (at == head.npos) return {};
  const auto begin = at + name.size();
  return head.substr(begin, head.find("\r\n", begin) - begin);
}

class Load {
 public:
  Load(std::uint16_t port, std::vector<Asked> list, std::uint64_t n_wanted, std::uint64_t progress)
      : port_(port), list_(std::move(list)), n_wanted_(n_wanted), progress_(progress), epoll_(epoll_create1(0)) {
    totals_.micros.reserve(n_wanted);
  }

  void run(std::size_t n_connections) {
    connections_.resize(n_connections);
    for (Connection& connection : connections_) start(connection);
    std::vector<epoll_event> events(256);
    while (totals_.answers < n_wanted_ && n_open_ > 0) {  // none: nobody listens any more
      const int n = epoll_wait(epoll_, events.data(), static_cast<int>(events.size()), 15000);
      if (n <= 0) {  // nobody answers any more
        totals_.broken += connections_.size();
        return;
      }
      for (int k = 0; k < n; ++k) serve(*static_cast<Connection*>(events[static_cast<std::size_t>(k)].data.ptr));
      if (totals_.broken > 10 * connections_.size()) return;
    }
  }
  const Totals& totals() const { return totals_; }

 private:
  void start(Connection& connection) {
    if (connection.fd >= 0) {
      close(connection.fd);
      --n_open_;
    }
    connection.fd = socket(AF_INET, SOCK_STREAM, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port_);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    connection.in.clear();
    if (connect(connection.fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
      ++totals_.broken;
      close(std::exchange(connection.fd, -1));
      return;
    }
    ++n_open_;
    const int on = 1;
    setsockopt(connection.fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    epoll_event event{EPOLLIN, {.ptr = &connection}};
    epoll_ctl(epoll_, EPOLL_CTL_ADD, connection.fd, &event);
    ask(connection);
  }

  void ask(Connection& connection) {
    connection.asked = next_++ % list_.size();
    const std::string& request = list_[connection.asked].request;
    connection.began = Clock::now();
    // A request is far smaller than a socket's buffer, so it goes out whole.
    if (send(connection.fd, request.data(), request.size(), MSG_NOSIGNAL) != static_cast<ssize_t>(request.size())) {
      ++totals_.broken;
      start(connection);
    }
  }

  void serve(Connection& connection) {
    char chunk[65536];
    const auto n = recv(connection.fd, chunk, sizeof chunk, MSG_DONTWAIT);
    if (n <= 0) {
      if (n < 0 && errno == EAGAIN) return;
      ++totals_.broken;
      return start(connection);
    }
    connection.in.append(chunk, static_cast<std::size_t>(n));
    const auto end = connection.in.find("\r\n\r\n");
    if (end == std::string::npos) return;
    const std::string_view head = std::string_view(connection.in).substr(0, end + 2);
    const auto length = std::strtoull(std::string(field(head, "\r\nContent-Length: ")).c_str(), nullptr, 10);
    if (connection.in.size() < end + 4 + length) return;
    judge(list_[connection.asked], head, std::string_view(connection.in).substr(end + 4));
    const auto took = std::chrono::duration_cast<std::chrono::microseconds>(Clock::now() - connection.began).count();
    totals_.micros.push_back(static_cast<std::uint32_t>(std::min<long>(took, UINT32_MAX)));
    ++totals_.answers;
    if (progress_ > 0 && totals_.answers % progress_ == 0) {
      std::printf("at %llu\n", static_cast<unsigned long long>(totals_.answers));
      std::fflush(stdout);
    }
    if (field(head, "\r\nConnection: ") == "close") {  // its limit of requests a connection
      ++totals_.closed_politely;
      return start(connection);
    }
    connection.in.clear();
    ask(connection);
  }

  void judge(const Asked& asked, std::string_view head, std::string_view body) {
    const std::string_view tag = field(head, "\r\nETag: ");
    const std::uint64_t hash = fnv1a(body);
    const auto fits = [&](const Right& right) { return right.length == body.size() && right.hash == hash; };
    const bool known_body = std::any_of(asked.rights.begin(), asked.rights.end(), fits);
    for (const Right& right : asked.rights) {
      if (right.tag != tag) continue;
      if (fits(right) && head.starts_with("HTTP/1.1 200 ")) {
        ++totals_.of_version[right.version];
      } else {
        ++(known_body ? totals_.mixed : totals_.wrong);
        complain(asked, head);
      }
      return;
    }
    ++totals_.wrong;
    complain(asked, head);
  }

  void complain(const Asked& asked, std::string_view head) {
    if (totals_.wrong + totals_.mixed > 5) return;
    std::fprintf(stderr, "%s:\n%.*s\n", asked.path.c_str(), static_cast<int>(head.size()), head.data());
  }

  std::uint16_t port_;
  std::vector<Asked> list_;
  std::uint64_t n_wanted_, progress_;
  int epoll_;
  std::size_t next_ = 0, n_open_ = 0;
  std::vector<Connection> connections_;
  Totals totals_;
};

std::uint32_t percentile(std::vector<std::uint32_t>& micros, double share) {
  if (micros.empty()) return 0;
  const auto at = micros.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(micros.size() - 1));
  std::nth_element(micros.begin(), at, micros.end());
  return *at;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 5) {
    std::fprintf(stderr, "usage: stress_load PORT LIST CONNECTIONS REQUESTS [PROGRESS]\n");
    return 2;
  }
  auto list = read_list(argv[2]);
  const auto n_connections = std::strtoull(argv[3], nullptr, 10);
  if (list.empty() || n_connections == 0) {
    std::fprintf(stderr, "stress_load: nothing to ask, or nobody to\n");
    return 2;
  }
  Load load(static_cast<std::uint16_t>(std::atoi(argv[1])), std::move(list), std::strtoull(argv[4], nullptr, 10),
            argc > 5 ? std::strtoull(argv[5], nullptr, 10) : 0);
  const auto began = Clock::now();
  load.run(n_connections);
  const double took_s = std::chrono::duration<double>(Clock::now() - began).count();
  Totals totals = load.totals();
  std::string versions;
  for (const auto& [version, n] : totals.of_version) {
    versions += (versions.empty() ? "\"" : ",\"") + version + "\":" + std::to_string(n);
  }
  std::printf(
      "{\"answers\":%llu,\"wrong\":%llu,\"mixed\":%llu,\"broken\":%llu,\"closed_politely\":%llu,\"seconds\":%.3f,"
      "\"p50_us\":%u,\"p99_us\":%u,\"p999_us\":%u,\"versions\":{%s}}\n",
      static_cast<unsigned long long>(totals.answers), static_cast<unsigned long long>(totals.wrong),
      static_cast<unsigned long long>(totals.mixed), static_cast<unsigned long long>(totals.broken),
      static_cast<unsigned long long>(totals.closed_politely), took_s, percentile(totals.micros, 0.5),
      percentile(totals.micros, 0.99), percentile(totals.micros, 0.999), versions.c_str());
  return 0;
}
