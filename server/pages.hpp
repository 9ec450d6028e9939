// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "server/dataset.hpp"

namespace tind {

/// `/`: datasets, their levels, links and curl lines. Links are relative, so it works below any base path.
std::string make_index_page(const std::vector<std::shared_ptr<const Dataset>>& datasets, bool has_cesium);
/// `/datasets` (docs/http.md).
std::string make_dataset_list(const std::vector<std::shared_ptr<const Dataset>>& datasets);
/// `/{name}/` where CesiumJS is not installed.
std::string make_no_cesium_page();

/// A stored tile to try: the bottom level's real one in the middle of its rows, or the nearest thing to it.
TileKey example_tile(const Manifest& manifest);

/// The compiled-in files of server/web.
std::string globe_page();
std::string globe_script();
std::string style_sheet();

}  // namespace tind
