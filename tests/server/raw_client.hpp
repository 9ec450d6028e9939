// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace tind::test {

/// One answer as it came over the wire.
struct RawAnswer {
  int status = 0;
  std::string head;  ///< Status line and fields, with the empty line.
  std::string body;
  std::string field(const std::string& name) const;
};

/// A TCP connection to 127.0.0.1 that sends what it is told and knows just enough of HTTP to cut the answers apart.
class RawClient {
 public:
  explicit RawClient(std::uint16_t port, int receive_buffer_bytes = 0);
  ~RawClient();
  RawClient(const RawClient&) = delete;
  RawClient& operator=(const RawClient&) = delete;

  bool send(const std::string& bytes);
  /// Says that no more comes; answers can still be received.
  void finish_sending();
  /// The next answer; status 0 when the connection ended or nothing came for five seconds. `has_body`: false after
  /// HEAD.
  RawAnswer receive(bool has_body = true);
  /// True iff the peer closes within the time, whatever it sends before.
  bool closes_within(int milliseconds);

 private:
  bool fill(int milliseconds);
  int fd_;
  std::string pending_;
};

}  // namespace tind::test
