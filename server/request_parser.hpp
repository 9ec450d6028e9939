// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <variant>

#include "server/request.hpp"

namespace tind {

/// The header of one HTTP request.
struct ParsedRequest {
  Request request;
  int minor_version = 1;             ///< Of HTTP/1.x.
  bool keep_alive = true;            ///< The client lets the connection stay open.
  std::uint64_t content_length = 0;  ///< Body bytes that follow.
  bool chunked = false;              ///< A body of unknown length follows.
  bool expects_continue = false;
};

/// Where fields that stand in several lines are put together. Used again and again; one request at a time.
using FieldScratch = std::array<std::string, kRequestFields>;

/// Most bytes of a request target.
inline constexpr std::size_t kMaxTargetBytes = 8000;

/// Parses a request line and header fields by RFC 9112, `block` ending with the empty line. Returns the status to
/// answer with where a server must refuse. Stricter than the grammar where leniency has been abused: bare CR or LF,
/// obs-fold, controls in values, anything but one plain `chunked`, Content-Length twice or beside Transfer-Encoding.
/// Views in the result are of `block` and of `scratch`. Takes no memory but for repeated fields. Safe for any bytes.
std::variant<ParsedRequest, int> parse_request(std::string_view block, FieldScratch& scratch);

/// Bytes of empty lines before a request line, which a server ignores (RFC 9112, 2.2).
std::size_t leading_empty_lines(std::string_view bytes);

}  // namespace tind
