// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>

namespace tind {

/// For programs: from now on SIGINT and SIGTERM set the returned flag (static lifetime), so that work ends cleanly; a
/// second one ends the process at once. A file size limit (SIGXFSZ) becomes an error of the write.
const std::atomic<bool>* cancel_on_signals();

}  // namespace tind
