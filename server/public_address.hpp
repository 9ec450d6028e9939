// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>
#include <string_view>

#include "config/settings.hpp"
#include "server/request.hpp"

namespace tind {

/// Where clients find the daemon when links are to be absolute. Const access is thread safe.
class PublicAddress {
 public:
  /// By the settings `public_url` and `trust_proxy`.
  explicit PublicAddress(const Settings& settings);

  /// "https://example.org/terrain", without a slash at the end; empty: links stay relative. `public_url`, else, when a
  /// proxy is trusted, what it says: Forwarded (RFC 7239), else X-Forwarded-Proto, -Host and -Prefix; of lists the
  /// first element, the proxy that the client met. What is no address is ignored.
  std::string base_for(const Request& request) const;
  /// Whether base_for() looks at the request.
  bool depends_on_request() const { return trust_proxy_ && public_url_.empty(); }

 private:
  std::string public_url_;
  bool trust_proxy_;
};

/// layer.json with the addresses of its tiles below BASE/NAME/, `name` percent-encoded. The text is ours, as made.
std::string absolute_layer(const std::string& layer_json, const std::string& base, const std::string& name);
/// A page of /datasets with all links below BASE/.
std::string absolute_list(const std::string& list_json, const std::string& base);

}  // namespace tind
