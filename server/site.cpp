// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/site.hpp"

#include <filesystem>

#include "server/layer_json.hpp"
#include "server/pages.hpp"

namespace tind {
namespace {

constexpr const char* kHtml = "text/html; charset=utf-8";
constexpr const char* kJson = "application/json";

Document document(std::string text, const char* content_type) {
  std::string hash = fingerprint({text});
  return {std::move(text), content_type, std::move(hash)};
}

}  // namespace

const ServedDataset* Site::find(std::string_view name) const {
  const auto found = by_name.find(name);
  return found == by_name.end() ? nullptr : &datasets[found->second];
}

std::shared_ptr<const Site> SiteHolder::current() const {
  const std::lock_guard lock(mutex_);
  return site_;
}

void SiteHolder::replace(std::shared_ptr<const Site> site) {
  const std::lock_guard lock(mutex_);
  site_.swap(site);
  version_.fetch_add(1, std::memory_order_release);
}

Result<Site> make_site(const Settings& settings) {
  Site site;
  for (const DatasetSpec& spec : settings.datasets) {
    const std::string& path = spec.path;
    auto dataset = open_dataset(path);
    if (!dataset) return tl::unexpected(dataset.error());
    if (!site.by_name.emplace(dataset->name, site.datasets.size()).second) {
      return fail(ErrorKind::kInvalidInput,
                  path + ": a dataset named '" + dataset->name + "' is given twice; rename one");
    }
    site.datasets.push_back({std::make_shared<const Dataset>(std::move(*dataset)), {}, {}});
  }
  if (!settings.cesium.empty()) {
    std::error_code error;
    const auto root = std::filesystem::canonical(settings.cesium, error);
    if (error || !std::filesystem::is_regular_file(root / "Cesium.js", error)) {
      return fail(ErrorKind::kInvalidInput,
                  settings.cesium + ": no Cesium.js in it; give the Build/Cesium directory of npm's cesium");
    }
    site.cesium_root = root.string();
  }
  std::vector<std::shared_ptr<const Dataset>> datasets;
  for (ServedDataset& served : site.datasets) {
    const Dataset& dataset = *served.dataset;
    served.meta = document(dataset.manifest_json, kJson);
    served.layer = document(make_layer_json(dataset.manifest, dataset.name, dataset.version), kJson);
    datasets.push_back(served.dataset);
  }
  site.index = document(make_index_page(datasets, !site.cesium_root.empty()), kHtml);
  site.list = document(make_dataset_list(datasets), kJson);
  site.globe = document(site.cesium_root.empty() ? make_no_cesium_page() : globe_page(), kHtml);
  site.script = document(globe_script(), "text/javascript; charset=utf-8");
  site.style = document(style_sheet(), "text/css; charset=utf-8");
  return site;
}

}  // namespace tind
