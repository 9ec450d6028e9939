// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/access_log.hpp"

#include <fmt/format.h>

namespace tind {

std::string format_access_line(const AccessLine& line, LogFormat format) {
  std::string_view method = "-", target = "-", agent = "";
  if (line.request) {
    method = line.request->method;
    target = line.request->target;
    agent = (*line.request)[RequestField::kUserAgent].value_or("");
  }
  if (format == LogFormat::kJson) {
    return fmt::format(
        R"({{"time":"{}","address":"{}","method":{},"target":{},"status":{},"bytes":{},"seconds":{:.6f},"user_agent":{}}})",
        utc_time(), line.address, json_string(method), json_string(target), line.status, line.n_bytes, line.seconds,
        json_string(agent));
  }
  return fmt::format("{} {} {} {} {} {:.6f} {}", line.address, utc_time(),
                     json_string(std::string(method).append(1, ' ').append(target)), line.status, line.n_bytes,
                     line.seconds, json_string(agent));
}

}  // namespace tind
