// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace tind {

/// "Sun, 06 Nov 1994 08:49:37 GMT" (IMF-fixdate, RFC 9110, 5.6.7) for seconds since 1970.
std::string format_http_date(std::int64_t seconds);

/// Seconds since 1970 of a date in any of the three forms that a recipient must take: IMF-fixdate, RFC 850's and
/// asctime's. nullopt: none of them, or no such day. `now`: two-digit years are those nearest to it. Safe for any text.
std::optional<std::int64_t> parse_http_date(std::string_view text, std::int64_t now);

}  // namespace tind
