// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/session.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <fstream>
#include <functional>
#include <thread>

#include "raw_client.hpp"
#include "server/catalog.hpp"
#include "server/worker.hpp"
#include "test_site.hpp"

namespace tind {
namespace {

using test::RawAnswer;
using test::RawClient;
using testing::HasSubstr;

constexpr std::uint32_t kLargeTiles = 5000;  // vertices a side: more than a socket's buffer takes

class SessionTest : public testing::Test {
 protected:
  // `on_wanted`: the file is found in its folder, and this is told when somebody should look at its pages.
  void start(Settings settings = {}, std::uint32_t n_side = 60, const std::function<void()>& on_wanted = {}) {
    test::write_pyramid(directory_.path + "/world.tind", n_side);
    settings_ = settings;
    settings_.datasets = {on_wanted ? directory_.path : directory_.path + "/world.tind"};
    auto catalog = Catalog::open(settings_);
    ASSERT_TRUE(catalog.has_value()) << catalog.error().message;
    catalog_ = std::move(*catalog);
    catalog_->limit()->on_wanted = on_wanted;
    handler_ = std::make_unique<Handler>(settings_);
    connections_ = std::make_unique<ConnectionTable>(settings_.max_connections, settings_.max_connections_per_address);
    worker_ = std::make_unique<Worker>(settings_, *handler_, catalog_->holder(), *connections_);
    const auto bound = worker_->listen(resolve_address("127.0.0.1:0").value());
    ASSERT_TRUE(bound.has_value()) << bound.error().message;
    port_ = worker_->port();
    thread_ = std::thread([this] { worker_->run(); });
  }
  void drain() {
    worker_->drain();
    if (thread_.joinable()) thread_.join();
  }
  void TearDown() override {
    if (worker_) drain();
  }
  RawAnswer ask(const std::string& request, bool has_body = true) {
    RawClient client(port_);
    client.send(request);
    return client.receive(has_body);
  }
  bool alive() { return ask("GET /health HTTP/1.1\r\nHost: h\r\n\r\n").body == "ok\n"; }

