// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/connection_table.hpp"

namespace tind {

ConnectionEvent ConnectionTable::admit(const ClientKey& client) {
  ConnectionEvent event = ConnectionEvent::kAccepted;
  if (n_open_.fetch_add(1, std::memory_order_relaxed) >= max_connections_) {
    event = ConnectionEvent::kRefusedFull;
  } else if (max_per_address_ > 0 && client != ClientKey{}) {
    const std::lock_guard lock(mutex_);
    int& n = by_client_[client];
    if (n >= max_per_address_) {
      event = ConnectionEvent::kRefusedAddress;
    } else {
      ++n;
    }
  }
  if (event != ConnectionEvent::kAccepted) n_open_.fetch_sub(1, std::memory_order_relaxed);
  count(event);
  return event;
}

void ConnectionTable::release(const ClientKey& client) {
  n_open_.fetch_sub(1, std::memory_order_relaxed);
  if (max_per_address_ == 0 || client == ClientKey{}) return;
  const std::lock_guard lock(mutex_);
  const auto found = by_client_.find(client);
  if (found != by_client_.end() && --found->second == 0) by_client_.erase(found);
}

}  // namespace tind
