// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/socket_address.hpp"

#include <arpa/inet.h>
#include <netdb.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <sys/un.h>

#include <algorithm>
#include <charconv>
#include <cstddef>
#include <cstring>
#include <string_view>

namespace tind {

std::uint16_t SocketAddress::port() const {
  if (family() == AF_INET) return ntohs(reinterpret_cast<const sockaddr_in*>(&storage)->sin_port);
  if (family() == AF_INET6) return ntohs(reinterpret_cast<const sockaddr_in6*>(&storage)->sin6_port);
  return 0;
}

void SocketAddress::set_port(std::uint16_t port) {
  if (family() == AF_INET) reinterpret_cast<sockaddr_in*>(&storage)->sin_port = htons(port);
  if (family() == AF_INET6) reinterpret_cast<sockaddr_in6*>(&storage)->sin6_port = htons(port);
}

std::string SocketAddress::path() const {
  if (family() != AF_UNIX || size <= offsetof(sockaddr_un, sun_path)) return "";
  const auto& un = *reinterpret_cast<const sockaddr_un*>(&storage);
  const std::size_t room = size - offsetof(sockaddr_un, sun_path);
  if (un.sun_path[0] == '\0') return std::string("@").append(un.sun_path + 1, room - 1);
  return {un.sun_path, ::strnlen(un.sun_path, room)};
}

std::string SocketAddress::host() const {
  if (family() == AF_UNIX) return "unix:" + path();
  std::array<char, NI_MAXHOST> host{};
  if (getnameinfo(get(), size, host.data(), host.size(), nullptr, 0, NI_NUMERICHOST) != 0) return "";
  return host.data();
}

std::string SocketAddress::text() const {
  std::string text = host();
  if (family() == AF_UNIX) return text;
  if (family() == AF_INET6) text.insert(0, 1, '[').push_back(']');
  return text.append(1, ':').append(std::to_string(port()));
}

std::string SocketAddress::url() const { return family() == AF_UNIX ? text() : "http://" + text(); }

Result<SocketAddress> resolve_address(const std::string& listen) {
  constexpr std::string_view kUnix = "unix:";
  if (listen.starts_with(kUnix)) {
    const std::string path = listen.substr(kUnix.size());
    SocketAddress address;
    auto& un = *reinterpret_cast<sockaddr_un*>(&address.storage);
    if (path.empty() || path.size() >= sizeof un.sun_path) {
      return fail(ErrorKind::kInvalidInput,
                  fmt::format("--listen {}: a path of 1 to {} bytes", listen, sizeof un.sun_path - 1));
    }
    un.sun_family = AF_UNIX;
    std::memcpy(un.sun_path, path.data(), path.size());
    address.size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + path.size() + 1);
    return address;
  }
  const auto malformed = [&] {
    return fail(ErrorKind::kInvalidInput, "--listen " + listen + ": not HOST:PORT or unix:PATH");
  };
  const auto colon = listen.rfind(':');
  if (colon == listen.npos || colon == 0) return malformed();
  std::string host = listen.substr(0, colon);
  if (host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
  std::uint16_t port = 0;
  const char* const last = listen.data() + listen.size();
  const auto [end, parse_error] = std::from_chars(listen.data() + colon + 1, last, port);
  if (parse_error != std::errc() || end != last) return malformed();
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_PASSIVE;
  addrinfo* found = nullptr;
  if (getaddrinfo(host.c_str(), nullptr, &hints, &found) != 0 || !found) {
    return fail(ErrorKind::kInvalidInput, "--listen " + listen + ": no such host");
  }
  SocketAddress address;
  std::memcpy(&address.storage, found->ai_addr, found->ai_addrlen);
  address.size = found->ai_addrlen;
  address.set_port(port);
  freeaddrinfo(found);
  return address;
}

ClientKey client_key(const SocketAddress& address) {
  ClientKey key{};
  if (address.family() == AF_INET) {
    std::memcpy(key.data(), &reinterpret_cast<const sockaddr_in*>(&address.storage)->sin_addr, 4);
    key[7] = 4;
  } else if (address.family() == AF_INET6) {
    const auto& v6 = reinterpret_cast<const sockaddr_in6*>(&address.storage)->sin6_addr;
    if (IN6_IS_ADDR_V4MAPPED(&v6)) {
      std::memcpy(key.data(), v6.s6_addr + 12, 4);
      key[7] = 4;
    } else {
      std::memcpy(key.data(), v6.s6_addr, key.size());
    }
  }
  return key;
}

}  // namespace tind
