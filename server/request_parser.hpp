// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>

#include "server/handler.hpp"

namespace tind {

/// The header of one HTTP request.
struct ParsedRequest {
  std::string method;
  std::string target;
  std::optional<std::string> accept, accept_encoding, if_none_match;
  bool keep_alive = true;            ///< The client lets the connection stay open.
  std::uint64_t content_length = 0;  ///< Body bytes that follow.
  bool chunked = false;              ///< A body of unknown length follows.
  bool expects_continue = false;

  /// Views into this object.
  Request view() const;
};

/// Most bytes of a request target.
inline constexpr std::size_t kMaxTargetBytes = 8000;

/// Parses a request line and header fields, `block` ending with the empty line. Returns the status to answer with where
/// a server must refuse: Beast's parser does the grammar (RFC 9112), and what it is too lenient about is checked here:
/// bare CR or LF, NUL, obs-fold, 8-bit targets, no or two Host fields, any Transfer-Encoding but one plain `chunked`,
/// one beside Content-Length, repeated Content-Length. Pure; safe for any bytes.
std::variant<ParsedRequest, int> parse_request(std::string_view block);

/// Bytes of empty lines before a request line, which a server ignores (RFC 9112, 2.2).
std::size_t leading_empty_lines(std::string_view bytes);

}  // namespace tind
