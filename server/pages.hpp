// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "server/served_dataset.hpp"

namespace tind {

/// A dataset as lists know it.
struct ListedDataset {
  std::string name;
  std::optional<DatasetSummary> summary;      ///< nullopt: its file was not read yet.
  std::shared_ptr<const ServedDataset> open;  ///< nullptr: closed.
};

/// Datasets on one page of `/datasets`.
inline constexpr std::size_t kDatasetsPerPage = 1000;

/// `/`: datasets, links and curl lines, and the levels of the first open ones; bounded, however many there are. Links
/// are relative, so it works below any base path.
std::string make_index_page(const std::vector<ListedDataset>& datasets, bool has_cesium);
/// `/datasets` (docs/http.md), page by page; at least one.
std::vector<std::string> make_dataset_lists(const std::vector<ListedDataset>& datasets);
/// `/{name}/` where CesiumJS is not installed.
std::string make_no_cesium_page();

/// A stored tile to try: the bottom level's real one in the middle of its rows, or the nearest thing to it.
TileKey example_tile(const Manifest& manifest);

/// The compiled-in files of server/web.
std::string globe_page();
std::string globe_script();
std::string style_sheet();

}  // namespace tind
