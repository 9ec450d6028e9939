// SPDX-License-Identifier: GPL-3.0-or-later
// What a connection may and may not do to the worker.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>

#include <chrono>
#include <new>
#include <thread>

#include "raw_client.hpp"
#include "server/catalog.hpp"
#include "server/worker.hpp"
#include "test_site.hpp"

namespace tind {
namespace {

using test::RawAnswer;
using test::RawClient;

const std::string kHealth = "GET /health HTTP/1.1\r\nHost: h\r\n\r\n";

class SessionLimitsTest : public testing::Test {
 protected:
  void start(const Settings& settings, std::uint32_t n_side = 60) {
    test::write_pyramid(directory_.path + "/world.tind", n_side);
    settings_ = settings;
    settings_.datasets = {directory_.path + "/world.tind"};
    auto catalog = Catalog::open(settings_);
    ASSERT_TRUE(catalog.has_value()) << catalog.error().message;
    catalog_ = std::move(*catalog);
    handler_ = std::make_unique<Handler>(settings_);
    connections_ = std::make_unique<ConnectionTable>(settings_.max_connections, settings_.max_connections_per_address);
    worker_ = std::make_unique<Worker>(settings_, *handler_, catalog_->holder(), *connections_);
    ASSERT_TRUE(worker_->listen(resolve_address("127.0.0.1:0").value()).has_value());
    port_ = worker_->port();
    thread_ = std::thread([this] { worker_->run(); });
  }
  void TearDown() override {
    worker_->drain();
    thread_.join();
  }
  // The worker notices a closed connection a moment later.
  bool all_closed() {
    for (int k = 0; k < 100 && connections_->n_open() > 0; ++k)
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    return connections_->n_open() == 0;
  }

