// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <optional>
#include <string_view>

namespace tind {

/// Header fields of a request that change the answer, or that somebody writes down.
enum class RequestField : std::uint8_t {
  kHost,
  kAccept,
  kAcceptEncoding,
  kIfMatch,
  kIfNoneMatch,
  kIfModifiedSince,
  kIfUnmodifiedSince,
  kIfRange,
  kRange,
  kOrigin,
  kForwarded,
  kForwardedFor,     ///< X-Forwarded-For
  kForwardedProto,   ///< X-Forwarded-Proto
  kForwardedHost,    ///< X-Forwarded-Host
  kForwardedPrefix,  ///< X-Forwarded-Prefix
  kUserAgent,
  kReferer,
};
inline constexpr std::size_t kRequestFields = 17;

/// What the handler needs of a request. Views into the caller's memory.
struct Request {
  std::string_view method;
  std::string_view target;
  std::array<std::optional<std::string_view>, kRequestFields> fields;  ///< By RequestField; a repeated one is a list.

  const std::optional<std::string_view>& operator[](RequestField field) const {
    return fields[static_cast<std::size_t>(field)];
  }
  std::optional<std::string_view>& operator[](RequestField field) { return fields[static_cast<std::size_t>(field)]; }
};

}  // namespace tind
