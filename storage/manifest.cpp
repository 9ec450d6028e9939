// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/manifest.hpp"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <stdexcept>
#include <utility>

namespace tind {
namespace {

using nlohmann::json;

constexpr const char* kHorizontalCrs = "EPSG:4326";

json level_to_json(const LevelInfo& level) {
  json rows = json::array();
  for (const TileRun& run : level.rows) {
    rows.push_back({run.y, run.x_first, run.x_last, static_cast<int>(run.coverage)});
  }
  return {{"level", level.level},
          {"tolerance_m", level.tolerance_m},
          {"spacing_m", level.spacing_m},
          {"height_step_m", level.height_step_m},
          {"n_tiles", level.n_tiles},
          {"n_real", level.n_real},
          {"n_partial", level.n_partial},
          {"n_filler", level.n_filler},
          {"n_vertices", level.n_vertices},
          {"n_border_vertices", level.n_border_vertices},
          {"n_seed_vertices", level.n_seed_vertices},
          {"n_triangles", level.n_triangles},
          {"n_posts", level.n_posts},
          {"max_error_m", level.max_error_m},
          {"rmse_m", level.rmse_m},
          {"bytes", level.bytes},
          {"rows", std::move(rows)}};
}

// A whole number in T's range: nlohmann itself casts blindly. Throws as level_from_json does.
template <class T>
T whole(const json& j) {
  if (j.is_number_unsigned()) {
    const auto value = j.get<std::uint64_t>();
    if (std::in_range<T>(value)) return static_cast<T>(value);
  } else if (j.is_number_integer()) {
    const auto value = j.get<std::int64_t>();
    if (std::in_range<T>(value)) return static_cast<T>(value);
  }
  throw std::out_of_range("a whole number is expected, or one in range");
}

// Throws json::exception or std::out_of_range on anything odd; decode_manifest catches.
LevelInfo level_from_json(const json& j, int index) {
  LevelInfo level;
  level.level = whole<int>(j.at("level"));
  if (level.level != index) throw std::out_of_range("levels are not in order");
  level.tolerance_m = j.at("tolerance_m").get<double>();
  level.spacing_m = j.at("spacing_m").get<double>();
  level.height_step_m = j.at("height_step_m").get<double>();
  if (!(level.tolerance_m > 0) || !(level.height_step_m > 0)) throw std::out_of_range("tolerance or step not positive");
  level.n_tiles = whole<std::uint64_t>(j.at("n_tiles"));
  level.n_real = whole<std::uint64_t>(j.at("n_real"));
  level.n_partial = whole<std::uint64_t>(j.at("n_partial"));
  level.n_filler = whole<std::uint64_t>(j.at("n_filler"));
  level.n_vertices = whole<std::uint64_t>(j.at("n_vertices"));
  level.n_border_vertices = whole<std::uint64_t>(j.at("n_border_vertices"));
  level.n_seed_vertices = whole<std::uint64_t>(j.at("n_seed_vertices"));
  level.n_triangles = whole<std::uint64_t>(j.at("n_triangles"));
  level.n_posts = whole<std::uint64_t>(j.at("n_posts"));
  level.max_error_m = j.at("max_error_m").get<double>();
  level.rmse_m = j.at("rmse_m").get<double>();
  level.bytes = whole<std::uint64_t>(j.at("bytes"));
  const json& rows = j.at("rows");
  level.rows.reserve(rows.size());
  for (const json& r : rows) {
    TileRun run;
    run.y = whole<std::uint32_t>(r.at(0));
    run.x_first = whole<std::uint32_t>(r.at(1));
    run.x_last = whole<std::uint32_t>(r.at(2));
    const int coverage = whole<int>(r.at(3));
    if (coverage < 0 || coverage > 2 || run.x_first > run.x_last || run.x_last >= TileKey::count_x(index) ||
        run.y >= TileKey::count_y(index)) {
      throw std::out_of_range("a row of tiles is out of range");
    }
    if (!level.rows.empty()) {
      const TileRun& before = level.rows.back();
      if (run.y < before.y || (run.y == before.y && run.x_first <= before.x_last)) {
        throw std::out_of_range("rows of tiles are not sorted");
      }
    }
    run.coverage = static_cast<TileCoverage>(coverage);
    level.rows.push_back(run);
  }
  return level;
}

}  // namespace

bool Manifest::has_tile(const TileKey& key) const {
  if (!key.valid() || key.level >= levels.size()) return false;
  const std::vector<TileRun>& rows = levels[key.level].rows;
  const auto after = std::upper_bound(rows.begin(), rows.end(), key, [](const TileKey& k, const TileRun& run) {
    return k.y != run.y ? k.y < run.y : k.x < run.x_first;
  });
  if (after == rows.begin()) return false;
  const TileRun& run = *(after - 1);
  return run.y == key.y && key.x <= run.x_last;
}

std::string encode_manifest(const Manifest& m) {
  json sources = json::array();
  for (const SourceInfo& s : m.sources) {
    sources.push_back({{"name", s.name},
                       {"sha256", s.sha256},
                       {"n_cols", s.n_cols},
                       {"n_rows", s.n_rows},
                       {"n_points", s.n_points},
                       {"crs", s.crs},
                       {"operation", s.operation}});
  }
  json levels = json::array();
  for (const LevelInfo& level : m.levels) levels.push_back(level_to_json(level));
  json j = {{"format", "tind"},
            {"format_version", m.format_version},
            {"generator", m.generator},
            {"attribution", m.attribution},
            {"ellipsoid",
             {{"name", m.lattice.ellipsoid.name},
              {"semi_major_m", m.lattice.ellipsoid.semi_major_m},
              {"inverse_flattening", m.lattice.ellipsoid.inverse_flattening}}},
            {"vertical_datum", m.vertical_datum},
            {"heights", m.heights},
            {"vertical_operation", m.vertical_operation},
            {"source_kind", m.source_kind},
            {"resampling", m.resampling},
            {"horizontal_crs", kHorizontalCrs},
            {"root_count_x", kRootCountX},
            {"mode", m.mode},
            {"lattice_level", m.lattice.level},
            {"height_exponent", m.lattice.height_exponent},
            {"bottom_level", m.bottom_level},
            {"base_height_m", m.base_height_m},
            {"falloff_posts", m.falloff_posts},
            {"disagreement_m", m.disagreement_m},
            {"bounds_deg", m.bounds_deg},
            {"spacing_deg", m.spacing_deg},
            {"sources", std::move(sources)},
            {"posts", {{"source", m.n_source_posts}, {"filled", m.n_filled_posts}, {"falloff", m.n_falloff_posts}}},
            {"lines",
             {{"streams", m.lines.streams},
              {"shores", m.lines.shores},
              {"given", m.lines.given},
              {"vertices", m.lines.vertices}}},
            {"options", json::parse(m.options_json)},
            {"content_hash", m.content_hash},
            {"levels", std::move(levels)}};
  if (m.shard_count > 1) {
    j["shard"] = {{"index", m.shard_index}, {"count", m.shard_count}, {"cut_level", m.shard_cut_level}};
  }
  return j.dump(-1, ' ', false, json::error_handler_t::replace);
}

Result<Manifest> decode_manifest(ByteView text) {
  try {
    const json j = json::parse(text.begin(), text.end());
    if (j.at("format").get<std::string>() != "tind") return fail(ErrorKind::kCorrupt, "manifest: not tind's");
    Manifest m;
    m.format_version = whole<int>(j.at("format_version"));
    if (m.format_version != kFormatVersion) {
      return fail(ErrorKind::kUnsupported, "format version " + std::to_string(m.format_version) +
                                               "; this program reads " + std::to_string(kFormatVersion) +
                                               ": build the file anew or update tind");
    }
    m.generator = j.at("generator").get<std::string>();
    m.attribution = j.at("attribution").get<std::string>();
    m.vertical_datum = j.at("vertical_datum").get<std::string>();
    // Files of the first builders lack what came with projected sources, points and lines: they had none.
    m.heights = j.value("heights", m.heights);
    m.vertical_operation = j.value("vertical_operation", m.vertical_operation);
    m.source_kind = j.value("source_kind", m.source_kind);
    m.resampling = j.value("resampling", m.resampling);
    m.mode = j.at("mode").get<std::string>();
    const json& ellipsoid = j.at("ellipsoid");
    m.lattice.ellipsoid.name = ellipsoid.at("name").get<std::string>();
    m.lattice.ellipsoid.semi_major_m = ellipsoid.at("semi_major_m").get<double>();
    m.lattice.ellipsoid.inverse_flattening = ellipsoid.at("inverse_flattening").get<double>();
    m.lattice.level = whole<int>(j.at("lattice_level"));
    m.lattice.height_exponent = whole<int>(j.at("height_exponent"));
    m.bottom_level = whole<int>(j.at("bottom_level"));
    m.base_height_m = j.at("base_height_m").get<double>();
    m.falloff_posts = whole<int>(j.at("falloff_posts"));
    m.disagreement_m = j.at("disagreement_m").get<double>();
    m.bounds_deg = j.at("bounds_deg").get<std::array<double, 4>>();
    m.spacing_deg = j.at("spacing_deg").get<std::array<double, 2>>();
    for (const json& s : j.at("sources")) {
      m.sources.push_back({s.at("name").get<std::string>(), s.at("sha256").get<std::string>(),
                           whole<std::int64_t>(s.at("n_cols")), whole<std::int64_t>(s.at("n_rows")),
                           s.contains("n_points") ? whole<std::uint64_t>(s["n_points"]) : 0, s.value("crs", ""),
                           s.value("operation", "")});
    }
    m.n_source_posts = whole<std::uint64_t>(j.at("posts").at("source"));
    m.n_filled_posts = whole<std::uint64_t>(j.at("posts").at("filled"));
    m.n_falloff_posts = whole<std::uint64_t>(j.at("posts").at("falloff"));
    if (j.contains("lines")) {
      const json& lines = j["lines"];
      m.lines = {whole<std::uint64_t>(lines.at("streams")), whole<std::uint64_t>(lines.at("shores")),
                 whole<std::uint64_t>(lines.at("given")), whole<std::uint64_t>(lines.at("vertices"))};
    }
    m.options_json = j.at("options").dump();
    m.content_hash = j.at("content_hash").get<std::string>();
    if (j.contains("shard")) {
      const json& shard = j["shard"];
      m.shard_index = whole<int>(shard.at("index"));
      m.shard_count = whole<int>(shard.at("count"));
      m.shard_cut_level = whole<int>(shard.at("cut_level"));
      if (m.shard_count < 2 || m.shard_index < 0 || m.shard_index >= m.shard_count || m.shard_cut_level < 0 ||
          m.shard_cut_level > m.bottom_level) {
        return fail(ErrorKind::kCorrupt, "manifest: a shard that cannot be");
      }
    }
    if (whole<int>(j.at("root_count_x")) != kRootCountX || m.bottom_level < 0 || m.lattice.level > kMaxLevel ||
        m.bottom_level > m.lattice.level || m.lattice.height_exponent < 0 || m.lattice.height_exponent > 16 ||
        !(m.lattice.ellipsoid.semi_major_m > 0) || !(m.lattice.ellipsoid.inverse_flattening > 1)) {
      return fail(ErrorKind::kCorrupt, "manifest: a member is out of range");
    }
    const json& levels = j.at("levels");
    if (levels.size() != static_cast<std::size_t>(m.bottom_level) + 1) {
      return fail(ErrorKind::kCorrupt, "manifest: the level table does not end at bottom_level");
    }
    for (const json& level : levels) {
      m.levels.push_back(level_from_json(level, static_cast<int>(m.levels.size())));
    }
    return m;
  } catch (const std::exception& e) {
    // nlohmann reports by exception; this is the one place that turns them into an Error.
    return fail(ErrorKind::kCorrupt, std::string("manifest: ") + e.what());
  }
}

}  // namespace tind
