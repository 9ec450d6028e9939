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
#include "server/served_dataset.hpp"

namespace tind {

/// What is served at one moment: datasets and the texts about them. Never changes but for its slots opening and
/// closing; a change of the files makes another site, which shares the slots that stay.
struct Site {
  std::vector<std::shared_ptr<DatasetSlot>> slots;                   ///< Sorted by name.
  std::unordered_map<std::string_view, DatasetSlot*> slots_by_name;  ///< Names and slots are those of `slots`.
  std::string cesium_root;  ///< Canonical directory of CesiumJS; empty: not installed.
  Document index, globe, script, style;
  std::vector<Document> lists;  ///< Pages of `/datasets`, at least one.

  /// nullptr when there is none of that name.
  DatasetSlot* find(std::string_view name) const;
};

/// Puts slots and the texts about them together. `slots` sorted by name.
std::shared_ptr<const Site> make_site(std::vector<std::shared_ptr<DatasetSlot>> slots, const std::string& cesium_root);

/// The canonical directory of CesiumJS. kInvalidInput when the one given has no Cesium.js; empty for an empty one.
Result<std::string> find_cesium(const std::string& directory);

/// The site of the moment. Thread safe.
class SiteHolder {
 public:
  explicit SiteHolder(std::shared_ptr<const Site> site) : site_(std::move(site)) {}

  std::shared_ptr<const Site> current() const;
  /// Swaps in another site. Threads take it over with their next batch of requests; until then they hold the old one.
  void replace(std::shared_ptr<const Site> site);
  /// Makes threads look again which of the slots are open.
  void touch() { version_.fetch_add(1, std::memory_order_release); }
  /// Counts the swaps: a thread that knows the number need not ask for the site.
  std::uint64_t version() const { return version_.load(std::memory_order_acquire); }

 private:
  mutable std::mutex mutex_;
  std::shared_ptr<const Site> site_;
  std::atomic<std::uint64_t> version_ = 0;
};

}  // namespace tind
