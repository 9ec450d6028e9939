// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/request_parser.hpp"

#include <gtest/gtest.h>

namespace tind {
namespace {

FieldScratch scratch;

int status(const std::string& block) {
  const auto parsed = parse_request(block, scratch);
  return std::holds_alternative<int>(parsed) ? std::get<int>(parsed) : 200;
}
// Views of `block` and of `scratch`.
ParsedRequest parse(std::string_view block) {
  auto parsed = parse_request(block, scratch);
  EXPECT_TRUE(std::holds_alternative<ParsedRequest>(parsed)) << block;
  return std::holds_alternative<int>(parsed) ? ParsedRequest{} : std::get<ParsedRequest>(std::move(parsed));
}

TEST(RequestParser, KeepsWhatTheHandlerNeeds) {
  const auto r = parse(
      "GET /a?b HTTP/1.1\r\nhost: h\r\nACCEPT: x\r\nAccept-Encoding: gzip\r\nAccept-Encoding: zstd\r\n"
      "If-None-Match: \"t\"\r\nX-Other: y\r\n\r\n");
  EXPECT_EQ(r.request.method, "GET");
  EXPECT_EQ(r.request.target, "/a?b");
  EXPECT_EQ(r.request[RequestField::kHost], "h");
  EXPECT_EQ(r.request[RequestField::kAccept], "x");
  EXPECT_EQ(r.request[RequestField::kAcceptEncoding], "gzip, zstd");
  EXPECT_EQ(r.request[RequestField::kIfNoneMatch], "\"t\"");
  EXPECT_EQ(r.request[RequestField::kRange], std::nullopt);
  EXPECT_TRUE(r.keep_alive);
  EXPECT_FALSE(parse("GET / HTTP/1.1\r\nHost: h\r\nConnection: close\r\n\r\n").keep_alive);
  EXPECT_FALSE(parse("GET / HTTP/1.0\r\n\r\n").keep_alive);
  EXPECT_TRUE(parse("GET / HTTP/1.0\r\nConnection: keep-alive\r\n\r\n").keep_alive);
  EXPECT_EQ(parse("GET / HTTP/1.1\r\nHost: h\r\nContent-Length: 12\r\n\r\n").content_length, 12u);
  EXPECT_TRUE(parse("GET / HTTP/1.1\r\nHost: h\r\nTransfer-Encoding: Chunked\r\n\r\n").chunked);
}

TEST(RequestParser, RefusesWhatAServerMustRefuse) {
  const struct {
    const char* why;
    std::string block;
    int status;
  } cases[] = {
      {"no Host", "GET / HTTP/1.1\r\n\r\n", 400},
      {"two Hosts", "GET / HTTP/1.1\r\nHost: a\r\nHost: a\r\n\r\n", 400},
      {"bad Host", "GET / HTTP/1.1\r\nHost: a b\r\n\r\n", 400},
      {"a port that is none", "GET / HTTP/1.1\r\nHost: a:8x\r\n\r\n", 400},
      {"a port behind a bracket", "GET / HTTP/1.1\r\nHost: [::1]8\r\n\r\n", 400},
      {"obs-fold", "GET / HTTP/1.1\r\nHost: a\r\nX: b\r\n c\r\n\r\n", 400},
      {"folded Host", "GET / HTTP/1.1\r\nHost:\r\n a\r\n\r\n", 400},
      {"blank before first field", "GET / HTTP/1.1\r\n Host: a\r\n\r\n", 400},
      {"blank before colon", "GET / HTTP/1.1\r\nHost : a\r\n\r\n", 400},
      {"xchunked", "GET / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: xchunked\r\n\r\n", 501},
      {"chunked twice", "GET / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked, chunked\r\n\r\n", 400},
      {"no coding", "GET / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding:\r\n\r\n", 400},
      {"gzip first", "GET / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: gzip, chunked\r\n\r\n", 501},
      {"list of lengths", "GET / HTTP/1.1\r\nHost: a\r\nContent-Length: 3, 3\r\n\r\n", 400},
      {"signed length", "GET / HTTP/1.1\r\nHost: a\r\nContent-Length: +3\r\n\r\n", 400},
      {"no length", "GET / HTTP/1.1\r\nHost: a\r\nContent-Length:\r\n\r\n", 400},
      {"huge length", "GET / HTTP/1.1\r\nHost: a\r\nContent-Length: 18446744073709551616\r\n\r\n", 400},
      {"nameless field", "GET / HTTP/1.1\r\nHost: a\r\n: b\r\n\r\n", 400},
      {"bad field name", "GET / HTTP/1.1\r\nHost: a\r\nX(: b\r\n\r\n", 400},
      {"no colon", "GET / HTTP/1.1\r\nHost: a\r\nX\r\n\r\n", 400},
      {"control in a value", "GET / HTTP/1.1\r\nHost: a\r\nX: \x01\r\n\r\n", 400},
      {"DEL in a value", "GET / HTTP/1.1\r\nHost: a\r\nX: \x7f\r\n\r\n", 400},
      {"bad method", "G@T / HTTP/1.1\r\nHost: a\r\n\r\n", 400},
      {"lower-case http", "GET / http/1.1\r\nHost: a\r\n\r\n", 400},
      {"version of two digits", "GET / HTTP/1.10\r\nHost: a\r\n\r\n", 400},
      {"Host of two", "GET / HTTP/1.1\r\nHost: a, b\r\nHost: c\r\n\r\n", 400},
      {"Host with a user", "GET / HTTP/1.1\r\nHost: u@a\r\n\r\n", 400},
      {"two codings", "GET / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\nTransfer-Encoding: chunked\r\n\r\n",
       400},
      {"length and coding", "GET / HTTP/1.1\r\nHost: a\r\nContent-Length: 3\r\nTransfer-Encoding: chunked\r\n\r\n",
       400},
      {"coding in 1.0", "GET / HTTP/1.0\r\nTransfer-Encoding: chunked\r\n\r\n", 400},
      {"two lengths", "GET / HTTP/1.1\r\nHost: a\r\nContent-Length: 3\r\nContent-Length: 4\r\n\r\n", 400},
      {"bad length", "GET / HTTP/1.1\r\nHost: a\r\nContent-Length: 3x\r\n\r\n", 400},
      {"negative length", "GET / HTTP/1.1\r\nHost: a\r\nContent-Length: -3\r\n\r\n", 400},
      {"8-bit target", "GET /\xc3\xa4 HTTP/1.1\r\nHost: a\r\n\r\n", 400},
      {"bare LF", "GET / HTTP/1.1\nHost: a\r\n\r\n", 400},
      {"bare CR", "GET / HTTP/1.1\r\nHost: a\rb\r\n\r\n", 400},
      {"NUL", std::string("GET / HTTP/1.1\r\nHost: a\r\nX: ") + '\0' + "\r\n\r\n", 400},
      {"no version", "GET /\r\n\r\n", 400},
      {"version 2", "GET / HTTP/2.0\r\nHost: a\r\n\r\n", 505},
      {"not HTTP", "\x16\x03\x01\r\n\r\n", 400},
      {"two spaces", "GET  / HTTP/1.1\r\nHost: a\r\n\r\n", 400},
      {"long target", "GET /" + std::string(9000, 'a') + " HTTP/1.1\r\nHost: a\r\n\r\n", 414},
      {"no empty line", "GET / HTTP/1.1\r\nHost: a\r\n", 400},
  };
  for (const auto& c : cases) EXPECT_EQ(status(c.block), c.status) << c.why;
}

TEST(RequestParser, TakesWhatIsOddButRight) {
  const std::string odd =
      "get / HTTP/1.7\r\nHost:\r\nX-Latin: \xe4\r\nAccept:\t a \t\r\nAccept: b\r\nAccept: c\r\n"
      "Connection: x , Close\r\n\r\n";
  const auto r = parse(odd);
  EXPECT_EQ(r.request.method, "get");
  EXPECT_EQ(r.request[RequestField::kHost], "");
  EXPECT_EQ(r.request[RequestField::kAccept], "a, b, c");
  EXPECT_EQ(r.minor_version, 1);
  EXPECT_FALSE(r.keep_alive);
}

TEST(RequestParser, CountsLeadingEmptyLines) {
  EXPECT_EQ(leading_empty_lines("\r\n\r\nGET"), 4u);
  EXPECT_EQ(leading_empty_lines("GET"), 0u);
  EXPECT_EQ(leading_empty_lines("\r"), 0u);
}

}  // namespace
}  // namespace tind
