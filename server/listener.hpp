// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <functional>
#include <string>

#include "config/settings.hpp"
#include "core/result.hpp"
#include "server/handler.hpp"

namespace tind {

/// Serves until SIGTERM or SIGINT, then drains. Calls `on_listening` with "HOST:PORT" once all workers listen. Blocks
/// those signals in the calling thread before it makes others.
/// kInvalidInput on a malformed address, kIo when it cannot be bound.
Result<void> serve(const Settings& settings, Handler& handler, const SiteHolder& site,
                   const std::function<void(const std::string&)>& on_listening);

}  // namespace tind
