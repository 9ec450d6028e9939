// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "config/settings.hpp"
#include "server/catalog.hpp"
#include "server/folder_watch.hpp"

namespace tind {

/// What a reload did.
struct ReloadReport {
  CatalogChange datasets;
  std::string settings_error;               ///< The configuration cannot be read: all settings stay. Empty: it can.
  std::vector<std::string> restart_needed;  ///< Settings that differ and count from the next start on only.
  bool ok() const { return settings_error.empty() && datasets.failed.empty(); }
};

/// The thread beside the event loops: it watches the files of a catalog and swaps its site, reloads on demand, closes
/// what is open too long, and tells the service manager that all is well.
class Keeper {
 public:
  /// Reads the settings again, as at the start.
  using Reread = std::function<Result<Settings>()>;
  /// Called by the thread.
  struct Hooks {
    Reread reread;
    std::function<void()> on_reload;  ///< After each: for logs to be opened again.
  };

  /// Takes the catalog over: nobody else may use it but for its holder(), while the keeper lives.
  Keeper(Catalog& catalog, Settings settings, Hooks hooks);
  ~Keeper();
  Keeper(const Keeper&) = delete;
  Keeper& operator=(const Keeper&) = delete;

  /// Asks for a reload and returns at once (SIGHUP). Thread safe.
  void request_reload();
  /// Reloads and waits for it. nullopt: it takes longer than `patience`, and goes on. Thread safe.
  std::optional<ReloadReport> reload(std::chrono::milliseconds patience);

  /// What says whether the event loops turn: the service manager's watchdog hears of the daemon only while they do.
  /// Called by the thread; not after it was replaced. Thread safe.
  void set_alive_check(std::function<bool()> is_alive);

  std::uint64_t n_reloads_ok() const { return n_reloads_ok_; }
  std::uint64_t n_reloads_failed() const { return n_reloads_failed_; }
  /// Datasets added, replaced or removed, by watching or by reloads.
  std::uint64_t n_dataset_changes() const { return n_dataset_changes_; }
  /// New or replaced files, and settings about them, that were refused.
  std::uint64_t n_dataset_failures() const { return n_dataset_failures_; }

 private:
  using Clock = std::chrono::steady_clock;
  void run();
  void work();
  void wake();
  void wait_until(Clock::time_point deadline);
  void look();
  void count(const CatalogChange& change);
  ReloadReport do_reload();
  void watch();

  Catalog& catalog_;
  Settings settings_;
  const Hooks hooks_;
  std::unique_ptr<FolderWatch> folders_;
  int wake_fd_;
  std::optional<Clock::time_point> look_at_;  // something happened
  Clock::time_point first_event_, poll_at_, notify_at_;
  std::atomic<bool> stopping_ = false, excess_ = false, look_wanted_ = false, reload_wanted_ = false;
  std::mutex mutex_;
  std::vector<std::shared_ptr<std::promise<ReloadReport>>> waiting_;
  std::function<bool()> is_alive_;
  std::atomic<std::uint64_t> n_reloads_ok_ = 0, n_reloads_failed_ = 0, n_dataset_changes_ = 0, n_dataset_failures_ = 0;
  std::thread thread_;
};

}  // namespace tind
