// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/pages.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "server/route.hpp"

namespace tind {
namespace {

constexpr std::size_t kSections = 20;  // datasets on the index page with all their levels

std::string escape_html(std::string_view text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      default:
        out += c;
    }
  }
  return out;
}

std::string page_head(std::string_view title, std::string_view base) {
  return fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width\">\n<title>{}</title>\n"
      "<link rel=\"icon\" href=\"data:,\">\n<link rel=\"stylesheet\" href=\"{}tind/style.css\">\n</head>\n",
      escape_html(title), base);
}

// 1234567 as 1,234,567.
std::string grouped(std::uint64_t n) {
  std::string digits = std::to_string(n);
  for (std::size_t at = digits.size(); at > 3; at -= 3) digits.insert(at - 3, 1, ',');
  return digits;
}

void append_levels(std::string& out, const std::string& folder, const Manifest& manifest) {
  out +=
      "<table>\n<tr><th>level</th><th>tolerance (m)</th><th>max error (m)</th><th>RMSE (m)</th><th>tiles</th>"
      "<th>vertices</th><th>triangles</th><th>KB</th><th>a tile</th></tr>\n";
  for (const LevelInfo& level : manifest.levels) {
    std::string link = "&ndash;";
    // The first tile of the best coverage that the level has.
    const auto best = std::max_element(level.rows.begin(), level.rows.end(), [](const TileRun& a, const TileRun& b) {
      return static_cast<int>(a.coverage) < static_cast<int>(b.coverage);
    });
    if (best != level.rows.end()) {
      const std::string tile = fmt::format("{}/{}/{}", level.level, best->x_first, best->y);
      link = fmt::format(
          "<a href=\"{0}/{1}.terrain\">{1}.terrain</a> <a href=\"{0}/{1}.vn\">.vn</a> "
          "<a href=\"{0}/codes/{1}\">codes</a>",
          folder, tile);
    }
    out += fmt::format(
        "<tr><td>{}</td><td>{:.2f}</td><td>{:.2f}</td><td>{:.2f}</td><td>{}</td><td>{}</td><td>{}</td>"
        "<td>{}</td><td>{}</td></tr>\n",
        level.level, level.tolerance_m, level.max_error_m, level.rmse_m, grouped(level.n_tiles),
        grouped(level.n_vertices), grouped(level.n_triangles), grouped(level.bytes / 1000), link);
  }
  out += "</table>\n";
}

void append_dataset(std::string& out, const Dataset& dataset, bool has_cesium) {
  const Manifest& m = dataset.manifest;
  const std::string folder = percent_encode(dataset.name);
  const TileKey tile = example_tile(m);
  const std::string address = fmt::format("{}/{}/{}", tile.level, tile.x, tile.y);
  out += fmt::format("<section>\n<h2>{}</h2>\n", escape_html(dataset.name));
  out += fmt::format(
      "<p>{:.5f} to {:.5f} degrees east, {:.5f} to {:.5f} degrees north; {} source posts; levels 0 to {}.</p>\n",
      m.bounds_deg[0], m.bounds_deg[2], m.bounds_deg[1], m.bounds_deg[3], grouped(m.n_source_posts), m.bottom_level);
  if (!m.attribution.empty()) out += fmt::format("<p>{}</p>\n", escape_html(m.attribution));
  out += fmt::format(
      "<p><a class=\"main\" href=\"{0}/\">See it on a globe</a>{1} &middot; <a href=\"{0}/layer.json\">layer.json</a> "
      "&middot; <a href=\"{0}/meta.json\">meta.json</a></p>\n",
      folder, has_cesium ? "" : " (CesiumJS is not installed)");
  append_levels(out, folder, m);
  // `$URL` is filled in by the one line of script below; without script it reads as a variable of the shell.
  out += fmt::format(
      "<pre>curl -O --compressed <b class=\"origin\">$URL</b>/{0}/{1}.terrain   # quantized-mesh\n"
      "curl -O --compressed <b class=\"origin\">$URL</b>/{0}/{1}.vn        # vertices, triangles, codes\n"
      "curl -O <b class=\"origin\">$URL</b>/{0}/{1}.parts                  # the nine stored pieces\n"
      "curl <b class=\"origin\">$URL</b>/{0}/codes/{1}                     # crack-tessellation "
      "codes</pre>\n</section>\n",
      folder, address);
}

}  // namespace

