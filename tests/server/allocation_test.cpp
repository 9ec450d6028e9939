// SPDX-License-Identifier: GPL-3.0-or-later
// A worker that has seen a tile takes no memory to answer for it again.
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <new>
#include <thread>

#include "raw_client.hpp"
#include "server/catalog.hpp"
#include "server/worker.hpp"
#include "test_site.hpp"

namespace {
thread_local bool counts_here = false;
std::atomic<int> n_taken = 0;
}  // namespace

// Every allocation of the program comes here; only those of the worker's thread are counted.
[[gnu::noinline]] void* operator new(std::size_t n) {
  if (counts_here) ++n_taken;
  if (void* memory = std::malloc(n)) return memory;
  throw std::bad_alloc();
}
[[gnu::noinline]] void operator delete(void* memory) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

namespace tind {
namespace {

class AllocationTest : public testing::TestWithParam<const char*> {};

TEST_P(AllocationTest, AnsweringAgainTakesNoMemory) {
  constexpr int kRequests = 1000;
  test::TemporaryDirectory directory;
  test::write_pyramid(directory.path + "/world.tind");
  Settings settings;
  settings.datasets = {directory.path + "/world.tind"};
  const auto catalog = Catalog::open(settings);
  ASSERT_TRUE(catalog.has_value()) << catalog.error().message;
  Handler handler(settings);
  ConnectionTable connections(settings.max_connections, 0);
  Worker worker(settings, handler, (*catalog)->holder(), connections);
  ASSERT_TRUE(worker.listen(resolve_address("127.0.0.1:0").value()).has_value());
  std::thread thread([&] {
    counts_here = true;
    worker.run();
  });
  {
    test::RawClient client(worker.port());
    const auto ask = [&] {
      client.send(GetParam());
      return client.receive();
    };
    const test::RawAnswer first = ask();
    for (int k = 0; k < 10; ++k) ask();
    const int before = n_taken;
    for (int k = 0; k < kRequests; ++k) {
      const test::RawAnswer answer = ask();
      ASSERT_EQ(answer.status, first.status);
      ASSERT_EQ(answer.body, first.body);
    }
    // The clock of the worker writes a new Date now and then.
    EXPECT_LT(n_taken - before, kRequests / 20);
  }
  worker.drain();
  thread.join();
}

INSTANTIATE_TEST_SUITE_P(
    Requests, AllocationTest,
    testing::Values("GET /world/1/2/1.terrain?v=1 HTTP/1.1\r\nHost: h\r\nAccept-Encoding: gzip, deflate, zstd\r\n"
                    "Accept: application/vnd.quantized-mesh;extensions=octvertexnormals,*/*;q=0.01\r\n\r\n",
                    "GET /world/1/2/1.vn HTTP/1.1\r\nHost: h\r\nAccept-Encoding: zstd\r\n\r\n",
                    "GET /world/1/2/1.parts HTTP/1.1\r\nHost: h\r\n\r\n",
                    "GET /world/body/1/2/1 HTTP/1.1\r\nHost: h\r\nAccept-Encoding: zstd\r\n\r\n",
                    "GET /world/layer.json HTTP/1.1\r\nHost: h\r\nAccept-Encoding: gzip\r\n\r\n",
                    "GET /world/1/2/1.parts HTTP/1.1\r\nHost: h\r\nIf-None-Match: *\r\n\r\n",
                    "GET /world/9/9/9.terrain HTTP/1.1\r\nHost: h\r\n\r\n", "GET /health HTTP/1.1\r\nHost: h\r\n\r\n"));

}  // namespace
}  // namespace tind
