// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/worker.hpp"

#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <exception>
#include <system_error>
#include <utility>

#include "server/access_log.hpp"
#include "server/http_date.hpp"
#include "server/listen_sockets.hpp"

namespace tind {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::size_t kInputBytes = 65536;  // beyond a whole header
constexpr int kEventsAtOnce = 256;
constexpr int kAcceptsAtOnce = 64;  // then connections have their turn
constexpr int kParkedLook_ms = 2;   // seldom, and not for long: nobody needs to wake this thread

// Out of memory or descriptors while the daemon starts: nothing can be done without.
int checked(int fd) {
  if (fd < 0) throw std::system_error(errno, std::generic_category());
  return fd;
}

}  // namespace

class Worker::Listener final : public EventTarget {
 public:
  Listener(Worker& worker, int fd) : worker_(worker), fd_(fd) {}
  ~Listener() override { stop(); }
  void on_events(std::uint32_t) override {
    if (fd_ >= 0) worker_.accept_from(fd_);
  }
  void stop() {
    if (fd_ >= 0) ::close(std::exchange(fd_, -1));
  }
  int fd() const { return fd_; }

 private:
  Worker& worker_;
  int fd_;
};

class Worker::Waker final : public EventTarget {
 public:
  explicit Waker(Worker& worker) : worker_(worker), fd_(checked(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC))) {}
  ~Waker() override { ::close(fd_); }
  void on_events(std::uint32_t) override { worker_.begin_drain(); }
  void wake() const {
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t n = ::write(fd_, &one, sizeof one);  // fails only when it would wake anyway
  }
  int fd() const { return fd_; }

 private:
  Worker& worker_;
  int fd_;
};

Worker::Worker(const Settings& settings, RequestHandler& handler, const SiteHolder& site, ConnectionTable& connections)
    : settings_(settings),
      handler_(handler),
      connections_(connections),
      state_(site),
      epoll_(checked(::epoll_create1(EPOLL_CLOEXEC))),
      waker_(std::make_unique<Waker>(*this)),
      next_tick_(Clock::now()),
      input_(static_cast<std::size_t>(settings.max_header_bytes) + kInputBytes) {
  watch(waker_->fd(), EPOLLIN | EPOLLET, *waker_);
  refresh_date();
}

Worker::~Worker() {
  while (!sessions_.empty()) sessions_.back()->close();
  ::close(epoll_);
}

Result<void> Worker::listen(const SocketAddress& address) {
  const auto fd = open_listening_socket(address);
  if (!fd) return tl::unexpected(fd.error());
  listen_on(*fd);
  return {};
}

void Worker::listen_on(int fd) {
  listeners_.push_back(std::make_unique<Listener>(*this, fd));
  watch(fd, EPOLLIN | EPOLLEXCLUSIVE, *listeners_.back());  // a shared socket need not wake all workers
}

std::uint16_t Worker::port() const {
  SocketAddress address;
  if (listeners_.empty() || ::getsockname(listeners_[0]->fd(), address.get(), &address.size) != 0) return 0;
  return address.port();
}

void Worker::watch(int fd, std::uint32_t events, EventTarget& target) {
  epoll_event event{};
  event.events = events;
  event.data.ptr = &target;
  checked(::epoll_ctl(epoll_, EPOLL_CTL_ADD, fd, &event));
}

// What goes wrong on one connection ends that connection, never the daemon.
template <class Work>
void Worker::guarded(EventTarget& target, Work&& work) {
  try {
    work();
  } catch (const std::exception& error) {
    log_error(std::string("a connection was ended: ") + error.what());
    batch_.clear();
    response_.reset();
    n_noted_ = 0;
    target.on_failure();
  }
}

void Worker::run() {
  std::array<epoll_event, kEventsAtOnce> events;
  while (!ended_) {
    const auto until_tick = std::chrono::duration_cast<std::chrono::milliseconds>(next_tick_ - Clock::now());
    auto timeout_ms = later_.empty() ? static_cast<int>(std::max<std::int64_t>(until_tick.count() + 1, 0)) : 0;
    if (!parked_.empty()) timeout_ms = std::min(timeout_ms, kParkedLook_ms);
    const int n = ::epoll_wait(epoll_, events.data(), kEventsAtOnce, timeout_ms);
    mark_ = Clock::now();
    for (int k = 0; k < n; ++k) {
      const epoll_event& event = events[static_cast<std::size_t>(k)];
      EventTarget& target = *static_cast<EventTarget*>(event.data.ptr);
      guarded(target, [&] { target.on_events(event.events); });
    }
    if (Clock::now() >= next_tick_) tick();
    resumed_.swap(later_);
    if (!parked_.empty() && state_.newest_version() != parked_at_) {
      resumed_.insert(resumed_.end(), parked_.begin(), parked_.end());
      parked_.clear();
    }
    for (Session* session : resumed_) session->resume();
    resumed_.clear();
    retired_.clear();
    if (draining_ && (sessions_.empty() || now_ >= drain_deadline_)) ended_ = true;
  }
}

