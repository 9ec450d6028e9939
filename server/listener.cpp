// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/listener.hpp"

#include <signal.h>
#include <sys/resource.h>

#include <algorithm>
#include <cstdint>
#include <ctime>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "server/admin_handler.hpp"
#include "server/listen_sockets.hpp"
#include "server/service_manager.hpp"
#include "server/worker.hpp"

namespace tind {
namespace {

constexpr const char* kAdminSocket = "admin";  // FileDescriptorName=
constexpr int kAdminConnections = 100;

// The soft limit is low for the sake of programs that use select(); this one does not.
void raise_descriptor_limit() {
  rlimit limit{};
  if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
  limit.rlim_cur = limit.rlim_max;
  ::setrlimit(RLIMIT_NOFILE, &limit);
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

Result<void> serve(ServeParts parts, const std::function<void(const std::vector<std::string>&)>& on_listening) {
  const Settings& settings = parts.settings;
  raise_descriptor_limit();
  std::vector<int> public_fds, admin_fds;
  for (const PassedSocket& socket : parts.sockets) {
    (socket.name == kAdminSocket ? admin_fds : public_fds).push_back(socket.fd);
  }
  const unsigned cores = std::max(1u, std::thread::hardware_concurrency());
  const std::size_t n_workers = settings.threads > 0 ? static_cast<std::size_t>(settings.threads) : cores;
  auto sockets = ListenSockets::open(settings.listen, public_fds, n_workers);
  if (!sockets) return tl::unexpected(sockets.error());

  ConnectionTable connections(settings.max_connections, settings.max_connections_per_address);
  MetricsSources sources;
  sources.started_s = std::time(nullptr);
  std::vector<std::unique_ptr<Worker>> workers;
  for (std::size_t k = 0; k < n_workers; ++k) {
    workers.push_back(std::make_unique<Worker>(settings, parts.handler, parts.site, connections));
    for (const int fd : sockets->take(k)) workers.back()->listen_on(fd);
    if (parts.access_log) workers.back()->set_access_log(parts.access_log, log_format_of(settings.log_format));
    sources.workers.push_back(&workers.back()->counters());
  }
  parts.keeper.set_alive_check([loops = sources.workers, before = std::vector<std::uint64_t>(n_workers)]() mutable {
    bool all = true;
    for (std::size_t k = 0; k < loops.size(); ++k) {
      const std::uint64_t now = loops[k]->n_turns.load(std::memory_order_relaxed);
      all = all && (now != before[k] || now == 0);
      before[k] = now;
    }
    return all;
  });

  // The operator's listener has a loop of its own, which may wait for a reload.
  sources.connections = &connections;
  sources.cache = &parts.handler.cache();
  sources.site = &parts.site;
  sources.keeper = &parts.keeper;
  if (parts.access_log) sources.access_lines_dropped = [log = parts.access_log] { return log->n_dropped(); };
  AdminHandler admin_handler(sources, parts.keeper);
  ConnectionTable admin_connections(kAdminConnections, 0);
  std::optional<ListenSockets> admin_sockets;
  std::unique_ptr<Worker> admin;
  if (!settings.admin_listen.empty() || !admin_fds.empty()) {
    auto opened = ListenSockets::open(settings.admin_listen, admin_fds, 1);
    if (!opened) return tl::unexpected(opened.error());
    admin_sockets.emplace(std::move(*opened));
    admin = std::make_unique<Worker>(settings, admin_handler, parts.site, admin_connections);
    for (const int fd : admin_sockets->take(0)) admin->listen_on(fd);
    for (const std::string& where : admin_sockets->where()) log_info("admin listener on " + where);
  }

  on_listening(sockets->where());
  std::vector<std::thread> threads;
  for (auto& worker : workers) threads.emplace_back([&worker = *worker] { worker.run(); });
  std::thread admin_thread;
  if (admin) admin_thread = std::thread([&] { admin->run(); });
  wait_for_signals(parts.handler, parts.keeper, workers);
  for (std::thread& thread : threads) thread.join();
  if (admin) {
    admin->stop();
    admin_thread.join();
  }
  parts.keeper.set_alive_check({});
  return {};
}

}  // namespace tind