  test::TemporaryDirectory directory_;
  Settings settings_;
  std::unique_ptr<Catalog> catalog_;
  std::unique_ptr<Handler> handler_;
  std::unique_ptr<ConnectionTable> connections_;
  std::unique_ptr<Worker> worker_;
  std::uint16_t port_ = 0;
  std::thread thread_;
};

// Fails as nothing should, when asked to.
class ThrowingHandler final : public RequestHandler {
 public:
  void handle(const Request& request, WorkerState&, Response& out) override {
    if (request.target == "/throw") throw std::bad_alloc();
    text_response(out, 200, "ok");
  }
  void refuse(int status, std::string_view why, Response& out) override { problem_response(out, status, why); }
};

TEST(Worker, WhatIsThrownEndsOneConnectionOnly) {
  const test::TemporaryDirectory directory;
  test::write_pyramid(directory.path + "/world.tind");
  Settings settings;
  settings.datasets = {directory.path + "/world.tind"};
  auto catalog = Catalog::open(settings);
  ASSERT_TRUE(catalog.has_value());
  ThrowingHandler handler;
  ConnectionTable connections(100, 0);
  Worker worker(settings, handler, (*catalog)->holder(), connections);
  ASSERT_TRUE(worker.listen(resolve_address("127.0.0.1:0").value()).has_value());
  std::thread thread([&] { worker.run(); });
  RawClient other(worker.port()), unlucky(worker.port());
  other.send(kHealth);
  EXPECT_EQ(other.receive().status, 200);
  // The first answer of the batch goes down with the second.
  unlucky.send(kHealth + "GET /throw HTTP/1.1\r\nHost: h\r\n\r\n");
  EXPECT_TRUE(unlucky.closes_within(3000));
  other.send(kHealth);
  EXPECT_EQ(other.receive().body, "ok\n");
  EXPECT_EQ(connections.n_open(), 1);
  worker.drain();
  thread.join();
}

TEST_F(SessionLimitsTest, AConnectionBringsSoManyRequests) {
  Settings settings;
  settings.max_requests_per_connection = 3;
  start(settings);
  RawClient client(port_);
  client.send(kHealth + kHealth + kHealth + kHealth);
  EXPECT_EQ(client.receive().field("Connection"), "keep-alive");
  EXPECT_EQ(client.receive().field("Connection"), "keep-alive");
  EXPECT_EQ(client.receive().field("Connection"), "close");
  EXPECT_EQ(client.receive().status, 0);
}

TEST_F(SessionLimitsTest, AnAddressHasSoManyConnections) {
  Settings settings;
  settings.max_connections_per_address = 2;
  start(settings);
  {
    RawClient a(port_), b(port_);
    a.send(kHealth);
    b.send(kHealth);
    EXPECT_EQ(a.receive().status, 200);
    EXPECT_EQ(b.receive().status, 200);
    RawClient c(port_);
    const RawAnswer refused = c.receive();
    EXPECT_EQ(refused.status, 503);
    EXPECT_NE(refused.field("Retry-After"), "");
    EXPECT_EQ(refused.field("Content-Type"), "application/problem+json");
  }
  EXPECT_TRUE(all_closed());
  RawClient again(port_);
  again.send(kHealth);
  EXPECT_EQ(again.receive().status, 200) << "places come back";
  EXPECT_EQ(connections_->count_of(ConnectionEvent::kRefusedAddress), 1u);
}

TEST_F(SessionLimitsTest, AClientThatSendsNoMoreGetsItsAnswers) {
  start({});
  RawClient client(port_);
  client.send(kHealth + "GET /world/1/2/1.vn HTTP/1.1\r\nHost: h\r\n\r\n" + kHealth);
  client.finish_sending();
  EXPECT_EQ(client.receive().body, "ok\n");
  EXPECT_GT(client.receive().body.size(), 1000u);
  EXPECT_EQ(client.receive().body, "ok\n");
  EXPECT_TRUE(client.closes_within(1000));
  EXPECT_TRUE(all_closed());
}

TEST_F(SessionLimitsTest, HalfARequestAndNoMoreIsTheEnd) {
  start({});
  RawClient client(port_);
  client.send("GET /health HTTP/1.1\r\nHos");
  client.finish_sending();
  EXPECT_TRUE(client.closes_within(1000));
  EXPECT_TRUE(all_closed());
}

TEST_F(SessionLimitsTest, ClientsThatGoAwayLeaveNothing) {
  start({}, 4000);
  for (int k = 0; k < 50; ++k) {
    RawClient client(port_, 4096);
    client.send("GET /world/1/2/1.vn HTTP/1.1\r\nHost: h\r\n\r\nGET /world/1/2/1.parts HTTP/1.1\r\nHost: h\r\n\r\n");
  }
  EXPECT_TRUE(all_closed());
}

TEST_F(SessionLimitsTest, WhatCannotBecomeARequestIsToldAtOnce) {
  start({});
  for (const std::string& bytes : {std::string("\x16\x03\x01"), std::string("GET / HTTP/1.1\nHost: h\n\n"),
                                   std::string("GET /\0", 6), std::string("\n")}) {
    RawClient client(port_);
    client.send(bytes);
    EXPECT_EQ(client.receive().status, 400);
    EXPECT_TRUE(client.closes_within(1000));
  }
}

TEST_F(SessionLimitsTest, AReaderBelowTheLeastRateIsCut) {
  Settings settings;
  settings.request_timeout_s = 1;
  settings.min_send_rate_bytes_s = 1000000000;
  start(settings, 4000);
  RawClient slow(port_, 4096);
  std::string requests;
  for (int k = 0; k < 400; ++k) requests += "GET /world/1/0/0.vn HTTP/1.1\r\nHost: h\r\n\r\n";
  slow.send(requests);
  // It reads on, and is too slow all the same.
  int n_answers = 0;
  while (n_answers < 400 && slow.receive().status == 200) {
    ++n_answers;
    std::this_thread::sleep_for(std::chrono::milliseconds(150));
  }
  EXPECT_LT(n_answers, 400);
  EXPECT_TRUE(all_closed());
  EXPECT_EQ(connections_->count_of(ConnectionEvent::kSlowReader), 1u);
}

TEST_F(SessionLimitsTest, HeadersUpToTheLimit) {
  Settings settings;
  settings.max_header_bytes = 2048;
  start(settings);
  const std::string line = "GET /health HTTP/1.1\r\nHost: h\r\nX: ";
  for (const std::size_t size : {std::size_t{2048}, std::size_t{2049}, std::size_t{60000}}) {
    RawClient client(port_);
    client.send(line + std::string(size - line.size() - 4, 'x') + "\r\n\r\n");
    EXPECT_EQ(client.receive().status, size <= 2048 ? 200 : 431) << size;
  }
}

TEST(ClientKey, IsTheAddressOrTheNetwork) {
  const auto key = [](const char* address) { return client_key(resolve_address(address).value()); };
  EXPECT_EQ(key("192.0.2.1:80"), key("192.0.2.1:81"));
  EXPECT_NE(key("192.0.2.1:80"), key("192.0.2.2:80"));
  EXPECT_EQ(key("[2001:db8::1]:80"), key("[2001:db8::2]:80"));
  EXPECT_NE(key("[2001:db8::1]:80"), key("[2001:db8:0:1::1]:80"));
  EXPECT_EQ(key("[::ffff:192.0.2.1]:80"), key("192.0.2.1:80"));
  EXPECT_EQ(resolve_address("[2001:db8::1]:80").value().text(), "[2001:db8::1]:80");
  EXPECT_EQ(resolve_address("127.0.0.1:8080").value().text(), "127.0.0.1:8080");
}

}  // namespace
}  // namespace tind
