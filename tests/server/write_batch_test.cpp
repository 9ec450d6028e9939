// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/write_batch.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace tind {
namespace {

std::string all_of(std::span<const iovec> buffers) {
  std::string out;
  for (const iovec& buffer : buffers) out.append(static_cast<const char*>(buffer.iov_base), buffer.iov_len);
  return out;
}

TEST(WriteBatch, PutsHeadsAndBodiesInOrder) {
  const auto large = std::make_shared<const Bytes>(5000, std::uint8_t{'L'});
  const Bytes small(10, std::uint8_t{'s'});
  WriteBatch batch;
  Response response;
  response.fields = "A: b\r\n";
  response.lead = "lead";
  response.add(small);
  response.add(*large);
  response.add(small);
  response.content_length = 5024;
  response.keep(large);
  batch.add(response, "Server: t\r\n", true);
  EXPECT_EQ(large.use_count(), 2) << "held by the batch";
  text_response(response, 404, "no");
  batch.add(response, "Server: t\r\n", false);
  const std::string expected =
      "HTTP/1.1 200 OK\r\nServer: t\r\nA: b\r\nContent-Length: 5024\r\nConnection: keep-alive\r\n\r\nlead" +
      std::string(10, 's') + std::string(5000, 'L') + std::string(10, 's') +
      "HTTP/1.1 404 Not Found\r\nServer: t\r\nContent-Type: text/plain; charset=utf-8\r\n"
      "X-Content-Type-Options: nosniff\r\nContent-Length: 3\r\nConnection: close\r\n\r\nno\n";
  EXPECT_EQ(all_of(batch.buffers()), expected);
  EXPECT_EQ(batch.n_bytes(), expected.size());
  EXPECT_EQ(batch.buffers().size(), 3u) << "small pieces are copied, large ones are not";
  EXPECT_EQ(batch.buffers()[1].iov_base, large->data());
  for (std::size_t n_sent = 0; n_sent <= expected.size(); n_sent += 7) {
    std::string rest;
    batch.copy_rest(n_sent, rest);
    EXPECT_EQ(rest, expected.substr(n_sent));
  }
  batch.clear();
  EXPECT_TRUE(batch.empty());
  EXPECT_EQ(batch.n_bytes(), 0u);
  EXPECT_EQ(large.use_count(), 1) << "let go";
}

TEST(WriteBatch, IsFullBeforeItsBuffersOverflow) {
  const Bytes large(1000, 1);
  WriteBatch batch;
  Response response;
  int n = 0;
  while (batch.has_room()) {
    response.reset();
    for (std::size_t k = 0; k < Response::kMaxSlices; ++k) response.add(large);
    batch.add(response, "", true);
    ASSERT_LT(++n, 100);
  }
  EXPECT_LE(batch.buffers().size(), WriteBatch::kMaxBuffers);
}

TEST(Response, CutLeavesAnyPartOfTheBody) {
  const std::string text = "0123456789abcdefghij";
  const auto view = [&](std::size_t at, std::size_t n) {
    return ByteView(reinterpret_cast<const std::uint8_t*>(text.data()) + at, n);
  };
  for (std::size_t first = 0; first <= text.size(); ++first) {
    for (std::size_t length = 0; first + length <= text.size(); ++length) {
      Response response;
      response.lead = text.substr(0, 4);
      response.add(view(4, 3));
      response.add(view(7, 1));
      response.add(view(8, 12));
      response.cut(first, length);
      std::string left = response.lead;
      for (const ByteView slice : response.slices()) left.append(slice.begin(), slice.end());
      ASSERT_EQ(left, text.substr(first, length)) << first << " " << length;
    }
  }
}

TEST(Response, ProblemsAreJsonWhateverWasAskedFor) {
  Response response;
  problem_response(response, 404, "no such \"thing\"", "/a\"b\\c\x80", "X: y\r\n");
  EXPECT_EQ(response.lead,
            "{\"type\":\"about:blank\",\"title\":\"Not Found\",\"status\":404,\"detail\":\"no such \\\"thing\\\"\","
            "\"instance\":\"/a\\\"b\\\\c?\"}\n");
  EXPECT_THAT(response.fields, testing::HasSubstr("Content-Type: application/problem+json\r\n"));
  EXPECT_THAT(response.fields, testing::EndsWith("X: y\r\n"));
  EXPECT_EQ(response.content_length, response.lead.size());
}

}  // namespace
}  // namespace tind
