// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>
#include <unordered_map>
#include <vector>

#include "config/settings.hpp"
#include "server/dataset.hpp"

namespace tind {

/// A text made once, when the daemon starts.
struct Document {
  std::string text;
  const char* content_type = "";
  std::string etag_base;  ///< Hash of the text.
};

/// What is served: datasets and the texts about them. Built once, then read by all threads.
struct Site {
  std::vector<Dataset> datasets;
  std::unordered_map<std::string, std::size_t> by_name;
  std::string cesium_root;  ///< Canonical directory of CesiumJS; empty: not installed.
  Document index, list, globe, script, style;
  std::vector<Document> meta, layer;  ///< Per dataset.

  /// nullptr when there is none of that name. The pointer is into `datasets`.
  const Dataset* find(const std::string& name) const;
};

/// Opens the datasets and makes the texts. Fails with the first file that does not open, with kInvalidInput when two
/// have one name or when the CesiumJS directory has no Cesium.js.
Result<Site> make_site(const Settings& settings);

}  // namespace tind