TileKey example_tile(const Manifest& manifest) {
  for (auto level = manifest.levels.rbegin(); level != manifest.levels.rend(); ++level) {
    std::vector<TileRun> real;
    for (const TileRun& run : level->rows) {
      if (run.coverage == TileCoverage::kReal) real.push_back(run);
    }
    const auto& runs = real.empty() ? level->rows : real;
    if (runs.empty()) continue;
    const TileRun& run = runs[runs.size() / 2];
    return {static_cast<std::uint8_t>(level->level), run.x_first + (run.x_last - run.x_first) / 2, run.y};
  }
  return {};
}

std::string make_index_page(const std::vector<ListedDataset>& datasets, bool has_cesium) {
  std::string out = page_head("tind: terrain", "");
  out +=
      "<body class=\"text\">\n<h1>tind</h1>\n<p>TIN terrain over HTTP. Tile rows count from the south (TMS). "
      "<a href=\"datasets\">The list as JSON</a>.</p>\n";
  if (!has_cesium) {
    out +=
        "<p class=\"note\">The globe pages need CesiumJS: <code>npm install cesium</code>, then start tind with "
        "<code>--cesium node_modules/cesium/Build/Cesium</code>.</p>\n";
  }
  std::size_t n_sections = 0;
  std::string others;
  std::size_t n_others = 0;
  for (const ListedDataset& listed : datasets) {
    if (listed.open && n_sections < kSections) {
      append_dataset(out, *listed.open->dataset, has_cesium);
      ++n_sections;
    } else if (++n_others <= kDatasetsPerPage) {
      others += fmt::format("<li><a href=\"{}/\">{}</a></li>\n", percent_encode(listed.name), escape_html(listed.name));
    }
  }
  if (n_others > 0) out += "<section>\n<h2>More datasets</h2>\n<ul>\n" + others + "</ul>\n";
  if (n_others > kDatasetsPerPage) {
    out += fmt::format("<p>And {} more: see <a href=\"datasets\">the list</a>.</p>\n",
                       grouped(n_others - kDatasetsPerPage));
  }
  if (n_others > 0) out += "</section>\n";
  out +=
      "<script>for (const b of document.querySelectorAll('.origin')) "
      "b.textContent = new URL('.', location.href).href.slice(0, -1);</script>\n</body>\n</html>\n";
  return out;
}

std::vector<std::string> make_dataset_lists(const std::vector<ListedDataset>& datasets) {
  using nlohmann::ordered_json;
  std::vector<std::string> pages;
  std::size_t at = 0;
  do {
    const std::size_t end = std::min(datasets.size(), at + kDatasetsPerPage);
    ordered_json list = ordered_json::array();
    for (; at < end; ++at) {
      const ListedDataset& listed = datasets[at];
      const std::string folder = percent_encode(listed.name) + "/";
      ordered_json entry = {{"name", listed.name}};
      if (listed.summary) {
        entry["bounds_deg"] = listed.summary->bounds_deg;
        entry["bottom_level"] = listed.summary->bottom_level;
        entry["tolerance_m"] = listed.summary->tolerance_m;
      }
      entry["links"] = {{"globe", folder},
                        {"meta", folder + "meta.json"},
                        {"layer", folder + "layer.json"},
                        {"terrain", folder + "{level}/{x}/{y}.terrain"},
                        {"vn", folder + "{level}/{x}/{y}.vn"},
                        {"parts", folder + "{level}/{x}/{y}.parts"},
                        {"codes", folder + "codes/{level}/{x}/{y}"}};
      list.push_back(std::move(entry));
    }
    ordered_json page = {{"datasets", std::move(list)}};
    if (at < datasets.size()) page["next"] = fmt::format("datasets?page={}", pages.size() + 2);
    pages.push_back(page.dump(-1, ' ', false, ordered_json::error_handler_t::replace));
  } while (at < datasets.size());
  return pages;
}

std::string make_no_cesium_page() {
  return page_head("tind: no globe", "../") +
         "<body class=\"text\">\n<h1>CesiumJS is not installed</h1>\n"
         "<p>The terrain itself is served: see <a href=\"layer.json\">layer.json</a>. To see it on a globe, install "
         "CesiumJS and "
         "tell tind where it is:</p>\n"
         "<pre>npm install cesium\ntind NAME.tind --cesium node_modules/cesium/Build/Cesium</pre>\n"
         "<p><a href=\"../\">All datasets</a></p>\n</body>\n</html>\n";
}

}  // namespace tind
