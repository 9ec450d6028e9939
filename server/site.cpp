// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/site.hpp"

#include <filesystem>
#include <utility>

#include "server/pages.hpp"

namespace tind {
namespace {

constexpr const char* kHtml = "text/html; charset=utf-8";
constexpr const char* kJson = "application/json";

}  // namespace

DatasetSlot* Site::find(std::string_view name) const {
  const auto found = slots_by_name.find(name);
  return found == slots_by_name.end() ? nullptr : found->second;
}

std::shared_ptr<const Site> SiteHolder::current() const {
  const std::lock_guard lock(mutex_);
  return site_;
}

void SiteHolder::replace(std::shared_ptr<const Site> site) {
  {
    const std::lock_guard lock(mutex_);
    site_.swap(site);
  }
  touch();
  // The last one to hold the old site, which may be this thread, unmaps its files: not under the lock.
}

Result<std::string> find_cesium(const std::string& directory) {
  if (directory.empty()) return std::string();
  std::error_code error;
  const auto root = std::filesystem::canonical(directory, error);
  if (error || !std::filesystem::is_regular_file(root / "Cesium.js", error)) {
    return fail(ErrorKind::kInvalidInput,
                directory + ": no Cesium.js in it; give the Build/Cesium directory of npm's cesium");
  }
  return root.string();
}

std::shared_ptr<const Site> make_site(std::vector<std::shared_ptr<DatasetSlot>> slots, const std::string& cesium_root) {
  Site site;
  site.slots = std::move(slots);
  site.cesium_root = cesium_root;
  std::vector<ListedDataset> listed;
  for (const auto& slot : site.slots) {
    site.slots_by_name.emplace(slot->source().name, slot.get());
    if (slot->has_failed()) continue;
    listed.push_back({slot->source().name, slot->summary(), slot->if_open()});
  }
  site.index = make_document(make_index_page(listed, !cesium_root.empty()), kHtml);
  for (std::string& page : make_dataset_lists(listed)) site.lists.push_back(make_document(std::move(page), kJson));
  site.globe = make_document(cesium_root.empty() ? make_no_cesium_page() : globe_page(), kHtml);
  site.script = make_document(globe_script(), "text/javascript; charset=utf-8");
  site.style = make_document(style_sheet(), "text/css; charset=utf-8");
  return std::make_shared<const Site>(std::move(site));
}

}  // namespace tind
