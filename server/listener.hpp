// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "config/settings.hpp"
#include "core/result.hpp"
#include "server/handler.hpp"
#include "server/keeper.hpp"
#include "server/log.hpp"
#include "server/service_manager.hpp"

namespace tind {

/// Blocks the signals that serve() waits for, in this thread and those that it makes later. To be called before there
/// are others.
void block_signals();

/// What serve() works with; the references must outlive it.
struct ServeParts {
  const Settings& settings;
  Handler& handler;
  const SiteHolder& site;
  Keeper& keeper;
  LineSink* access_log = nullptr;     ///< nullptr: none.
  std::vector<PassedSocket> sockets;  ///< Of the service manager: "admin" for that listener, others for the public one.
};

/// Serves until SIGTERM or SIGINT, then drains; another one ends it at once. SIGHUP makes the keeper reload. Calls
/// `on_listening` with "http://HOST:PORT" or "unix:PATH", for each public address, once all workers listen.
/// kInvalidInput on a malformed address, kIo when it cannot be bound.
Result<void> serve(ServeParts parts, const std::function<void(const std::vector<std::string>&)>& on_listening);

}  // namespace tind
