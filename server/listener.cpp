// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/listener.hpp"

#include <sys/socket.h>

#include <boost/asio/post.hpp>
#include <boost/asio/signal_set.hpp>
#include <charconv>
#include <csignal>
#include <ctime>
#include <memory>
#include <thread>
#include <vector>

namespace tind {
namespace {

namespace asio = boost::asio;
using asio::ip::tcp;
using boost::system::error_code;
using ReusePort = asio::detail::socket_option::boolean<SOL_SOCKET, SO_REUSEPORT>;

constexpr auto kTick = std::chrono::milliseconds(250);
constexpr auto kAcceptPause = std::chrono::milliseconds(100);

tl::unexpected<Error> cannot_listen(const std::string& where, const error_code& error) {
  const char* hint =
      error == asio::error::address_in_use ? "; stop the other program or give another --listen HOST:PORT" : "";
  return fail(ErrorKind::kIo, "cannot listen on " + where + ": " + error.message() + hint);
}

// "HOST:PORT" or "[V6]:PORT"; the host is an address or a name.
Result<tcp::endpoint> resolve(const std::string& listen, asio::io_context& io) {
  const auto malformed = [&] { return fail(ErrorKind::kInvalidInput, "--listen " + listen + ": not HOST:PORT"); };
  const auto colon = listen.rfind(':');
  if (colon == listen.npos || colon == 0) return malformed();
  std::string host = listen.substr(0, colon);
  if (host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
  std::uint16_t port = 0;
  const char* const last = listen.data() + listen.size();
  const auto [end, parse_error] = std::from_chars(listen.data() + colon + 1, last, port);
  if (parse_error != std::errc() || end != last) return malformed();
  error_code error;
  tcp::resolver resolver(io);
  const auto found = resolver.resolve(host, std::to_string(port), tcp::resolver::passive, error);
  if (error || found.empty()) return fail(ErrorKind::kInvalidInput, "--listen " + listen + ": no such host");
  return found.begin()->endpoint();
}

// With SO_REUSEPORT a second daemon could bind the same port unnoticed. Without it, binding tells.
Result<void> check_free(const tcp::endpoint& endpoint, const std::string& where, asio::io_context& io) {
  tcp::acceptor probe(io);
  error_code error;
  probe.open(endpoint.protocol(), error);
  if (!error) probe.set_option(tcp::acceptor::reuse_address(true), error);
  if (!error) probe.bind(endpoint, error);
  if (error) return cannot_listen(where, error);
  return {};
}

}  // namespace

Worker::Worker(const Settings& settings, Handler& handler, const SiteHolder& site, std::atomic<int>& n_connections)
    : settings_(settings), handler_(handler), state_(site), n_connections_(n_connections) {
  refresh_date();
}

// Handlers that never ran hold sessions, and these report here.
Worker::~Worker() {
  for (Session* session : std::vector<Session*>(sessions_.begin(), sessions_.end())) {
    session->check_deadline(Clock::time_point::max());
  }
  io_.restart();
  io_.poll();
}

Result<void> Worker::listen(const tcp::endpoint& endpoint) {
  error_code error;
  acceptor_.open(endpoint.protocol(), error);
  if (!error) acceptor_.set_option(tcp::acceptor::reuse_address(true), error);
  if (!error) acceptor_.set_option(ReusePort(true), error);
  if (!error) acceptor_.bind(endpoint, error);
  if (!error) acceptor_.listen(asio::socket_base::max_listen_connections, error);
  if (!error) acceptor_.non_blocking(true, error);
  if (error) return cannot_listen(endpoint.address().to_string() + ":" + std::to_string(endpoint.port()), error);
  return {};
}

std::uint16_t Worker::port() const {
  error_code ignored;
  return acceptor_.local_endpoint(ignored).port();
}

void Worker::run() {
  accept();
  tick();
  io_.run();
}

void Worker::accept() {
  acceptor_.async_accept([this](error_code error, Socket socket) {
    if (!acceptor_.is_open()) return;
    if (!error) {
      admit(std::move(socket));
      return accept();
    }
    // Out of file descriptors, most likely: try again when some connection may have ended.
    auto pause = std::make_shared<Timer>(io_, kAcceptPause);
    pause->async_wait([this, pause](error_code) {
      if (acceptor_.is_open()) accept();
    });
  });
}

void Worker::admit(Socket socket) {
  if (n_connections_ < settings_.max_connections) {
    std::make_shared<Session>(std::move(socket), *this)->start();
    return;
  }
  static const std::string kFull =
      "HTTP/1.1 503 Service Unavailable\r\nServer: tind\r\nRetry-After: 1\r\nContent-Length: 0\r\n"
      "Access-Control-Allow-Origin: *\r\nConnection: close\r\n\r\n";
  error_code ignored;
  socket.non_blocking(true, ignored);
  socket.write_some(asio::buffer(kFull), ignored);
  socket.shutdown(Socket::shutdown_send, ignored);
}

void Worker::add(Session* session) {
  sessions_.insert(session);
  ++n_connections_;
}

void Worker::remove(Session* session) {
  sessions_.erase(session);
  --n_connections_;
}

// A coarse clock for all connections instead of a timer each.
void Worker::tick() {
  const auto now = Clock::now();
  refresh_date();
  state_.begin_batch();  // an idle thread lets go of what was swapped out, too
  for (Session* session : sessions_) session->check_deadline(now);
  if (draining_ && (sessions_.empty() || now >= drain_deadline_)) return io_.stop();
  tick_timer_.expires_after(kTick);
  tick_timer_.async_wait([this](error_code error) {
    if (!error) tick();
  });
}

void Worker::refresh_date() {
  const std::time_t now = std::time(nullptr);
  if (now == date_second_) return;
  date_second_ = now;
  std::tm parts{};
  gmtime_r(&now, &parts);
  char text[40];
  // The daemon never sets a locale, so names are English as HTTP wants them.
  const std::size_t n = std::strftime(text, sizeof text, "%a, %d %b %Y %H:%M:%S GMT", &parts);
  common_fields_ = "Server: tind\r\nDate: ";
  common_fields_.append(text, n) += "\r\n";
}

void Worker::drain() {
  asio::post(io_, [this] { begin_drain(); });
}

void Worker::begin_drain() {
  if (draining_) return;
  // Connections that the kernel has accepted for us are clients who believe they are served.
  for (;;) {
    error_code error;
    Socket socket(io_);
    acceptor_.accept(socket, error);
    if (error) break;
    admit(std::move(socket));
  }
  error_code ignored;
  acceptor_.close(ignored);
  draining_ = true;
  drain_deadline_ = Clock::now() + std::chrono::seconds(settings_.drain_timeout_s);
  for (Session* session : sessions_) session->drain();
  // A session that just closed is freed by its pending handler; look again after that.
  tick_timer_.expires_after(std::chrono::milliseconds(1));
  tick_timer_.async_wait([this](error_code error) {
    if (!error) tick();
  });
}

Result<void> serve(const Settings& settings, Handler& handler, const SiteHolder& site,
                   const std::function<void(const std::string&)>& on_listening) {
  std::atomic<int> n_connections = 0;
  asio::io_context setup;
  auto endpoint = resolve(settings.listen, setup);
  if (!endpoint) return tl::unexpected(endpoint.error());
  if (auto free = check_free(*endpoint, settings.listen, setup); !free) return free;

  const unsigned cores = std::max(1u, std::thread::hardware_concurrency());
  const std::size_t n_workers = settings.threads > 0 ? static_cast<std::size_t>(settings.threads) : cores;
  std::vector<std::unique_ptr<Worker>> workers;
  for (std::size_t k = 0; k < n_workers; ++k) {
    workers.push_back(std::make_unique<Worker>(settings, handler, site, n_connections));
    if (auto bound = workers.back()->listen(*endpoint); !bound) return bound;
    endpoint->port(workers.back()->port());
  }

  asio::signal_set signals(workers[0]->io(), SIGTERM, SIGINT);
  signals.async_wait([&](error_code error, int) {
    if (error) return;
    handler.set_draining();
    for (auto& worker : workers) worker->drain();
  });
  const std::string host = settings.listen.substr(0, settings.listen.rfind(':'));
  on_listening(host + ":" + std::to_string(endpoint->port()));
  std::vector<std::thread> threads;
  for (std::size_t k = 1; k < n_workers; ++k) threads.emplace_back([&worker = *workers[k]] { worker.run(); });
  workers[0]->run();
  for (std::thread& thread : threads) thread.join();
  return {};
}

}  // namespace tind
