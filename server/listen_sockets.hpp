// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "core/result.hpp"
#include "server/socket_address.hpp"

namespace tind {

/// A socket that listens at `address`, with SO_REUSEPORT where that is a TCP address, so that each worker can have one
/// and the kernel spreads connections over them. The caller closes it. kIo.
Result<int> open_listening_socket(const SocketAddress& address);

/// The sockets of one listener: for each worker its own, of each address.
class ListenSockets {
 public:
  /// `setting`: addresses separated by commas, HOST:PORT or unix:PATH. `passed`: listening sockets that somebody else
  /// has opened; when there are any, they are used instead, and closed in the end. A unix socket that nobody listens at
  /// any more is replaced. kInvalidInput on a malformed address, kIo when one is in use or cannot be bound.
  static Result<ListenSockets> open(const std::string& setting, const std::vector<int>& passed, std::size_t n_workers);
  ListenSockets(ListenSockets&& other) noexcept;
  ListenSockets& operator=(ListenSockets&&) = delete;
  /// Closes what was not taken, and removes unix sockets.
  ~ListenSockets();

  /// Hands over the sockets of one worker, once.
  std::vector<int> take(std::size_t worker);
  /// "http://127.0.0.1:8080" or "unix:/run/tind.sock", with the ports bound; one for each address.
  const std::vector<std::string>& where() const { return where_; }

 private:
  ListenSockets() = default;
  Result<void> add(const std::string& address, std::size_t n_workers);
  Result<void> add_shared(int fd, std::size_t n_workers);

  std::vector<std::vector<int>> by_worker_;
  std::vector<std::string> where_;
  std::vector<std::string> paths_;  // unix sockets made here
};

}  // namespace tind
