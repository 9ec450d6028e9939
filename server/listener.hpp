// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <boost/asio/basic_socket_acceptor.hpp>
#include <boost/asio/basic_waitable_timer.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <functional>
#include <string>
#include <unordered_set>

#include "config/settings.hpp"
#include "core/result.hpp"
#include "server/handler.hpp"
#include "server/session.hpp"
#include "server/write_batch.hpp"

namespace tind {

/// One thread's event loop, acceptor and connections. Everything but drain() belongs to that thread.
class Worker {
 public:
  using Acceptor = boost::asio::basic_socket_acceptor<boost::asio::ip::tcp, boost::asio::io_context::executor_type>;
  using Timer =
      boost::asio::basic_waitable_timer<Clock, boost::asio::wait_traits<Clock>, boost::asio::io_context::executor_type>;

  /// `n_connections` is shared by all workers. The references must outlive the worker.
  Worker(const Settings& settings, Handler& handler, const SiteHolder& site, std::atomic<int>& n_connections);
  ~Worker();

  /// Binds with SO_REUSEPORT, so that the kernel spreads connections over the workers. Call before run().
  Result<void> listen(const boost::asio::ip::tcp::endpoint& endpoint);
  /// The port bound, known after listen().
  std::uint16_t port() const;
  /// Returns when drained.
  void run();
  /// Stops accepting, lets answers under way finish for settings.drain_timeout_s, then ends run(). Any thread.
  void drain();

  void add(Session* session);
  void remove(Session* session);
  const Settings& settings() const { return settings_; }
  Handler& handler() { return handler_; }
  WorkerState& state() { return state_; }
  /// For the answer being made; used again for the next.
  Response& response() { return response_; }
  bool draining() const { return draining_; }
  /// Server and Date, as header lines; at most a fraction of a second old.
  const std::string& common_fields() const { return common_fields_; }
  WriteBatch& batch() { return batch_; }
  boost::asio::io_context& io() { return io_; }

 private:
  void accept();
  void admit(Socket socket);
  void tick();
  void begin_drain();
  void refresh_date();

  const Settings& settings_;
  Handler& handler_;
  WorkerState state_;
  Response response_;
  WriteBatch batch_;
  std::atomic<int>& n_connections_;
  boost::asio::io_context io_{1};  // one thread: no locks inside
  Acceptor acceptor_{io_};
  Timer tick_timer_{io_};
  std::unordered_set<Session*> sessions_;
  bool draining_ = false;
  Clock::time_point drain_deadline_;
  std::string common_fields_;
  std::int64_t date_second_ = -1;
};

/// Serves until SIGTERM or SIGINT, then drains. Calls `on_listening` with "HOST:PORT" once all workers listen.
/// kInvalidInput on a malformed address, kIo when it cannot be bound.
Result<void> serve(const Settings& settings, Handler& handler, const SiteHolder& site,
                   const std::function<void(const std::string&)>& on_listening);

}  // namespace tind
