// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/listen_sockets.hpp"

#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

namespace tind {
namespace {

tl::unexpected<Error> cannot_listen(const std::string& where, int error) {
  const char* hint = error == EADDRINUSE ? "; stop the other program or give another --listen HOST:PORT" : "";
  return fail(ErrorKind::kIo, "cannot listen on " + where + ": " + std::strerror(error) + hint);
}

// With SO_REUSEPORT a second daemon could bind the same port unnoticed. Without it, binding tells.
Result<void> check_free(const SocketAddress& address) {
  const int fd = ::socket(address.family(), SOCK_STREAM | SOCK_CLOEXEC, 0);
  const int on = 1;
  const bool is_free = fd >= 0 && ::setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) == 0 &&
                       ::bind(fd, address.get(), address.size) == 0;
  const int error = errno;
  if (fd >= 0) ::close(fd);
  if (is_free) return {};
  return cannot_listen(address.text(), error);
}

// A socket file stays when its daemon is killed. One that nobody answers at is in the way only.
void remove_stale(const SocketAddress& address, const std::string& path) {
  const int fd = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (fd < 0) return;
  if (::connect(fd, address.get(), address.size) != 0 && errno == ECONNREFUSED) ::unlink(path.c_str());
  ::close(fd);
}

}  // namespace

Result<int> open_listening_socket(const SocketAddress& address) {
  const int fd = ::socket(address.family(), SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (fd < 0) return cannot_listen(address.text(), errno);
  const int on = 1;
  // Connections inherit TCP_NODELAY.
  const bool ready = address.family() == AF_UNIX || (::setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) == 0 &&
                                                     ::setsockopt(fd, SOL_SOCKET, SO_REUSEPORT, &on, sizeof on) == 0 &&
                                                     ::setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on) == 0);
  if (ready && ::bind(fd, address.get(), address.size) == 0 && ::listen(fd, SOMAXCONN) == 0) return fd;
  const int error = errno;
  ::close(fd);
  return cannot_listen(address.text(), error);
}

ListenSockets::ListenSockets(ListenSockets&& other) noexcept
    : by_worker_(std::move(other.by_worker_)), where_(std::move(other.where_)), paths_(std::move(other.paths_)) {
  other.paths_.clear();
}

ListenSockets::~ListenSockets() {
  for (const auto& fds : by_worker_) {
    for (const int fd : fds) ::close(fd);
  }
  for (const std::string& path : paths_) ::unlink(path.c_str());
}

std::vector<int> ListenSockets::take(std::size_t worker) { return std::exchange(by_worker_[worker], {}); }

Result<ListenSockets> ListenSockets::open(const std::string& setting, const std::vector<int>& passed,
                                          std::size_t n_workers) {
  ListenSockets sockets;
  sockets.by_worker_.resize(n_workers);
  for (const int fd : passed) {
    SocketAddress address;
    ::fcntl(fd, F_SETFL, ::fcntl(fd, F_GETFL) | O_NONBLOCK);
    const int on = 1;
    ::setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);  // a unix socket has none
    if (::getsockname(fd, address.get(), &address.size) != 0) {
      return fail(ErrorKind::kIo, std::string("a socket that was passed is none: ") + std::strerror(errno));
    }
    sockets.where_.push_back(address.url());
    if (auto added = sockets.add_shared(fd, n_workers); !added) return tl::unexpected(added.error());
  }
  for (std::size_t at = 0; passed.empty() && at <= setting.size();) {
    const std::size_t end = std::min(setting.find(',', at), setting.size());
    if (auto added = sockets.add(setting.substr(at, end - at), n_workers); !added) return tl::unexpected(added.error());
    at = end + 1;
  }
  return sockets;
}

Result<void> ListenSockets::add(const std::string& text, std::size_t n_workers) {
  auto address = resolve_address(text);
  if (!address) return tl::unexpected(address.error());
  if (address->family() == AF_UNIX) {
    const std::string path = address->path();
    remove_stale(*address, path);
    const auto fd = open_listening_socket(*address);
    if (!fd) return tl::unexpected(fd.error());
    paths_.push_back(path);
    where_.push_back(address->url());
    return add_shared(*fd, n_workers);
  }
  if (auto free = check_free(*address); !free) return free;
  for (auto& fds : by_worker_) {
    const auto fd = open_listening_socket(*address);
    if (!fd) return tl::unexpected(fd.error());
    fds.push_back(*fd);
    SocketAddress bound;
    if (::getsockname(*fd, bound.get(), &bound.size) == 0) address->set_port(bound.port());  // of port 0
  }
  where_.push_back("http://" + text.substr(0, text.rfind(':')) + ":" + std::to_string(address->port()));
  return {};
}

// One socket for all workers: whoever is free takes the next connection.
Result<void> ListenSockets::add_shared(int fd, std::size_t n_workers) {
  by_worker_[0].push_back(fd);
  for (std::size_t k = 1; k < n_workers; ++k) {
    const int copy = ::fcntl(fd, F_DUPFD_CLOEXEC, 0);
    if (copy < 0) return fail(ErrorKind::kIo, std::string("cannot share a socket: ") + std::strerror(errno));
    by_worker_[k].push_back(copy);
  }
  return {};
}

}  // namespace tind
