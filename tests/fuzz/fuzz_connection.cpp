// SPDX-License-Identifier: GPL-3.0-or-later
#include <algorithm>
#include <charconv>
#include <string>
#include <variant>

#include "server/catalog.hpp"
#include "server/handler.hpp"
#include "server/request_parser.hpp"
#include "server/write_batch.hpp"
#include "tests/fuzz/fuzz_target.hpp"
#include "tests/server/test_site.hpp"

namespace {

using namespace tind;

constexpr std::size_t kMostRequests = 8;
constexpr std::string_view kCommon = "Server: tind\r\nDate: Thu, 01 Jan 1970 00:00:00 GMT\r\n";

// A site of one small pyramid on disk, and what a worker keeps.
struct World {
  test::TemporaryDirectory directory;
  Settings settings;
  std::unique_ptr<Catalog> catalog;
  std::unique_ptr<Handler> handler;
  std::unique_ptr<WorkerState> worker;

  World() {
    const std::string path = directory.path + "/world.tind";
    test::write_pyramid(path, 12);
    settings.datasets = {path};
    settings.cesium = test::write_cesium(directory.path);
    settings.cache_mb = 16;
    auto opened = Catalog::open(settings);
    require(opened.has_value(), "the site opens");
    catalog = std::move(*opened);
    handler = std::make_unique<Handler>(settings);
    worker = std::make_unique<WorkerState>(catalog->holder());
  }
};

bool is_token(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
         std::string_view("!#$%&'*+-.^_`|~").find(c) != std::string_view::npos;
}

// The head of an answer by the grammar of RFC 9112, 4 and 5: nothing that a request holds may break a line of it. Gives
// Content-Length, or npos where there is none.
std::size_t check_head(std::string_view head) {
  require(head.starts_with("HTTP/1.1 ") && head.ends_with("\r\n\r\n"), "a status line and an empty line");
  std::size_t length = std::string_view::npos;
  head.remove_suffix(2);
  for (head.remove_prefix(head.find("\r\n") + 2); !head.empty();) {
    const std::size_t end = head.find("\r\n");
    const std::string_view line = head.substr(0, end);
    head.remove_prefix(end + 2);
    const std::size_t colon = line.find(": ");
    require(colon != line.npos && colon > 0, "a field has a name and a value");
    const std::string_view name = line.substr(0, colon), value = line.substr(colon + 2);
    require(std::all_of(name.begin(), name.end(), is_token), "field names are tokens");
    const auto is_plain = [](char c) { return c >= ' ' && c < 0x7f; };
    require(!value.empty() && std::all_of(value.begin(), value.end(), is_plain), "field values are plain");
    if (name != "Content-Length") continue;
    require(length == line.npos, "one Content-Length");
    require(std::from_chars(value.begin(), value.end(), length).ptr == value.end(), "Content-Length is a number");
  }
  return length;
}

void check_answer(Response& response, std::string_view method, WriteBatch& batch) {
  require(!reason_phrase(response.status).empty(), "the status is one of ours");
  batch.add(response, kCommon, true);
  std::string all;
  for (const auto& buffer : batch.buffers()) all.append(static_cast<const char*>(buffer.iov_base), buffer.iov_len);
  require(all.size() == batch.n_bytes(), "the batch knows its size");
  batch.clear();
  const std::size_t end = all.find("\r\n\r\n");
  require(end != all.npos, "a head has an end");
  const std::size_t length = check_head(std::string_view(all).substr(0, end + 4));
  const std::size_t n_body = all.size() - end - 4;
  const bool bodiless = response.status == 204 || response.status == 304;
  require(bodiless == (length == std::string::npos), "Content-Length where there may be a body");
  require(n_body == (bodiless || method == "HEAD" ? 0 : length), "as many bytes as Content-Length says");
}

}  // namespace

// All that a connection brings, from bytes to answers, as a session takes it apart; without sockets.
int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static World world;
  static FieldScratch scratch;
  static Response response;
  static WriteBatch batch;
  world.worker->begin_batch();
  std::string_view bytes(reinterpret_cast<const char*>(data), size);
  for (std::size_t n = 0; n < kMostRequests; ++n) {
    bytes.remove_prefix(leading_empty_lines(bytes));
    const std::size_t blank = bytes.find("\r\n\r\n");
    if (blank == bytes.npos) break;
    const std::string_view block = bytes.substr(0, blank + 4);
    bytes.remove_prefix(block.size());
    const auto parsed = parse_request(block, scratch);
    if (const int* status = std::get_if<int>(&parsed)) {
      require(*status >= 400 && *status < 600, "what is refused is a failure");
      world.handler->refuse(*status, "refused", response);
      check_answer(response, "GET", batch);
      break;
    }
    const ParsedRequest& request = std::get<ParsedRequest>(parsed);
    const std::string method(request.request.method);
    world.handler->handle(request.request, *world.worker, response);
    check_answer(response, method, batch);
    if (!request.keep_alive || request.chunked || request.expects_continue) break;
    bytes.remove_prefix(static_cast<std::size_t>(std::min<std::uint64_t>(request.content_length, bytes.size())));
  }
  return 0;
}
