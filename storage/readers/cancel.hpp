// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>

#include "core/result.hpp"

namespace tind {

/// A flag that another thread or a signal handler sets to stop long work; null: nothing stops it.
using CancelFlag = const std::atomic<bool>*;

inline bool is_set(CancelFlag cancel) { return cancel != nullptr && cancel->load(std::memory_order_relaxed); }

/// What work returns that was stopped.
inline tl::unexpected<Error> interrupted() { return fail(ErrorKind::kInterrupted, "interrupted"); }

}  // namespace tind
