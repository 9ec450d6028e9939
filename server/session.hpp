// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <boost/asio/basic_stream_socket.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <chrono>
#include <memory>
#include <string>
#include <string_view>

#include "config/settings.hpp"
#include "server/handler.hpp"
#include "server/request_parser.hpp"

namespace tind {

class Worker;

/// A socket whose executor is known at compile time: no virtual call per operation.
using Socket = boost::asio::basic_stream_socket<boost::asio::ip::tcp, boost::asio::io_context::executor_type>;
using Clock = std::chrono::steady_clock;

/// One connection: reads into its own buffer, answers every complete request in it with one gathered write that does
/// not block, and copies what the socket did not take, so that a slow client holds neither a dataset nor a cached
/// answer. Belongs to the thread of its worker.
class Session : public std::enable_shared_from_this<Session> {
 public:
  Session(Socket socket, Worker& worker);
  ~Session();
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  void start();
  /// Called a few times a second: ends what is late.
  void check_deadline(Clock::time_point now);
  /// No further request after the one under way; closes at once when there is none.
  void drain();

 private:
  enum class State { kIdle, kReceiving, kSending, kLingering };

  void read();
  void on_read(std::size_t n_bytes);
  void process();
  bool answer_next();
  void append_response();
  void fail_request(int status, const char* why);
  void flush();
  void write_rest();
  void after_write();
  void linger();
  void close();
  void set_deadline(int seconds) { deadline_ = Clock::now() + std::chrono::seconds(seconds); }
  std::string_view unread() const { return std::string_view(buffer_).substr(begin_, end_ - begin_); }

  Socket socket_;
  Worker& worker_;
  State state_ = State::kIdle;
  Clock::time_point deadline_;
  std::string buffer_;  // bytes [begin_, end_) are not used up yet
  std::size_t begin_ = 0, end_ = 0;
  std::uint64_t body_bytes_to_skip_ = 0;  // of a request body that nobody wants
  bool close_after_write_ = false;
  std::size_t lingered_bytes_ = 0;

  std::string rest_;  // of the answers: what the socket did not take at once, from rest_at_ on
  std::size_t rest_at_ = 0;
};

}  // namespace tind