void Worker::accept_from(int fd) {
  for (int k = 0; k < kAcceptsAtOnce; ++k) {
    SocketAddress peer;
    const int connection = ::accept4(fd, peer.get(), &peer.size, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (connection >= 0) {
      admit(connection, peer);
      continue;
    }
    if (errno == EINTR || errno == ECONNABORTED) continue;
    if (errno == EMFILE || errno == ENFILE || errno == ENOBUFS || errno == ENOMEM) {
      // The socket stays readable, so do not look at it until some connection may have ended.
      for (const auto& listener : listeners_) ::epoll_ctl(epoll_, EPOLL_CTL_DEL, listener->fd(), nullptr);
      accepting_ = false;
    }
    return;
  }
}

void Worker::admit(int fd, const SocketAddress& peer) {
  const ClientKey client = settings_.max_connections_per_address > 0 ? client_key(peer) : ClientKey{};
  if (connections_.admit(client) != ConnectionEvent::kAccepted) {
    handler_.refuse(503, "too many connections", response_);
    response_.fields += "Retry-After: 1\r\n";
    batch_.add(response_, common_fields_, false);
    const auto buffers = batch_.buffers();
    msghdr message{};
    message.msg_iov = const_cast<iovec*>(buffers.data());
    message.msg_iovlen = buffers.size();
    ::sendmsg(fd, &message, MSG_NOSIGNAL);
    batch_.clear();
    ::shutdown(fd, SHUT_WR);
    ::close(fd);
    return;
  }
  auto session = std::make_unique<Session>(fd, client, *this);
  session->index = sessions_.size();
  sessions_.push_back(std::move(session));
  watch(fd, EPOLLIN | EPOLLOUT | EPOLLRDHUP | EPOLLET, *sessions_.back());
}

void Worker::park(Session& session) {
  if (parked_.empty()) parked_at_ = state_.version();
  parked_.push_back(&session);
}

void Worker::retire(Session& session) {
  std::erase(parked_, &session);
  std::unique_ptr<Session>& place = sessions_[session.index];
  retired_.push_back(std::move(place));
  if (session.index + 1 < sessions_.size()) {
    place = std::move(sessions_.back());
    place->index = session.index;
  }
  sessions_.pop_back();
}

// A coarse clock for all connections instead of a timer each.
void Worker::tick() {
  constexpr auto kStep = std::chrono::duration_cast<Clock::duration>(std::chrono::seconds(1)) / kTicksPerSecond;
  const auto n_missed = (Clock::now() - next_tick_) / kStep;
  next_tick_ += (n_missed + 1) * kStep;
  now_ += n_missed + 1;
  refresh_date();
  state_.set_time(static_cast<std::int64_t>(now_ / kTicksPerSecond));
  state_.hand_over_counts();
  state_.begin_batch();  // an idle thread lets go of what was swapped out, too
  counters_.n_open_transactions.store(state_.n_open_transactions(), std::memory_order_relaxed);
  counters_.n_turns.store(static_cast<std::uint64_t>(now_), std::memory_order_relaxed);
  timers_.advance(now_, [&](TimerEntry& entry) {
    auto& session = static_cast<Session&>(entry);
    guarded(session, [&] { session.on_timer(now_); });
  });
  if (!accepting_ && !draining_) {
    accepting_ = true;
    for (const auto& listener : listeners_) watch(listener->fd(), EPOLLIN | EPOLLEXCLUSIVE, *listener);
  }
}

void Worker::note_answer(const Request* request, int fd, std::size_t n_bytes) {
  ++n_noted_;
  counters_.count(response_, n_bytes);
  if (!access_log_) return;
  SocketAddress peer;
  const bool known = ::getpeername(fd, peer.get(), &peer.size) == 0 && peer.family() != AF_UNIX;
  const std::string address = known ? peer.host() : "unix";
  const double seconds = std::chrono::duration<double>(Clock::now() - mark_).count();
  access_log_->write(format_access_line({address, request, response_.status, n_bytes, seconds}, access_format_));
}

void Worker::note_sent() {
  const auto now = Clock::now();
  counters_.observe(now - mark_, n_noted_);
  n_noted_ = 0;
  mark_ = now;
}

void Worker::refresh_date() {
  const std::time_t now = std::time(nullptr);
  if (now == date_second_) return;
  date_second_ = now;
  common_fields_ = "Server: tind\r\nDate: " + format_http_date(now) + "\r\n";
}

void Worker::drain() { waker_->wake(); }

void Worker::stop() {
  ended_ = true;
  waker_->wake();
}

void Worker::begin_drain() {
  if (draining_) return;
  // Connections that the kernel has accepted for us are clients who believe they are served.
  for (const auto& listener : listeners_) {
    for (std::size_t before = sessions_.size() + 1; before != sessions_.size();) {
      before = sessions_.size();
      accept_from(listener->fd());
    }
  }
  for (const auto& listener : listeners_) listener->stop();  // an event of this round may still name it
  draining_ = true;
  drain_deadline_ = now_ + ticks(settings_.drain_timeout_s);
  for (std::size_t k = sessions_.size(); k > 0; --k) sessions_[k - 1]->drain();
}

}  // namespace tind
