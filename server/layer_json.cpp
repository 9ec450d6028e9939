// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/layer_json.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "server/route.hpp"

namespace tind {

std::vector<TileRectangle> available_rectangles(const std::vector<TileRun>& rows) {
  std::vector<TileRectangle> done, open, row;  // open: those that reach the row before the current one
  const auto close_row = [&] {
    std::vector<TileRectangle> next;
    for (const TileRectangle& run : row) {
      const auto above = std::find_if(open.begin(), open.end(), [&](const TileRectangle& r) {
        return r.x_first == run.x_first && r.x_last == run.x_last && r.y_last + 1 == run.y_first;
      });
      if (above == open.end()) {
        next.push_back(run);
        continue;
      }
      next.push_back(*above);
      next.back().y_last = run.y_last;
      open.erase(above);
    }
    done.insert(done.end(), open.begin(), open.end());
    open = std::move(next);
    row.clear();
  };
  for (const TileRun& run : rows) {
    if (!row.empty() && row.back().y_first != run.y) close_row();
    if (!row.empty() && row.back().x_last + 1 == run.x_first) {
      row.back().x_last = run.x_last;
    } else {
      row.push_back({run.x_first, run.y, run.x_last, run.y});
    }
  }
  close_row();
  done.insert(done.end(), open.begin(), open.end());
  std::sort(done.begin(), done.end(), [](const TileRectangle& a, const TileRectangle& b) {
    return a.y_first != b.y_first ? a.y_first < b.y_first : a.x_first < b.x_first;
  });
  return done;
}

std::string make_layer_json(const Manifest& manifest, const LayerOptions& options) {
  using nlohmann::ordered_json;
  ordered_json available = ordered_json::array();
  for (const std::vector<TileRun>& rows : options.tiles) {
    ordered_json rectangles = ordered_json::array();
    for (const TileRectangle& r : available_rectangles(rows)) {
      rectangles.push_back({{"startX", r.x_first}, {"startY", r.y_first}, {"endX", r.x_last}, {"endY", r.y_last}});
    }
    available.push_back(std::move(rectangles));
  }
  // The version stands in the address itself, so that every client and cache asks anew after the dataset has changed.
  ordered_json layer = {{"tilejson", "2.1.0"},
                        {"name", options.name},
                        {"description", "TIN terrain served by tind"},
                        {"version", "1.0.0-" + options.version},
                        {"format", "quantized-mesh-1.0"},
                        {"scheme", "tms"},
                        {"projection", "EPSG:4326"},
                        {"bounds", manifest.bounds_deg},
                        {"minzoom", 0},
                        {"maxzoom", options.tiles.empty() ? 0 : static_cast<int>(options.tiles.size()) - 1},
                        {"tiles", {"{z}/{x}/{y}.terrain?v=" + options.version}},
                        {"available", std::move(available)},
                        {"extensions", {"octvertexnormals"}},
                        {"attribution", manifest.attribution},
                        {"heights", manifest.heights},
                        {"vertical_datum", manifest.vertical_datum}};
  // Both Cesium clients resolve it against this file's address and append layer.json.
  if (!options.parent.empty()) layer["parentUrl"] = "../" + percent_encode(options.parent) + "/";
  return layer.dump();
}

}  // namespace tind