  test::TemporaryDirectory directory_;
  Settings settings_;
  std::unique_ptr<Catalog> catalog_;
  std::unique_ptr<ConnectionTable> connections_;
  std::unique_ptr<Handler> handler_;
  std::unique_ptr<Worker> worker_;
  std::uint16_t port_ = 0;
  std::thread thread_;
};

TEST_F(SessionTest, KeepsTheConnectionAndAnswersPipelinedRequestsInOrder) {
  start();
  RawClient client(port_);
  std::string requests;
  for (int k = 0; k < 200; ++k) {
    requests += k % 2 == 0 ? "GET /world/1/" + std::to_string(k / 2 % 4) + "/0.parts HTTP/1.1\r\nHost: h\r\n\r\n"
                           : "GET /health HTTP/1.1\r\nHost: h\r\n\r\n";
  }
  ASSERT_TRUE(client.send(requests));
  for (int k = 0; k < 200; ++k) {
    const RawAnswer answer = client.receive();
    ASSERT_EQ(answer.status, 200) << k;
    EXPECT_EQ(answer.field("Connection"), "keep-alive");
    EXPECT_THAT(answer.field("Date"), HasSubstr(" GMT"));
    if (k % 2 == 0) {
      ASSERT_EQ(answer.body.substr(0, 4), "TVP1");
      EXPECT_EQ(answer.body[8], static_cast<char>(k / 2 % 4));
    } else {
      EXPECT_EQ(answer.body, "ok\n");
    }
  }
}

TEST_F(SessionTest, ReadsRequestsByteByByte) {
  start();
  RawClient client(port_);
  for (const char c : std::string("\r\nGET /health HTTP/1.1\r\nHost: h\r\n\r\n")) {
    ASSERT_TRUE(client.send(std::string(1, c)));
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_EQ(client.receive().body, "ok\n");
}

TEST_F(SessionTest, HeadAnd304AndOptionsHaveNoBody) {
  start();
  RawClient client(port_);
  client.send("HEAD /world/1/0/0.vn HTTP/1.1\r\nHost: h\r\n\r\nGET /health HTTP/1.1\r\nHost: h\r\n\r\n");
  const RawAnswer head = client.receive(false);
  EXPECT_EQ(head.status, 200);
  EXPECT_GT(std::stoul(head.field("Content-Length")), 1000u);
  EXPECT_EQ(client.receive().body, "ok\n");
  client.send("GET /world/1/0/0.vn HTTP/1.1\r\nHost: h\r\nIf-None-Match: " + head.field("ETag") +
              "\r\n\r\n"
              "OPTIONS * HTTP/1.1\r\nHost: h\r\n\r\nGET /health HTTP/1.1\r\nHost: h\r\n\r\n");
  const RawAnswer same = client.receive();
  EXPECT_EQ(same.status, 304);
  EXPECT_EQ(same.field("Content-Length"), "");
  EXPECT_EQ(client.receive().status, 204);
  EXPECT_EQ(client.receive().body, "ok\n");
}

TEST_F(SessionTest, RefusesAndClosesButStaysUp) {
  Settings settings;
  settings.max_header_bytes = 4096;
  start(settings);
  const struct {
    std::string bytes;
    int status;
  } cases[] = {
      {"GET / HTTP/1.1\r\n\r\n", 400},
      {"GET / HTTP/1.1\r\nHost: a\r\nHost: a\r\n\r\n", 400},
      {"GET / HTTP/1.1\r\nHost: a\r\nX: b\r\n c\r\n\r\n", 400},
      {"GET / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: xchunked\r\n\r\n", 501},
      {"GET /\xff HTTP/1.1\r\nHost: a\r\n\r\n", 400},
      {"garbage\r\n\r\n", 400},
      {"GET / HTTP/3.0\r\nHost: a\r\n\r\n", 505},
      {"GET /" + std::string(5000, 'a'), 414},
      {"GET / HTTP/1.1\r\nHost: a\r\nX: " + std::string(5000, 'a'), 431},
      {std::string("GET / HTTP/1.1\r\nHost: a\r\n") + std::string(5000, '\r'), 431},
  };
  for (const auto& c : cases) {
    RawClient client(port_);
    ASSERT_TRUE(client.send(c.bytes));
    const RawAnswer answer = client.receive();
    EXPECT_EQ(answer.status, c.status) << c.bytes.substr(0, 60);
    EXPECT_EQ(answer.field("Connection"), "close");
    EXPECT_TRUE(client.closes_within(3000)) << c.bytes.substr(0, 60);
  }
  EXPECT_TRUE(alive());
}

TEST_F(SessionTest, WrongMethodIs405AndKeepsTheConnection) {
  start();
  RawClient client(port_);
  client.send("POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 5\r\n\r\nhelloGET /health HTTP/1.1\r\nHost: h\r\n\r\n");
  const RawAnswer answer = client.receive();
  EXPECT_EQ(answer.status, 405);
  EXPECT_EQ(answer.field("Allow"), "GET, HEAD, OPTIONS");
  EXPECT_EQ(client.receive().body, "ok\n") << "the body was read past";
}

TEST_F(SessionTest, BodyOfAGetIsReadPastOrTheConnectionEnds) {
  start();
  RawClient small(port_);
  small.send("GET /health HTTP/1.1\r\nHost: h\r\nContent-Length: 40\r\n\r\nGET /nowhere HT");
  EXPECT_EQ(small.receive().body, "ok\n");
  small.send("TP/1.1\r\nHost: h\r\n\r\n......GET /ready HTTP/1.1\r\nHost: h\r\n\r\n");
  EXPECT_EQ(small.receive().body, "ready\n");
  for (const char* fields :
       {"Content-Length: 100000000", "Transfer-Encoding: chunked", "Content-Length: 10\r\nExpect: 100-continue"}) {
    RawClient large(port_);
    large.send(std::string("GET /health HTTP/1.1\r\nHost: h\r\n") + fields + "\r\n\r\n");
    const RawAnswer answer = large.receive();
    EXPECT_EQ(answer.status, 200);
    EXPECT_EQ(answer.field("Connection"), "close") << fields;
    EXPECT_TRUE(large.closes_within(3000));
  }
}

TEST_F(SessionTest, Http10ClosesUnlessAskedNotTo) {
  start();
  RawClient plain(port_);
  plain.send("GET /health HTTP/1.0\r\n\r\n");
  EXPECT_EQ(plain.receive().field("Connection"), "close");
  EXPECT_TRUE(plain.closes_within(3000));
  RawClient kept(port_);
  kept.send("GET /health HTTP/1.0\r\nConnection: keep-alive\r\n\r\n");
  EXPECT_EQ(kept.receive().field("Connection"), "keep-alive");
  kept.send("GET /health HTTP/1.1\r\nHost: h\r\nConnection: close\r\n\r\n");
  EXPECT_EQ(kept.receive().field("Connection"), "close");
  EXPECT_TRUE(kept.closes_within(3000));
}

TEST_F(SessionTest, SlowRequestIs408WhateverTrickles) {
  Settings settings;
  settings.request_timeout_s = 1;
  settings.idle_timeout_s = 1;
  start(settings);
  RawClient slow(port_), idle(port_);
  const auto begin = std::chrono::steady_clock::now();
  slow.send("GET /health HTTP/1.1\r\n");
  // A byte now and then does not put the deadline off.
  for (int k = 0; k < 30 && slow.send("x"); ++k) std::this_thread::sleep_for(std::chrono::milliseconds(100));
  EXPECT_EQ(slow.receive().status, 408);
  EXPECT_TRUE(idle.closes_within(3000));
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(6));
  EXPECT_TRUE(alive());
}

TEST_F(SessionTest, SlowReaderIsCutAndDisturbsNobody) {
  Settings settings;
  settings.request_timeout_s = 1;
  start(settings, kLargeTiles);
  RawClient slow(port_, 4096);
  std::string requests;
  for (int k = 0; k < 400; ++k) requests += "GET /world/1/0/0.vn HTTP/1.1\r\nHost: h\r\n\r\n";  // some 20 MB
  slow.send(requests);
  for (int k = 0; k < 10; ++k) {
    EXPECT_TRUE(alive());
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
  }
  EXPECT_EQ(connections_->n_open(), 0) << "the slow one and the finished ones are gone";
}

TEST_F(SessionTest, SlowReaderGetsEveryByteWhileItGoesOn) {
  start({}, kLargeTiles);
  RawClient slow(port_, 4096), fast(port_);
  const std::string request =
      "GET /world/1/1/1.vn HTTP/1.1\r\nHost: h\r\n\r\nGET /world/1/1/1.parts HTTP/1.1\r\nHost: h\r\n\r\n";
  std::string many;
  for (int k = 0; k < 40; ++k) many += request;
  slow.send(many);
  fast.send(request);
  const RawAnswer vn = fast.receive(), parts = fast.receive();
  ASSERT_GT(vn.body.size(), 10000u);
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  for (int k = 0; k < 40; ++k) {
    ASSERT_EQ(slow.receive().body, vn.body);
    ASSERT_EQ(slow.receive().body, parts.body);
  }
}

TEST_F(SessionTest, ConnectionsBeyondTheLimitGet503) {
  Settings settings;
  settings.max_connections = 2;
  start(settings);
  RawClient a(port_), b(port_);
  a.send("GET /health HTTP/1.1\r\nHost: h\r\n\r\n");
  b.send("GET /health HTTP/1.1\r\nHost: h\r\n\r\n");
  EXPECT_EQ(a.receive().status, 200);
  EXPECT_EQ(b.receive().status, 200);
  RawClient c(port_);
  const RawAnswer full = c.receive();
  EXPECT_EQ(full.status, 503);
  EXPECT_NE(full.field("Retry-After"), "");
  EXPECT_TRUE(c.closes_within(3000));
}

TEST_F(SessionTest, DrainAnswersWhatIsUnderWayAndThenEnds) {
  Settings settings;
  settings.drain_timeout_s = 5;
  start(settings);
  RawClient idle(port_), half(port_);
  half.send("GET /health HTTP/1.1\r\nHo");
  EXPECT_TRUE(alive());
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  const auto begin = std::chrono::steady_clock::now();
  worker_->drain();
  EXPECT_TRUE(idle.closes_within(1000));
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  half.send("st: h\r\n\r\n");
  const RawAnswer answer = half.receive();
  EXPECT_EQ(answer.body, "ok\n");
  EXPECT_EQ(answer.field("Connection"), "close");
  half.closes_within(1000);
  thread_.join();
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(4));
}

// The look at a file's pages takes long and is somebody else's: what needs it waits, longer than a slow client may.
TEST_F(SessionTest, ARequestForAFileThatIsLookedAtWaitsAndHoldsUpNobody) {
  std::ofstream(directory_.path + "/broken.tind") << "no store";
  Settings settings;
  settings.request_timeout_s = 1;
  std::atomic<int> n_wanted = 0;
  start(settings, 60, [&] { ++n_wanted; });
  const std::string health = "GET /health HTTP/1.1\r\nHost: h\r\n\r\n",
                    tile = "GET /world/1/0/0.parts HTTP/1.1\r\nHost: h\r\n\r\n";
  RawClient half_closed(port_), other(port_), of_broken(port_);
  half_closed.send(health + tile + health);
  half_closed.finish_sending();
  EXPECT_EQ(half_closed.receive().body, "ok\n");
  other.send(tile);
  of_broken.send("GET /broken/meta.json HTTP/1.1\r\nHost: h\r\nConnection: close\r\n\r\n");
  RawClient(port_).send(tile);  // gone before its answer
  for (int k = 0; k < 200 && n_wanted < 4; ++k) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  constexpr int kMore = 30;
  std::vector<std::unique_ptr<RawClient>> more;  // of some the end comes together with the request
  for (int k = 0; k < kMore; ++k) {
    more.push_back(std::make_unique<RawClient>(port_));
    more.back()->send(tile);
    more.back()->finish_sending();
  }
  other.send(tile + health);
  std::this_thread::sleep_for(std::chrono::milliseconds(2500));  // a slow client would have been cut
  EXPECT_TRUE(alive());
  EXPECT_EQ(n_wanted, kMore + 4) << "once each";
  for (const auto& slot : catalog_->holder().current()->slots) EXPECT_EQ(slot->if_open(), nullptr);

  catalog_->look_at_wanted();
  for (RawClient* client : {&half_closed, &other, &other}) {
    const RawAnswer answer = client->receive();
    EXPECT_EQ(answer.status, 200);
    EXPECT_EQ(answer.body.substr(0, 4), "TVP1");
  }
  for (RawClient* client : {&half_closed, &other}) EXPECT_EQ(client->receive().body, "ok\n");
  EXPECT_TRUE(half_closed.closes_within(2000));
  for (const auto& client : more) EXPECT_EQ(client->receive().status, 200);
  EXPECT_EQ(of_broken.receive().status, 500);
  EXPECT_TRUE(of_broken.closes_within(3000));
}

TEST_F(SessionTest, DrainIsBoundedInTime) {
  Settings settings;
  settings.drain_timeout_s = 1;
  start(settings);
  RawClient half(port_);
  half.send("GET /health HTTP/1.1\r\nHo");
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  const auto begin = std::chrono::steady_clock::now();
  drain();
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(3));
}

}  // namespace
}  // namespace tind
