// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/session.hpp"

#include <sys/epoll.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "server/worker.hpp"

namespace tind {
namespace {

constexpr std::uint64_t kMaxSkippedBody = 65536;
constexpr int kLingerTimeout_s = 2;
constexpr std::uint64_t kMaxLingerBytes = std::uint64_t{1} << 20;

bool would_block(int error) { return error == EAGAIN || error == EWOULDBLOCK; }

// The beginning of a request that can never become one, so that its sender need not wait for the deadline to hear it.
bool is_hopeless(std::string_view bytes) {
  if (bytes.find('\0') != bytes.npos || (!bytes.empty() && (bytes[0] < 'A' || bytes[0] > 'z') && bytes[0] != '\r')) {
    return true;
  }
  for (std::size_t at = bytes.find('\n'); at != bytes.npos; at = bytes.find('\n', at + 1)) {
    if (at == 0 || bytes[at - 1] != '\r') return true;
  }
  return false;
}

}  // namespace

Session::Session(int fd, const ClientKey& client, Worker& worker) : fd_(fd), worker_(worker), client_(client) {
  wait(State::kIdle, worker_.settings().idle_timeout_s);
}

void Session::on_events(std::uint32_t events) {
  if (state_ == State::kClosed) return;
  if ((events & ~static_cast<std::uint32_t>(EPOLLOUT)) != 0) readable_ = true;
  if ((events & (EPOLLRDHUP | EPOLLHUP)) != 0) peer_done_ = true;
  if (state_ == State::kSending) {
    if ((events & (EPOLLOUT | EPOLLERR | EPOLLHUP)) != 0) send_rest();
  } else if (readable_ && !parked_) {
    work();
  }
}

void Session::resume() {
  parked_ = false;
  if (state_ == State::kIdle || state_ == State::kReceiving) work();
}

// Reads what there is, answers all complete requests in it as far as one batch goes, and writes.
void Session::work() {
  if (state_ == State::kLingering) return discard();
  std::size_t n_bytes = 0;
  if (!receive(n_bytes)) return close();
  worker_.state().begin_batch();
  WriteBatch& batch = worker_.batch();
  std::string_view bytes(worker_.input().data(), n_bytes);
  while (batch.has_room() && !close_after_write_ && answer_next(bytes)) {
  }
  has_more_ = parked_ || (!batch.has_room() && !close_after_write_ && !bytes.empty());
  const bool answered = !batch.empty();
  if (bytes.empty() || close_after_write_) {
    if (buffer_.capacity() > 0) buffer_ = {};
  } else {
    buffer_.assign(bytes);
    // The deadline of a request runs from its first byte and is not put off by the next one.
    if (answered || state_ != State::kReceiving) wait(State::kReceiving, worker_.settings().request_timeout_s);
  }
  if (answered) return flush();
  if (parked_) return;
  if (at_end_) return close();
  if (body_bytes_to_skip_ > 0 && state_ != State::kReceiving) {
    wait(State::kReceiving, worker_.settings().request_timeout_s);
  }
  if (readable_) worker_.later(*this);
}

// Puts what was left and what came into the worker's buffer. False: the connection is broken, or at its end without
// anything to do.
bool Session::receive(std::size_t& n_bytes) {
  const std::span<char> input = worker_.input();
  n_bytes = std::min(buffer_.size(), input.size());
  if (n_bytes > 0) std::memcpy(input.data(), buffer_.data(), n_bytes);
  if (!readable_ || at_end_ || n_bytes == input.size()) return true;
  const ssize_t n = ::recv(fd_, input.data() + n_bytes, input.size() - n_bytes, 0);
  if (n < 0) {
    if (would_block(errno)) readable_ = false;
    return would_block(errno) || errno == EINTR;
  }
  at_end_ = n == 0;
  // A read that was not filled has emptied the socket; the next bytes are the next event.
  readable_ = static_cast<std::size_t>(n) == input.size() - n_bytes || (peer_done_ && !at_end_);
  n_bytes += static_cast<std::size_t>(n);
  return !at_end_ || n_bytes > 0;
}

// Takes one request from the front of `bytes`. False: not all of it is there, or the session was parked.
bool Session::answer_next(std::string_view& bytes) {
  const auto skipped = static_cast<std::size_t>(std::min<std::uint64_t>(body_bytes_to_skip_, bytes.size()));
  bytes.remove_prefix(skipped);
  body_bytes_to_skip_ -= skipped;
  if (body_bytes_to_skip_ > 0) return false;
  bytes.remove_prefix(leading_empty_lines(bytes));
  if (bytes.empty()) return false;
  const auto limit = static_cast<std::size_t>(worker_.settings().max_header_bytes);
  const std::size_t blank = bytes.find("\r\n\r\n");
  const bool complete = blank != bytes.npos;
  if (complete ? blank + 4 > limit : bytes.size() >= limit) {
    if (bytes.substr(0, limit).find('\n') == bytes.npos) {
      refuse(414, "the address is too long");
    } else {
      refuse(431, "the header is too large");
    }
    return true;
  }
  if (!complete) {
    if (!is_hopeless(bytes)) return false;
    refuse(400, "this is not HTTP");
    return true;
  }
  const std::string_view unread = bytes, block = bytes.substr(0, blank + 4);
  bytes.remove_prefix(block.size());
  const auto parsed = parse_request(block, worker_.field_scratch());
  if (const int* status = std::get_if<int>(&parsed)) {
    refuse(*status, "the request is malformed or not supported");
    return true;
  }
  const ParsedRequest& request = std::get<ParsedRequest>(parsed);
  worker_.handler().handle(request.request, worker_.state(), worker_.response());
  if (worker_.response().is_later) {
    bytes = unread;
    parked_ = true;
    worker_.park(*this);
    return false;
  }
  // No route wants a body. A small one is read past, else the connection ends with the answer.
  const bool skippable = !request.chunked && !request.expects_continue && request.content_length <= kMaxSkippedBody;
  if (!request.keep_alive || worker_.draining() || (!skippable && (request.chunked || request.content_length > 0))) {
    close_after_write_ = true;
  }
  const auto most = static_cast<std::uint32_t>(worker_.settings().max_requests_per_connection);
  if (++n_requests_ == most) close_after_write_ = true;
  body_bytes_to_skip_ = skippable ? request.content_length : 0;
  const std::size_t n_before = worker_.batch().n_bytes();
  worker_.batch().add(worker_.response(), worker_.common_fields(), !close_after_write_);
  worker_.note_answer(&request.request, fd_, worker_.batch().n_bytes() - n_before);
  return true;
}

void Session::refuse(int status, std::string_view why) {
  close_after_write_ = true;
  worker_.handler().refuse(status, why, worker_.response());
  const std::size_t n_before = worker_.batch().n_bytes();
  worker_.batch().add(worker_.response(), worker_.common_fields(), false);
  worker_.note_answer(nullptr, fd_, worker_.batch().n_bytes() - n_before);
}

// One write that does not block, then the batch ends: what is left is copied.
void Session::flush() {
  WriteBatch& batch = worker_.batch();
  const auto buffers = batch.buffers();
  msghdr message{};
  message.msg_iov = const_cast<iovec*>(buffers.data());
  message.msg_iovlen = buffers.size();
  const ssize_t n = ::sendmsg(fd_, &message, MSG_NOSIGNAL);
  const bool failed = n < 0 && !would_block(errno) && errno != EINTR;
  worker_.note_sent();
  const auto n_sent = static_cast<std::size_t>(std::max<ssize_t>(n, 0));
  if (!failed && n_sent < batch.n_bytes()) batch.copy_rest(n_sent, rest_);
  batch.clear();
  if (failed) return close();
  if (rest_.empty()) return after_write();
  wait(State::kSending, worker_.settings().request_timeout_s);
  n_progress_ = 0;
  send_rest();
}

// Until the socket takes no more: only then will it tell when it does again.
void Session::send_rest() {
  while (rest_at_ < rest_.size()) {
    const ssize_t n = ::send(fd_, rest_.data() + rest_at_, rest_.size() - rest_at_, MSG_NOSIGNAL);
    if (n < 0) {
      if (would_block(errno)) return;
      if (errno == EINTR) continue;
      return close();
    }
    rest_at_ += static_cast<std::size_t>(n);
    n_progress_ += static_cast<std::size_t>(n);
  }
  rest_ = {};
  rest_at_ = 0;
  after_write();
}

void Session::after_write() {
  if (close_after_write_) return linger();
  if (buffer_.empty() && body_bytes_to_skip_ == 0) {
    wait(State::kIdle, worker_.settings().idle_timeout_s);
  } else if (state_ != State::kReceiving) {
    wait(State::kReceiving, worker_.settings().request_timeout_s);
  }
  if (parked_) return;
  // Other connections first: this one must not keep the thread.
  if (has_more_ || readable_) return worker_.later(*this);
  if (at_end_) close();
}

// Closing with unread bytes makes the kernel reset the connection, and the client may lose the answer: so say that no
// more comes, and read a little of what the client still sends.
void Session::linger() {
  ::shutdown(fd_, SHUT_WR);
  if (at_end_) return close();
  wait(State::kLingering, kLingerTimeout_s);
  n_progress_ = 0;
  discard();
}

void Session::discard() {
  for (;;) {
    const std::span<char> input = worker_.input();
    const ssize_t n = ::recv(fd_, input.data(), input.size(), 0);
    if (n < 0 && would_block(errno)) return;
    if (n < 0 && errno == EINTR) continue;
    n_progress_ += static_cast<std::uint64_t>(std::max<ssize_t>(n, 0));
    if (n <= 0 || n_progress_ > kMaxLingerBytes) return close();
  }
}

void Session::close() {
  if (state_ == State::kClosed) return;
  state_ = State::kClosed;
  TimerWheel::cancel(*this);
  ::close(fd_);
  buffer_ = {};
  rest_ = {};
  worker_.connections().release(client_);
  worker_.retire(*this);
}

void Session::wait(State state, int timeout_s) {
  state_ = state;
  deadline_ = worker_.now() + Worker::ticks(timeout_s);
  // A deadline that is put off costs nothing until the timer goes off and is set again.
  if (timer_at_ != 0 && timer_at_ <= deadline_) return;
  timer_at_ = deadline_;
  worker_.timers().set(*this, deadline_);
}

void Session::on_timer(Tick now) {
  timer_at_ = 0;
  if (now < deadline_) {
    timer_at_ = deadline_;
    return worker_.timers().set(*this, deadline_);
  }
  const Settings& settings = worker_.settings();
  switch (state_) {
    case State::kReceiving:
      if (parked_) return wait(State::kReceiving, settings.request_timeout_s);  // the daemon is late, not the client
      worker_.connections().count(ConnectionEvent::kRequestTimeout);
      buffer_ = {};
      refuse(408, "the request took too long");
      return flush();
    case State::kSending:
      if (n_progress_ >= static_cast<std::uint64_t>(settings.min_send_rate_bytes_s) *
                             static_cast<std::uint64_t>(settings.request_timeout_s) &&
          n_progress_ > 0) {
        n_progress_ = 0;
        return wait(State::kSending, settings.request_timeout_s);
      }
      worker_.connections().count(ConnectionEvent::kSlowReader);
      {
        // Not even what the kernel has taken is worth keeping.
        const ::linger at_once{1, 0};
        ::setsockopt(fd_, SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
      }
      return close();
    case State::kIdle:
      worker_.connections().count(ConnectionEvent::kIdleTimeout);
      return close();
    default:
      return close();
  }
}

void Session::drain() {
  int n_unread = 0;
  if (state_ == State::kIdle && buffer_.empty() && ::ioctl(fd_, FIONREAD, &n_unread) == 0 && n_unread == 0) close();
}

}  // namespace tind
