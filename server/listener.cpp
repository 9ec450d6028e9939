// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/listener.hpp"

#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>
#include <thread>
#include <vector>

#include "server/service_manager.hpp"
#include "server/worker.hpp"

namespace tind {
namespace {

// With SO_REUSEPORT a second daemon could bind the same port unnoticed. Without it, binding tells.
Result<void> check_free(const SocketAddress& address, const std::string& where) {
  const int fd = ::socket(address.family(), SOCK_STREAM | SOCK_CLOEXEC, 0);
  const int on = 1;
  const bool is_free = fd >= 0 && ::setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) == 0 &&
                       ::bind(fd, address.get(), address.size) == 0;
  const int error = errno;
  if (fd >= 0) ::close(fd);
  if (is_free) return {};
  const char* hint = error == EADDRINUSE ? "; stop the other program or give another --listen HOST:PORT" : "";
  return fail(ErrorKind::kIo, "cannot listen on " + where + ": " + std::strerror(error) + hint);
}

sigset_t awaited_signals() {
  sigset_t signals;
  sigemptyset(&signals);
  for (const int signal : {SIGTERM, SIGINT, SIGHUP}) sigaddset(&signals, signal);
  return signals;
}

// Returns when the workers have drained, or when somebody does not want to wait for that.
void wait_for_signals(Handler& handler, Keeper& keeper, std::vector<std::unique_ptr<Worker>>& workers) {
  const sigset_t signals = awaited_signals();
  const timespec pause{0, 50'000'000};
  for (bool draining = false;;) {
    const int signal = draining ? ::sigtimedwait(&signals, nullptr, &pause) : ::sigwaitinfo(&signals, nullptr);
    if (signal == SIGHUP && !draining) keeper.request_reload();
    if (signal == SIGTERM || signal == SIGINT) {
      if (draining) {
        for (auto& worker : workers) worker->stop();
        return;
      }
      draining = true;
      notify_service_manager("STOPPING=1");
      handler.set_draining();
      for (auto& worker : workers) worker->drain();
    }
    const auto ended = [](const auto& worker) { return worker->ended(); };
    if (draining && std::all_of(workers.begin(), workers.end(), ended)) return;
  }
}

}  // namespace

void block_signals() {
  const sigset_t signals = awaited_signals();
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
}

Result<void> serve(const Settings& settings, Handler& handler, const SiteHolder& site, Keeper& keeper,
                   const std::function<void(const std::string&)>& on_listening) {
  auto address = resolve_address(settings.listen);
  if (!address) return tl::unexpected(address.error());
  if (auto free = check_free(*address, settings.listen); !free) return free;

  ConnectionTable connections(settings.max_connections, settings.max_connections_per_address);
  const unsigned cores = std::max(1u, std::thread::hardware_concurrency());
  const std::size_t n_workers = settings.threads > 0 ? static_cast<std::size_t>(settings.threads) : cores;
  std::vector<std::unique_ptr<Worker>> workers;
  for (std::size_t k = 0; k < n_workers; ++k) {
    workers.push_back(std::make_unique<Worker>(settings, handler, site, connections));
    if (auto bound = workers.back()->listen(*address); !bound) return bound;
    address->set_port(workers.back()->port());
  }
  const std::string host = settings.listen.substr(0, settings.listen.rfind(':'));
  on_listening(host + ":" + std::to_string(address->port()));
  std::vector<std::thread> threads;
  for (auto& worker : workers) threads.emplace_back([&worker = *worker] { worker.run(); });
  wait_for_signals(handler, keeper, workers);
  for (std::thread& thread : threads) thread.join();
  return {};
}

}  // namespace tind
