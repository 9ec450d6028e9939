// SPDX-License-Identifier: GPL-3.0-or-later
#include "raw_client.hpp"

#include <arpa/inet.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>

namespace tind::test {

constexpr int kPatience_ms = 5000;

std::string RawAnswer::field(const std::string& name) const {
  const auto at = head.find("\r\n" + name + ": ");
  if (at == head.npos) return "";
  const auto begin = at + name.size() + 4;
  return head.substr(begin, head.find("\r\n", begin) - begin);
}

RawClient::RawClient(std::uint16_t port, int receive_buffer_bytes) : fd_(::socket(AF_INET, SOCK_STREAM, 0)) {
  if (receive_buffer_bytes > 0) {
    setsockopt(fd_, SOL_SOCKET, SO_RCVBUF, &receive_buffer_bytes, sizeof receive_buffer_bytes);
  }
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  if (::connect(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    ::close(fd_);
    fd_ = -1;
  }
}
RawClient::~RawClient() {
  if (fd_ >= 0) ::close(fd_);
}

bool RawClient::send(const std::string& bytes) {
  std::size_t sent = 0;
  while (sent < bytes.size()) {
    const auto n = ::send(fd_, bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
    if (n <= 0) return false;
    sent += static_cast<std::size_t>(n);
  }
  return true;
}

void RawClient::finish_sending() { ::shutdown(fd_, SHUT_WR); }

bool RawClient::fill(int milliseconds) {
  pollfd wait{fd_, POLLIN, 0};
  if (::poll(&wait, 1, milliseconds) <= 0) return false;
  char chunk[65536];
  const auto n = ::recv(fd_, chunk, sizeof chunk, 0);
  if (n <= 0) return false;
  pending_.append(chunk, static_cast<std::size_t>(n));
  return true;
}

RawAnswer RawClient::receive(bool has_body) {
  RawAnswer answer;
  std::size_t end;
  while ((end = pending_.find("\r\n\r\n")) == pending_.npos) {
    if (!fill(kPatience_ms)) return answer;
  }
  answer.head = pending_.substr(0, end + 4);
  pending_.erase(0, end + 4);
  const int status = std::atoi(answer.head.c_str() + 9);
  const std::size_t length = has_body ? std::strtoul(answer.field("Content-Length").c_str(), nullptr, 10) : 0;
  while (pending_.size() < length) {
    if (!fill(kPatience_ms)) return answer;
  }
  answer.body = pending_.substr(0, length);
  pending_.erase(0, length);
  answer.status = status;
  return answer;
}

bool RawClient::closes_within(int milliseconds) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::milliseconds(milliseconds);
  for (;;) {
    const auto left =
        std::chrono::duration_cast<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
    pollfd wait{fd_, POLLIN, 0};
    if (left.count() <= 0 || ::poll(&wait, 1, static_cast<int>(left.count())) <= 0) return false;
    char chunk[65536];
    if (::recv(fd_, chunk, sizeof chunk, 0) <= 0) return true;
  }
}

}  // namespace tind::test
