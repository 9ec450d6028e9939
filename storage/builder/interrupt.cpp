// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/interrupt.hpp"

#include <csignal>

namespace tind {
namespace {

std::atomic<bool> g_cancel{false};
static_assert(std::atomic<bool>::is_always_lock_free, "set from a signal handler");

void on_signal(int signal) {
  g_cancel = true;
  std::signal(signal, SIG_DFL);
}

}  // namespace

const std::atomic<bool>* cancel_on_signals() {
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  std::signal(SIGXFSZ, SIG_IGN);
  return &g_cancel;
}

}  // namespace tind
