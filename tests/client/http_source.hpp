// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <memory>
#include <string>

#include "tests/client/tile_source.hpp"

namespace tind::client {

/// Fetches over HTTP/1.1 with libcurl; each thread that calls get() keeps one connection alive.
class HttpSource : public TileSource {
 public:
  /// `base`: "http://host:port" without a final slash.
  explicit HttpSource(std::string base);
  ~HttpSource() override;
  Outcome<Answer> get(const std::string& path) override;

 private:
  struct Pool;
  std::string base_;
  std::unique_ptr<Pool> pool_;
};

/// An URL as the user types it, cut into the part before and the dataset's name.
struct DatasetUrl {
  std::string base;  ///< "http://host:port"
  std::string name;  ///< Empty: the user named no dataset.
};

/// Takes "http://host:port", "http://host:port/" or "http://host:port/{name}" with or without a final slash.
Outcome<DatasetUrl> parse_dataset_url(const std::string& url);

}  // namespace tind::client
