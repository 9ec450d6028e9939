// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

#include "server/log.hpp"
#include "server/request.hpp"

namespace tind {

/// One line of the access log. Views are the caller's.
struct AccessLine {
  std::string_view address;          ///< Of the client, or "unix".
  const Request* request = nullptr;  ///< nullptr: what came was no request.
  int status = 0;
  std::size_t n_bytes = 0;  ///< Head and body, as made.
  double seconds = 0;       ///< That making the answer took.
};

/// The line without its newline: `ADDRESS TIME "METHOD TARGET" STATUS BYTES SECONDS "USER AGENT"`, or a JSON object.
/// What clients sent is escaped as in JSON, so that they cannot forge lines.
std::string format_access_line(const AccessLine& line, LogFormat format);

}  // namespace tind
