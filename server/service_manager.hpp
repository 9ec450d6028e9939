// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <vector>

namespace tind {

/// systemd's two small protocols, sd_listen_fds(3) and sd_notify(3), spoken without its library, as its manual advises
/// programs that need no more of it.

/// The sockets that systemd opened for us (LISTEN_PID, LISTEN_FDS, LISTEN_FDNAMES), with their names; empty without
/// socket activation. Sets close-on-exec on them. To be called once, before threads.
struct PassedSocket {
  int fd = -1;
  std::string name;  ///< FileDescriptorName=, "unknown" when systemd gives none.
};
std::vector<PassedSocket> take_passed_sockets();

/// Sends a state such as "READY=1" to NOTIFY_SOCKET. Does nothing without one; does not wait. Thread safe.
void notify_service_manager(const std::string& state);

/// How often WATCHDOG=1 is to be sent: half of WATCHDOG_USEC. nullopt: nobody waits for it.
std::optional<std::chrono::microseconds> watchdog_interval();

}  // namespace tind
