// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

#include "server/request.hpp"

namespace tind {

/// What a representation can be compared by.
struct Validators {
  std::string_view etag;                      ///< Strong, with its quotes.
  std::optional<std::int64_t> last_modified;  ///< Seconds since 1970.
};

enum class Condition { kProceed, kNotModified, kFailed };

/// Evaluates the conditions of a GET or HEAD in the order of RFC 9110, 13.2.2: If-Match, else If-Unmodified-Since; then
/// If-None-Match, else If-Modified-Since. kNotModified: 304. kFailed: 412. Dates that are none are ignored. Pure; safe
/// for any bytes.
Condition evaluate_conditions(const Request& request, const Validators& validators);

/// The bytes [first, first + length) of a representation.
struct ByteRange {
  std::uint64_t first = 0, length = 0;
  friend bool operator==(const ByteRange&, const ByteRange&) = default;
};

/// What to send of `total` bytes by Range and If-Range (RFC 9110, 13.1.5 and 14.2). nullopt: all of them; so for more
/// than one range, another unit, a malformed one, or an If-Range that does not hold. A length of 0: 416, nothing of it
/// is there. Pure; safe for any bytes.
std::optional<ByteRange> choose_range(const Request& request, const Validators& validators, std::uint64_t total);

}  // namespace tind
