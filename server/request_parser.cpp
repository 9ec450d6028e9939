// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/request_parser.hpp"

#include <algorithm>
#include <boost/asio/buffer.hpp>
#include <boost/beast/http/basic_parser.hpp>
#include <limits>

namespace tind {
namespace {

namespace http = boost::beast::http;
using boost::beast::error_code;
using boost::beast::iequals;
using BeastView = boost::beast::string_view;

constexpr int kBadRequest = 400, kUriTooLong = 414, kNotImplemented = 501, kVersionNotSupported = 505;

// Keeps the few fields that matter, without a container of all.
class Parser : public http::basic_parser<true> {
 public:
  ParsedRequest request;
  int n_hosts = 0, n_content_lengths = 0, n_transfer_encodings = 0;
  int version = 0;
  bool host_is_plain = true;
  std::string transfer_encoding;

 private:
  static std::string to_string(BeastView text) { return std::string(text.data(), text.size()); }
  // Repeated list fields are one list.
  static void append(std::optional<std::string>& field, BeastView value) {
    field = field ? *field + ", " + to_string(value) : to_string(value);
  }

  void on_request_impl(http::verb, BeastView method, BeastView target, int http_version, error_code&) override {
    request.method = to_string(method);
    request.target = to_string(target);
    version = http_version;
  }
  void on_response_impl(int, BeastView, int, error_code&) override {}
  void on_field_impl(http::field name, BeastView, BeastView value, error_code&) override {
    switch (name) {
      case http::field::host:
        ++n_hosts;
        host_is_plain = value.find_first_of(" \t,/@\\") == BeastView::npos;
        break;
      case http::field::content_length:
        ++n_content_lengths;
        break;
      case http::field::transfer_encoding:
        ++n_transfer_encodings;
        transfer_encoding = to_string(value);
        break;
      case http::field::accept:
        append(request.accept, value);
        break;
      case http::field::accept_encoding:
        append(request.accept_encoding, value);
        break;
      case http::field::if_none_match:
        append(request.if_none_match, value);
        break;
      case http::field::expect:
        request.expects_continue = true;
        break;
      default:
        break;
    }
  }
  void on_header_impl(error_code&) override {}
  void on_body_init_impl(const boost::optional<std::uint64_t>&, error_code&) override {}
  std::size_t on_body_impl(BeastView body, error_code&) override { return body.size(); }
  void on_chunk_header_impl(std::uint64_t, BeastView, error_code&) override {}
  std::size_t on_chunk_body_impl(std::uint64_t, BeastView body, error_code&) override { return body.size(); }
  void on_finish_impl(error_code&) override {}
};

// What must not occur anywhere in a header. Lines end with CRLF; no line begins with a blank (obs-fold).
bool lines_are_clean(std::string_view block) {
  for (std::size_t i = 0; i < block.size(); ++i) {
    const char c = block[i];
    if (c == '\0') return false;
    if (c == '\n' && (i == 0 || block[i - 1] != '\r')) return false;
    if (c == '\r' && (i + 1 == block.size() || block[i + 1] != '\n')) return false;
    if ((c == ' ' || c == '\t') && i > 0 && block[i - 1] == '\n') return false;
  }
  return true;
}

}  // namespace

Request ParsedRequest::view() const {
  const auto optional_view = [](const std::optional<std::string>& text) {
    return text ? std::optional<std::string_view>(*text) : std::nullopt;
  };
  return {method, target, optional_view(accept), optional_view(accept_encoding), optional_view(if_none_match)};
}

std::size_t leading_empty_lines(std::string_view bytes) {
  std::size_t at = 0;
  while (bytes.substr(at).starts_with("\r\n")) at += 2;
  return at;
}

std::variant<ParsedRequest, int> parse_request(std::string_view block) {
  if (!block.ends_with("\r\n\r\n") || !lines_are_clean(block)) return kBadRequest;
  const std::string_view line = block.substr(0, block.find('\r'));
  const bool graphic = std::all_of(line.begin(), line.end(), [](char c) { return c >= ' ' && c < 0x7f; });
  if (!graphic) return kBadRequest;

  Parser parser;
  parser.header_limit(static_cast<std::uint32_t>(std::min<std::size_t>(block.size() + 1, UINT32_MAX)));
  parser.body_limit(std::numeric_limits<std::uint64_t>::max());  // Boost 1.74 takes boost::none for 0
  error_code error;
  const std::size_t n = parser.put(boost::asio::buffer(block.data(), block.size()), error);
  if (error == http::error::bad_version) return kVersionNotSupported;
  if (error || !parser.is_header_done() || n != block.size()) return kBadRequest;

  ParsedRequest& request = parser.request;
  if (request.target.size() > kMaxTargetBytes) return kUriTooLong;
  const bool is_1_1 = parser.version >= 11;
  if (parser.n_hosts > 1 || (is_1_1 && parser.n_hosts == 0) || !parser.host_is_plain) return kBadRequest;
  if (parser.n_content_lengths > 1) return kBadRequest;
  if (parser.n_transfer_encodings > 0) {
    if (parser.n_transfer_encodings > 1 || parser.n_content_lengths > 0 || !is_1_1) return kBadRequest;
    if (!iequals(parser.transfer_encoding, "chunked")) return kNotImplemented;
    request.chunked = true;
  }
  request.content_length = parser.n_content_lengths > 0 ? parser.content_length().value_or(0) : 0;
  request.keep_alive = parser.keep_alive();
  return std::move(request);
}

}  // namespace tind
