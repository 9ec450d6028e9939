// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <mutex>

#include "server/socket_address.hpp"

namespace tind {

/// How connections ended or never began; for counting.
enum class ConnectionEvent : std::uint8_t {
  kAccepted,
  kRefusedFull,     ///< max_connections
  kRefusedAddress,  ///< max_connections_per_address
  kIdleTimeout,
  kRequestTimeout,
  kSlowReader,
};
inline constexpr std::size_t kConnectionEvents = 6;

/// The open connections of all workers, counted. Thread safe.
class ConnectionTable {
 public:
  /// `max_per_address` 0: no limit, and addresses are not looked at.
  ConnectionTable(int max_connections, int max_per_address)
      : max_connections_(max_connections), max_per_address_(max_per_address) {}

  /// Counts a connection in: kAccepted; or says why it must not be. What was accepted is to be released.
  ConnectionEvent admit(const ClientKey& client);
  void release(const ClientKey& client);

  int n_open() const { return n_open_.load(std::memory_order_relaxed); }
  void count(ConnectionEvent event) {
    counts_[static_cast<std::size_t>(event)].fetch_add(1, std::memory_order_relaxed);
  }
  std::uint64_t count_of(ConnectionEvent event) const {
    return counts_[static_cast<std::size_t>(event)].load(std::memory_order_relaxed);
  }

 private:
  const int max_connections_, max_per_address_;
  std::atomic<int> n_open_ = 0;
  std::array<std::atomic<std::uint64_t>, kConnectionEvents> counts_{};
  std::mutex mutex_;
  std::map<ClientKey, int> by_client_;
};

}  // namespace tind
