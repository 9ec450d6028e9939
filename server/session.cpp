// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/session.hpp"

#include <sys/socket.h>

#include <algorithm>
#include <boost/asio/buffer.hpp>
#include <boost/asio/post.hpp>
#include <cerrno>

#include "server/listener.hpp"

namespace tind {
namespace {

namespace asio = boost::asio;
using boost::system::error_code;

constexpr std::size_t kFirstBufferBytes = 2048;  // grows to the header limit for those who need it
constexpr std::uint64_t kMaxSkippedBody = 65536;
constexpr int kLingerTimeout_s = 2;
constexpr std::size_t kMaxLingerBytes = std::size_t{1} << 20;

}  // namespace

Session::Session(Socket socket, Worker& worker) : socket_(std::move(socket)), worker_(worker) { worker_.add(this); }

Session::~Session() { worker_.remove(this); }

void Session::start() {
  error_code ignored;
  socket_.non_blocking(true, ignored);
  socket_.set_option(asio::ip::tcp::no_delay(true), ignored);
  read();
}

void Session::read() {
  // Only moved when nothing of it is referred to: answers own their bytes.
  buffer_.erase(0, begin_);
  end_ -= begin_;
  begin_ = 0;
  if (end_ == buffer_.size()) {
    const auto limit = static_cast<std::size_t>(worker_.settings().max_header_bytes);
    buffer_.resize(std::min(limit, std::max(kFirstBufferBytes, 2 * buffer_.size())));
  }
  const bool idle = end_ == 0 && body_bytes_to_skip_ == 0;
  if (idle || state_ != State::kReceiving) {
    // The deadline of a request runs from its first byte and is not put off by the next one.
    state_ = idle ? State::kIdle : State::kReceiving;
    set_deadline(idle ? worker_.settings().idle_timeout_s : worker_.settings().request_timeout_s);
  }
  socket_.async_read_some(asio::buffer(buffer_.data() + end_, buffer_.size() - end_),
                          [self = shared_from_this()](error_code error, std::size_t n) {
                            if (error) return self->close();
                            self->on_read(n);
                          });
}

void Session::on_read(std::size_t n_bytes) {
  end_ += n_bytes;
  process();
}

// Answers all complete requests in the buffer, as far as one batch goes.
void Session::process() {
  worker_.state().begin_batch();
  WriteBatch& batch = worker_.batch();
  while (batch.has_room() && !close_after_write_ && answer_next()) {
  }
  if (batch.empty()) {
    read();
  } else {
    flush();
  }
}

// Takes one request from the buffer. False: not all of it is there.
bool Session::answer_next() {
  const std::size_t skipped = static_cast<std::size_t>(std::min<std::uint64_t>(body_bytes_to_skip_, end_ - begin_));
  begin_ += skipped;
  body_bytes_to_skip_ -= skipped;
  if (body_bytes_to_skip_ > 0) return false;
  begin_ += leading_empty_lines(unread());
  const std::string_view bytes = unread();
  const std::size_t blank = bytes.find("\r\n\r\n");
  if (blank == bytes.npos) {
    if (bytes.size() < static_cast<std::size_t>(worker_.settings().max_header_bytes)) return false;
    if (bytes.find('\n') == bytes.npos) {
      fail_request(414, "the address is too long");
    } else {
      fail_request(431, "the header is too large");
    }
    return true;
  }
  const std::string_view block = bytes.substr(0, blank + 4);
  auto parsed = parse_request(block);
  begin_ += block.size();
  if (const int* status = std::get_if<int>(&parsed)) {
    fail_request(*status, "the request is malformed or not supported");
    return true;
  }
  const ParsedRequest& request = std::get<ParsedRequest>(parsed);
  // No route wants a body. A small one is read past, else the connection ends with the answer.
  const bool skippable = !request.chunked && !request.expects_continue && request.content_length <= kMaxSkippedBody;
  if (!request.keep_alive || worker_.draining() || (!skippable && (request.chunked || request.content_length > 0))) {
    close_after_write_ = true;
  }
  body_bytes_to_skip_ = skippable ? request.content_length : 0;
  worker_.handler().handle(request.view(), worker_.state(), worker_.response());
  append_response();
  return true;
}

void Session::fail_request(int status, const char* why) {
  close_after_write_ = true;
  text_response(worker_.response(), status, why);
  append_response();
}

void Session::append_response() {
  worker_.batch().add(worker_.response(), worker_.common_fields(), !close_after_write_);
}

// One write that does not block, then the batch ends: what is left is copied.
void Session::flush() {
  WriteBatch& batch = worker_.batch();
  const auto buffers = batch.buffers();
  msghdr message{};
  message.msg_iov = const_cast<iovec*>(buffers.data());
  message.msg_iovlen = buffers.size();
  const ssize_t n = ::sendmsg(socket_.native_handle(), &message, MSG_NOSIGNAL);
  const bool failed = n < 0 && errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR;
  const auto n_sent = static_cast<std::size_t>(std::max<ssize_t>(n, 0));
  if (!failed && n_sent < batch.n_bytes()) batch.copy_rest(n_sent, rest_);
  batch.clear();
  if (failed) {
    close();
  } else if (rest_.empty()) {
    after_write();
  } else {
    write_rest();
  }
}

void Session::write_rest() {
  state_ = State::kSending;
  set_deadline(worker_.settings().request_timeout_s);  // for some progress, not for all of it
  socket_.async_write_some(asio::buffer(rest_.data() + rest_at_, rest_.size() - rest_at_),
                           [self = shared_from_this()](error_code error, std::size_t n) {
                             if (error) return self->close();
                             self->rest_at_ += n;
                             if (self->rest_at_ < self->rest_.size()) return self->write_rest();
                             self->rest_ = {};
                             self->rest_at_ = 0;
                             self->after_write();
                           });
}

void Session::after_write() {
  if (close_after_write_) return linger();
  state_ = State::kIdle;  // the next request's deadline begins anew
  if (begin_ == end_) return read();
  // Pipelined requests wait in the buffer. Other connections first: this one must not keep the thread.
  asio::post(socket_.get_executor(), [self = shared_from_this()] {
    if (self->socket_.is_open()) self->process();
  });
}

// Closing with unread bytes makes the kernel reset the connection, and the client may lose the answer: so say that no
// more comes, and read a little of what the client still sends.
void Session::linger() {
  if (state_ != State::kLingering) {
    state_ = State::kLingering;
    set_deadline(kLingerTimeout_s);
    error_code ignored;
    socket_.shutdown(Socket::shutdown_send, ignored);
    buffer_.resize(std::max(buffer_.size(), kFirstBufferBytes));
  }
  socket_.async_read_some(asio::buffer(buffer_), [self = shared_from_this()](error_code error, std::size_t n) {
    self->lingered_bytes_ += n;
    if (error || self->lingered_bytes_ > kMaxLingerBytes) return self->close();
    self->linger();
  });
}

void Session::close() {
  error_code ignored;
  socket_.close(ignored);
}

void Session::check_deadline(Clock::time_point now) {
  if (now < deadline_ || !socket_.is_open()) return;
  if (state_ == State::kReceiving) {
    fail_request(408, "the request took too long");
    WriteBatch& batch = worker_.batch();
    batch.copy_rest(0, rest_);
    batch.clear();
    error_code ignored;
    socket_.write_some(asio::buffer(rest_), ignored);
    socket_.shutdown(Socket::shutdown_send, ignored);
  }
  close();  // the read or write under way ends with an error and lets go of this session
}

void Session::drain() {
  error_code error;
  const bool idle = state_ == State::kIdle && begin_ == end_ && socket_.available(error) == 0;
  if (idle || error) close();
}

}  // namespace tind
