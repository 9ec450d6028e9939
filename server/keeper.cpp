// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/keeper.hpp"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <ctime>
#include <exception>
#include <utility>

#include "server/log.hpp"
#include "server/service_manager.hpp"

namespace tind {
namespace {

// Somebody who replaces files does it in several steps: wait until it is quiet, but not for ever.
constexpr auto kQuiet = std::chrono::milliseconds(50);
constexpr auto kLongestUnrest = std::chrono::seconds(1);
constexpr auto kSettle = std::chrono::milliseconds(250);
constexpr auto kNever = std::chrono::hours(24);

std::string monotonic_us() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return std::to_string(std::int64_t{now.tv_sec} * 1'000'000 + now.tv_nsec / 1000);
}

// Names of settings that differ and are only read at the start.
std::vector<std::string> fixed_differences(const Settings& now, const Settings& wanted) {
  std::vector<std::string> names;
  for (const OptionSpec& option : option_table()) {
    if (std::string_view(option.name) == "log_level") continue;
    const bool same = std::visit([&](const auto member) { return now.*member == wanted.*member; }, option.member);
    if (!same) names.emplace_back(option.name);
  }
  return names;
}

}  // namespace

Keeper::Keeper(Catalog& catalog, Settings settings, Hooks hooks)
    : catalog_(catalog),
      settings_(std::move(settings)),
      hooks_(std::move(hooks)),
      wake_fd_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
  catalog_.limit()->on_excess = [this] {
    excess_ = true;
    wake();
  };
  catalog_.limit()->on_wanted = [this] {
    look_wanted_ = true;
    wake();
  };
  if (settings_.watch == "auto") {
    folders_ = FolderWatch::make();
    if (!folders_) log_warning("inotify cannot be had: files are looked at now and then only");
  }
  watch();
  const auto now = Clock::now();
  poll_at_ = now + std::chrono::seconds(settings_.poll_interval_s);
  notify_at_ = now;
  thread_ = std::thread([this] { run(); });
}

Keeper::~Keeper() {
  stopping_ = true;
  wake();
  thread_.join();
  catalog_.limit()->on_excess = nullptr;
  catalog_.limit()->on_wanted = nullptr;
  ::close(wake_fd_);
}

void Keeper::wake() {
  const std::uint64_t one = 1;
  (void)!::write(wake_fd_, &one, sizeof one);  // fails when it is full: then it wakes anyway
}

void Keeper::request_reload() {
  reload_wanted_ = true;
  wake();
}

std::optional<ReloadReport> Keeper::reload(std::chrono::milliseconds patience) {
  auto promise = std::make_shared<std::promise<ReloadReport>>();
  auto report = promise->get_future();
  {
    const std::lock_guard lock(mutex_);
    waiting_.push_back(promise);
  }
  request_reload();
  if (report.wait_for(patience) != std::future_status::ready) return std::nullopt;
  return report.get();
}

void Keeper::set_alive_check(std::function<bool()> is_alive) {
  const std::lock_guard lock(mutex_);
  is_alive_ = std::move(is_alive);
}

void Keeper::watch() {
  if (folders_) folders_->set(watched_directories(catalog_.specs()));
}

void Keeper::wait_until(Clock::time_point deadline) {
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - Clock::now());
  std::array<pollfd, 2> waiting = {{{wake_fd_, POLLIN, 0}, {folders_ ? folders_->fd() : -1, POLLIN, 0}}};
  ::poll(waiting.data(), waiting.size(), static_cast<int>(std::max<std::int64_t>(0, left.count())));
  std::uint64_t ignored = 0;
  (void)!::read(wake_fd_, &ignored, sizeof ignored);
}

void Keeper::run() {
  while (!stopping_) {
    try {
      work();
    } catch (const std::exception& error) {
      // Out of memory, most likely. What is served stays; look again soon.
      log_error(std::string("the files cannot be looked at: ") + error.what());
      look_at_ = Clock::now() + kSettle;
      wait_until(*look_at_);
    }
  }
}

void Keeper::work() {
  const bool polls = settings_.watch != "off";
  const auto notify_every = watchdog_interval();
  while (!stopping_) {
    if (reload_wanted_.exchange(false)) {
      std::vector<std::shared_ptr<std::promise<ReloadReport>>> waiting;
      {
        const std::lock_guard lock(mutex_);
        waiting.swap(waiting_);
      }
      const ReloadReport report = do_reload();
      for (const auto& promise : waiting) promise->set_value(report);
    }
    if (look_wanted_.exchange(false)) catalog_.look_at_wanted();
    if (excess_.exchange(false)) catalog_.close_excess();
    auto now = Clock::now();
    if (folders_ && folders_->drain()) {
      if (!look_at_) first_event_ = now;
      look_at_ = std::min(now + kQuiet, first_event_ + kLongestUnrest);
    }
    if ((look_at_ && now >= *look_at_) || (polls && now >= poll_at_)) look();
    now = Clock::now();
    if (notify_every && now >= notify_at_) {
      const std::lock_guard lock(mutex_);
      if (!is_alive_ || is_alive_()) notify_service_manager("WATCHDOG=1");
      notify_at_ = now + *notify_every;
    }
    if (!look_at_ && catalog_.read_ahead()) {
      if (!folders_ || !folders_->drain()) continue;
      first_event_ = now;
      look_at_ = now + kQuiet;
    }
    Clock::time_point next = now + kNever;
    if (polls) next = std::min(next, poll_at_);
    if (look_at_) next = std::min(next, *look_at_);
    if (notify_every) next = std::min(next, notify_at_);
    wait_until(next);
  }
}

void Keeper::look() {
  look_at_.reset();
  const CatalogChange change = catalog_.refresh(false);
  count(change);
  watch();
  const auto now = Clock::now();
  poll_at_ = now + std::chrono::seconds(settings_.poll_interval_s);
  if (change.unsettled) {
    first_event_ = now;
    look_at_ = now + kSettle;
  }
}

void Keeper::count(const CatalogChange& change) {
  n_dataset_changes_ += change.added.size() + change.replaced.size() + change.removed.size();
  n_dataset_failures_ += change.failed.size();
}

ReloadReport Keeper::do_reload() {
  notify_service_manager("RELOADING=1\nMONOTONIC_USEC=" + monotonic_us());
  ReloadReport report;
  const Result<Settings> wanted = hooks_.reread ? hooks_.reread() : Result<Settings>(settings_);
  if (wanted) {
    report.restart_needed = fixed_differences(settings_, *wanted);
    set_log_level(log_level_of(wanted->log_level));
    report.datasets = catalog_.refresh(wanted->datasets);
  } else {
    report.settings_error = wanted.error().message;
    log_error("reload: " + report.settings_error + "; the settings stay as they are");
    report.datasets = catalog_.refresh(true);
  }
  for (const std::string& name : report.restart_needed) {
    log_warning("reload: \"" + name + "\" has changed; it counts from the next start on");
  }
  count(report.datasets);
  watch();
  look_at_.reset();
  if (hooks_.on_reload) hooks_.on_reload();
  ++(report.ok() ? n_reloads_ok_ : n_reloads_failed_);
  log_info(report.ok() ? "reloaded" : "reloaded, with failures");
  notify_service_manager("READY=1");
  return report;
}

}  // namespace tind
