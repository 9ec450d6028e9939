// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "server/connection_table.hpp"
#include "server/timer_wheel.hpp"

namespace tind {

class Worker;

/// Something that epoll reports on.
class EventTarget {
 public:
  virtual ~EventTarget() = default;
  /// `events`: EPOLLIN and so on.
  virtual void on_events(std::uint32_t events) = 0;
  /// on_events() threw: memory ran out, or a mistake of ours. Others must not suffer from it.
  virtual void on_failure() {}
};

/// One connection: reads into its worker's buffer, answers every complete request in it with one gathered write that
/// does not block, and copies what the socket did not take, so that a slow client holds neither a dataset nor a cached
/// answer. While it waits for a request it has no buffer of its own. Watched edge-triggered; belongs to the thread of
/// its worker.
class Session final : public EventTarget, public TimerEntry {
 public:
  /// Takes over `fd`, which does not block, and the place that `client` has in the connection table.
  Session(int fd, const ClientKey& client, Worker& worker);
  /// Must have been closed.
  ~Session() override = default;
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  void on_events(std::uint32_t events) override;
  void on_failure() override { close(); }
  /// Goes on with requests that were left for later, so that others had their turn.
  void resume();
  /// The timer that the session set went off.
  void on_timer(Tick now);
  /// No further request after the one under way; closes at once when there is none.
  void drain();
  /// Ends at once.
  void close();

  int fd() const { return fd_; }
  std::size_t index = 0;  ///< The worker's: where it keeps the session.

 private:
  enum class State : std::uint8_t { kIdle, kReceiving, kSending, kLingering, kClosed };

  void work();
  bool receive(std::size_t& n_bytes);
  bool answer_next(std::string_view& bytes);
  void refuse(int status, std::string_view why);
  void flush();
  void send_rest();
  void after_write();
  void linger();
  void discard();
  void wait(State state, int timeout_s);

  int fd_;
  State state_ = State::kIdle;
  bool readable_ = false;   // there may be bytes to read
  bool peer_done_ = false;  // the client sends no more; still to be read to the end
  bool at_end_ = false;     // ... and it was
  bool has_more_ = false;   // complete requests were left for later
  bool parked_ = false;     // ... until the worker resumes it
  bool close_after_write_ = false;
  std::uint32_t n_requests_ = 0;
  Worker& worker_;
  const ClientKey client_;
  Tick deadline_ = 0, timer_at_ = 0;      // timer_at_: where the wheel has it; never later than the deadline
  std::uint64_t body_bytes_to_skip_ = 0;  // of a request body that nobody wants
  std::uint64_t n_progress_ = 0;          // bytes sent since the deadline was set, or discarded while lingering
  std::string buffer_;                    // the beginning of a request
  std::string rest_;                      // of the answers: what the socket did not take at once, from rest_at_ on
  std::size_t rest_at_ = 0;
};

}  // namespace tind
