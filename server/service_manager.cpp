// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/service_manager.hpp"

#include <fcntl.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <charconv>
#include <cstdlib>
#include <cstring>
#include <string_view>

namespace tind {
namespace {

constexpr int kFirstFd = 3;  // SD_LISTEN_FDS_START
constexpr int kMaxFds = 64;

std::optional<long long> number_in(const char* variable) {
  const char* text = std::getenv(variable);
  if (!text) return std::nullopt;
  long long value = 0;
  const char* const last = text + std::strlen(text);
  const auto [end, error] = std::from_chars(text, last, value);
  if (error != std::errc() || end != last) return std::nullopt;
  return value;
}

}  // namespace

std::vector<PassedSocket> take_passed_sockets() {
  std::vector<PassedSocket> sockets;
  const auto pid = number_in("LISTEN_PID"), n = number_in("LISTEN_FDS");
  const char* const all_names = std::getenv("LISTEN_FDNAMES");
  std::string_view names = all_names ? all_names : "";
  if (pid == ::getpid() && n && *n > 0 && *n <= kMaxFds) {
    for (int k = 0; k < *n; ++k) {
      const auto colon = names.find(':');
      const std::string_view name = names.substr(0, colon);
      names = colon == names.npos ? std::string_view() : names.substr(colon + 1);
      ::fcntl(kFirstFd + k, F_SETFD, FD_CLOEXEC);
      sockets.push_back({kFirstFd + k, name.empty() ? "unknown" : std::string(name)});
    }
  }
  for (const char* variable : {"LISTEN_PID", "LISTEN_FDS", "LISTEN_FDNAMES"}) ::unsetenv(variable);
  return sockets;
}

void notify_service_manager(const std::string& state) {
  const char* const path = std::getenv("NOTIFY_SOCKET");
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (!path || (path[0] != '/' && path[0] != '@') || std::strlen(path) >= sizeof address.sun_path) return;
  std::memcpy(address.sun_path, path, std::strlen(path));
  if (address.sun_path[0] == '@') address.sun_path[0] = '\0';  // the abstract namespace
  const int fd = ::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (fd < 0) return;
  const auto length = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + std::strlen(path));
  // Nothing can be done when it fails: the service manager will notice by itself.
  (void)!::sendto(fd, state.data(), state.size(), MSG_NOSIGNAL | MSG_DONTWAIT, reinterpret_cast<sockaddr*>(&address),
                  length);
  ::close(fd);
}

std::optional<std::chrono::microseconds> watchdog_interval() {
  const auto microseconds = number_in("WATCHDOG_USEC");
  const auto pid = number_in("WATCHDOG_PID");
  if (!microseconds || *microseconds <= 0 || (pid && *pid != ::getpid())) return std::nullopt;
  return std::chrono::microseconds(*microseconds / 2);
}

}  // namespace tind
