// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
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

/// A dataset and the texts about it.
struct ServedDataset {
  std::shared_ptr<const Dataset> dataset;
  Document meta, layer;
};

/// Lets a map with text keys be asked with a view.
struct TextHash {
  using is_transparent = void;
  std::size_t operator()(std::string_view text) const { return std::hash<std::string_view>{}(text); }
};

/// What is served: datasets and the texts about them. Built once, then read by all threads.
struct Site {
  std::vector<ServedDataset> datasets;
  std::unordered_map<std::string, std::size_t, TextHash, std::equal_to<>> by_name;
  std::string cesium_root;  ///< Canonical directory of CesiumJS; empty: not installed.
  Document index, list, globe, script, style;

  /// nullptr when there is none of that name. The pointer is into `datasets`.
  const ServedDataset* find(std::string_view name) const;
};

/// The site of the moment. Thread safe.
class SiteHolder {
 public:
  explicit SiteHolder(std::shared_ptr<const Site> site) : site_(std::move(site)) {}

  std::shared_ptr<const Site> current() const;
  /// Swaps in another site. Threads take it over with their next batch of requests; until then they hold the old one.
  void replace(std::shared_ptr<const Site> site);
  /// Counts the swaps: a thread that knows the number need not ask for the site.
  std::uint64_t version() const { return version_.load(std::memory_order_acquire); }

 private:
  mutable std::mutex mutex_;
  std::shared_ptr<const Site> site_;
  std::atomic<std::uint64_t> version_ = 0;
};

/// Opens the datasets and makes the texts. Fails with the first file that does not open, with kInvalidInput when two
/// have one name or when the CesiumJS directory has no Cesium.js.
Result<Site> make_site(const Settings& settings);

}  // namespace tind
