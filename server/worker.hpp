// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <chrono>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "config/settings.hpp"
#include "core/result.hpp"
#include "server/connection_table.hpp"
#include "server/handler.hpp"
#include "server/log.hpp"
#include "server/metrics.hpp"
#include "server/request_parser.hpp"
#include "server/session.hpp"
#include "server/timer_wheel.hpp"
#include "server/write_batch.hpp"

namespace tind {

/// One thread's event loop (epoll), listening sockets and connections. What does not say otherwise belongs to that
/// thread.
class Worker {
 public:
  /// The references must outlive the worker.
  Worker(const Settings& settings, RequestHandler& handler, const SiteHolder& site, ConnectionTable& connections);
  ~Worker();
  Worker(const Worker&) = delete;
  Worker& operator=(const Worker&) = delete;

  /// Binds with SO_REUSEPORT, so that the kernel spreads connections over the workers. Call before run(). kIo.
  Result<void> listen(const SocketAddress& address);
  /// Accepts from a socket that listens already; takes `fd` over.
  void listen_on(int fd);
  /// The port of the first listening socket.
  std::uint16_t port() const;
  /// Returns when drained.
  void run();
  /// Stops accepting, lets answers under way finish for settings.drain_timeout_s, then ends run(). Any thread.
  void drain();
  /// Ends run() soon, whatever is under way. Any thread.
  void stop();
  /// Whether run() has returned or is about to. Any thread.
  bool ended() const { return ended_; }

  // For sessions.
  const Settings& settings() const { return settings_; }
  RequestHandler& handler() { return handler_; }
  ConnectionTable& connections() { return connections_; }
  WorkerState& state() { return state_; }
  TimerWheel& timers() { return timers_; }
  Tick now() const { return now_; }
  bool draining() const { return draining_; }
  /// What is read goes here first. Room for a whole header, and more.
  std::span<char> input() { return input_; }
  FieldScratch& field_scratch() { return field_scratch_; }
  /// The answer being made, and those made but not sent. One session at a time has them, and leaves them empty.
  Response& response() { return response_; }
  WriteBatch& batch() { return batch_; }
  /// Counts the answer in response(), once it is in the batch with `n_bytes`, and writes it down where that is wanted.
  /// `request`: nullptr when what came on `fd` was none.
  void note_answer(const Request* request, int fd, std::size_t n_bytes);
  /// Counts how long the answers took that were noted since the last call.
  void note_sent();
  WorkerCounters& counters() { return counters_; }
  /// Writes answers down from now on; before run(). `log` must outlive the worker.
  void set_access_log(LineSink* log, LogFormat format) {
    access_log_ = log;
    access_format_ = format;
  }
  /// Server and Date, as header lines; at most a fraction of a second old.
  const std::string& common_fields() const { return common_fields_; }
  /// Calls session.resume() when others have had their turn.
  void later(Session& session) { later_.push_back(&session); }
  /// Calls it when the site has changed, or a slot of it, since the batch began.
  void park(Session& session);
  /// Frees a session that has closed, soon.
  void retire(Session& session);

  /// Ticks in so many seconds, rounded up: a deadline is never early.
  static constexpr Tick ticks(int seconds) { return Tick{seconds} * kTicksPerSecond + 1; }

 private:
  static constexpr Tick kTicksPerSecond = 4;

  class Listener;
  class Waker;

  void accept_from(int fd);
  void admit(int fd, const SocketAddress& peer);
  void watch(int fd, std::uint32_t events, EventTarget& target);
  void tick();
  void begin_drain();
  void refresh_date();
  template <class Work>
  void guarded(EventTarget& target, Work&& work);

  const Settings& settings_;
  RequestHandler& handler_;
  ConnectionTable& connections_;
  WorkerState state_;
  int epoll_ = -1;
  std::vector<std::unique_ptr<Listener>> listeners_;
  std::unique_ptr<Waker> waker_;  // for drain()
  std::chrono::steady_clock::time_point next_tick_;
  Tick now_ = 0;
  TimerWheel timers_{0};
  std::vector<std::unique_ptr<Session>> sessions_;
  std::vector<std::unique_ptr<Session>> retired_;  // until no event of this round can name them
  std::vector<Session*> later_, resumed_, parked_;
  std::uint64_t parked_at_ = 0;  // the version that the first of them has seen
  bool accepting_ = true;        // false for a while after accept() failed
  bool draining_ = false;
  std::atomic<bool> ended_ = false;
  Tick drain_deadline_ = 0;
  WorkerCounters counters_;
  std::uint64_t n_noted_ = 0;
  std::chrono::steady_clock::time_point mark_;  // the last turn, or the last answers sent in it
  LineSink* access_log_ = nullptr;
  LogFormat access_format_ = LogFormat::kText;
  std::vector<char> input_;
  FieldScratch field_scratch_;
  Response response_;
  WriteBatch batch_;
  std::string common_fields_;
  std::int64_t date_second_ = -1;
};

}  // namespace tind
