// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <functional>
#include <string>

#include "config/settings.hpp"
#include "core/result.hpp"
#include "server/handler.hpp"
#include "server/keeper.hpp"

namespace tind {

/// Blocks the signals that serve() waits for, in this thread and those that it makes later. To be called before there
/// are others.
void block_signals();

/// Serves until SIGTERM or SIGINT, then drains; another one ends it at once. SIGHUP makes the keeper reload. Calls
/// `on_listening` with "HOST:PORT" once all workers listen.
/// kInvalidInput on a malformed address, kIo when it cannot be bound.
Result<void> serve(const Settings& settings, Handler& handler, const SiteHolder& site, Keeper& keeper,
                   const std::function<void(const std::string&)>& on_listening);

}  // namespace tind
