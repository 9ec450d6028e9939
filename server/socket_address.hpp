// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <sys/socket.h>

#include <array>
#include <cstdint>
#include <string>

#include "core/result.hpp"

namespace tind {

/// Where a socket listens or whom it talks to.
struct SocketAddress {
  sockaddr_storage storage{};
  socklen_t size = sizeof(sockaddr_storage);

  const sockaddr* get() const { return reinterpret_cast<const sockaddr*>(&storage); }
  sockaddr* get() { return reinterpret_cast<sockaddr*>(&storage); }
  int family() const { return storage.ss_family; }
  /// 0 where there are none.
  std::uint16_t port() const;
  void set_port(std::uint16_t port);
  /// "192.0.2.1", "2001:db8::1"; "unix:/path".
  std::string host() const;
  /// "192.0.2.1:80", "[2001:db8::1]:80", "unix:/path".
  std::string text() const;
  /// "http://192.0.2.1:80", "unix:/path".
  std::string url() const;
  /// Of a unix socket; '@' stands for the abstract namespace's first byte. Empty for others.
  std::string path() const;
};

/// "HOST:PORT" or "[V6]:PORT", where the host is an address or a name; or "unix:PATH". kInvalidInput: none of these, or
/// no such host.
Result<SocketAddress> resolve_address(const std::string& listen);

/// The part of an address that stands for one client: an IPv4 address, or the /64 network that an IPv6 client has for
/// itself. Equal clients, equal values; all zero where there is no telling.
using ClientKey = std::array<std::uint8_t, 8>;
ClientKey client_key(const SocketAddress& address);

}  // namespace tind
