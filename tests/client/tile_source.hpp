// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>

#include "tests/client/byte_cursor.hpp"

namespace tind::client {

/// One answer: HTTP status, media type without parameters, body.
struct Answer {
  int status = 0;
  std::string content_type;
  Blob body;
};

/// Where tiles come from: the daemon over HTTP, or what a test puts in its place.
class TileSource {
 public:
  virtual ~TileSource() = default;
  /// Fetches `path`, which starts with '/' and may have a query. Any status is an answer; a failure is one line
  /// (connection refused, body cut short, ...). Must be thread safe.
  virtual Outcome<Answer> get(const std::string& path) = 0;
};

}  // namespace tind::client
