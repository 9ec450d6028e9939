// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client_checks/memory_pyramid.hpp"

#include <fmt/format.h>
#include <gdal_priv.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>

#include "core/format/quantized_mesh.hpp"
#include "core/format/vn.hpp"
#include "core/tessellation.hpp"
#include "storage/builder/build.hpp"
#include "storage/piece_blob.hpp"
#include "storage/zstd_codec.hpp"
#include "tests/support/test_field.hpp"

namespace tind::test {
namespace {

/// A fixture that cannot be made ends the program: no test could mean anything.
template <class T>
T must(Result<T> result, const char* what) {
  if (!result) {
    std::fprintf(stderr, "%s: %s\n", what, result.error().message.c_str());
    std::abort();
  }
  return std::move(*result);
}

client::Blob bytes_of(const std::string& text) { return client::Blob(text.begin(), text.end()); }

Bytes bundle_of(const TileKey& key, const std::array<Bytes, 9>& values) {
  ByteWriter out;
  for (const char c : {'T', 'V', 'P', '1'}) out.fixed(c);
  out.fixed(key.level);
  out.fixed(std::uint8_t{9});
  out.fixed(std::uint16_t{0});
  out.fixed(key.x);
  out.fixed(key.y);
  for (const auto& value : values) out.fixed(static_cast<std::uint32_t>(value.size()));
  for (const auto& value : values) out.raw(value);
  return out.take();
}

}  // namespace

std::string text_of(const TileKey& key) { return fmt::format("{}/{}/{}", key.level, key.x, key.y); }

MemoryPyramid::MemoryPyramid(const std::string& tind_file) : store_(must(TileStore::open(tind_file), "open")) {
  const auto snapshot = must(store_.snapshot(), "snapshot");
  const auto value = snapshot.find_manifest();
  if (!value) std::abort();
  manifest_ = must(decode_manifest(must(unpack_value(*value), "manifest")), "manifest");
}

std::vector<TileKey> MemoryPyramid::tiles(int level) const {
  std::vector<TileKey> keys;
  for (const TileRun& run : manifest_.levels[static_cast<std::size_t>(level)].rows) {
    for (std::uint32_t x = run.x_first; x <= run.x_last; ++x)
      keys.push_back({static_cast<std::uint8_t>(level), x, run.y});
  }
  return keys;
}

Bytes MemoryPyramid::stored(const PieceKey& key) const {
  const auto snapshot = must(store_.snapshot(), "snapshot");
  const auto value = snapshot.find(key);
  return value ? Bytes(value->begin(), value->end()) : Bytes{};
}

TilePieces MemoryPyramid::pieces(const TileKey& key) const {
  const auto keys = pieces_of(key);
  TilePieces pieces;
  for (std::size_t k = 0; k < 9; ++k) {
    const Bytes record = must(unpack_value(stored(keys[k])), "record");
    if (k == 8) {
      pieces.body = must(decode_body(record), "body");
    } else if (k % 2 == 0) {
      pieces.corners[k / 2] = must(decode_corner(record), "corner");
    } else {
      pieces.edges[k / 2] = must(decode_edge(record), "edge");
    }
  }
  return pieces;
}

VirtualNode MemoryPyramid::node(const TileKey& key) const {
  return must(assemble(manifest_.lattice, key, pieces(key)), "assemble");
}

void MemoryPyramid::replace(const std::string& path, Bytes body, int status) {
  const std::string full = "/p/" + path;
  auto answer = make(full);
  replaced_[full] = client::Answer{status, answer ? answer->content_type : "", std::move(body)};
}

void MemoryPyramid::replace_text(const std::string& path, const std::string& text) { replace(path, bytes_of(text)); }

void MemoryPyramid::serve_node(const TileKey& key, const VirtualNode& node) {
  replace(text_of(key) + ".vn", encode_vn(manifest_.lattice, node, manifest_.levels[key.level].tolerance_m));
}

void MemoryPyramid::serve_pieces(const TileKey& key, const TilePieces& pieces) {
  std::array<Bytes, 9> values;
  for (std::size_t b = 0; b < 4; ++b) {
    values[2 * b] = pack_value(encode_corner(pieces.corners[b]));
    values[2 * b + 1] = pack_value(encode_edge(pieces.edges[b]));
  }
  const Bytes body = encode_body(pieces.body);
  values[8] = pack_value(body);
  replace("body/" + text_of(key), body);
  replace(text_of(key) + ".parts", bundle_of(key, values));
  serve_node(key, must(assemble(manifest_.lattice, key, pieces), "assemble"));
}

void MemoryPyramid::serve_manifest(const Manifest& manifest) { replace_text("meta.json", encode_manifest(manifest)); }

Bytes MemoryPyramid::body_of(const std::string& path) {
  auto answer = get("/p/" + path);
  if (!answer) std::abort();
  return answer->body;
}

client::Outcome<client::Answer> MemoryPyramid::get(const std::string& path) {
  const auto it = replaced_.find(path);
  return it != replaced_.end() ? it->second : make(path);
}

Bytes MemoryPyramid::make_terrain(const TileKey& key) const {
  std::set<std::uint64_t> seen = {morton_code(key.x, key.y)};
  std::vector<VirtualNode> neighbours;
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      const std::uint32_t n = TileKey::count_x(key.level);
      const TileKey next{key.level, (key.x + n + static_cast<std::uint32_t>(dx)) % n,
                         key.y + static_cast<std::uint32_t>(dy)};
      if (!next.valid() || !manifest_.has_tile(next) || !seen.insert(morton_code(next.x, next.y)).second) continue;
      neighbours.push_back(node(next));
    }
  }
  QuantizedMeshOptions options;
  options.border_step_m = manifest_.levels[key.level].height_step_m;
  options.normals = true;
  options.neighbours = neighbours;
  return must(encode_quantized_mesh(manifest_.lattice, node(key), options), "terrain");
}

std::string MemoryPyramid::make_codes(const TileKey& key) const {
  const VirtualNode tile = node(key);
  nlohmann::json json = {{"level", key.level}, {"x", key.x}, {"y", key.y}, {"gaps", nlohmann::json::array()}};
  for (int gap = 1; gap <= key.level; ++gap) {
    auto borders = nlohmann::json::array();
    for (const auto& entries : tile.side_entries) {
      const CoarseRuns runs = coarse_runs(entries, key.level - gap);
      borders.push_back(
          {{"runs", runs.runs}, {"starts_inside", runs.starts_inside}, {"ends_inside", runs.ends_inside}});
    }
    json["gaps"].push_back({{"gap", gap}, {"level", key.level - gap}, {"borders", borders}});
  }
  return json.dump();
}

std::string MemoryPyramid::make_layer() const {
  nlohmann::json json = {
      {"tilejson", "2.1.0"}, {"format", "quantized-mesh-1.0"},    {"version", "1"},
      {"scheme", "tms"},     {"projection", "EPSG:4326"},         {"bounds", {-180, -90, 180, 90}},
      {"minzoom", 0},        {"maxzoom", manifest_.bottom_level}, {"tiles", {"{z}/{x}/{y}.terrain?v={version}"}}};
  for (const auto& level : manifest_.levels) {
    auto ranges = nlohmann::json::array();
    for (const TileRun& run : level.rows) {
      ranges.push_back({{"startX", run.x_first}, {"startY", run.y}, {"endX", run.x_last}, {"endY", run.y}});
    }
    json["available"].push_back(ranges);
  }
  return json.dump();
}

client::Outcome<client::Answer> MemoryPyramid::make(const std::string& path) const {
  const auto answer = [](const char* type, Bytes body) { return client::Answer{200, type, std::move(body)}; };
  const client::Answer not_found{404, "text/plain", {}};
  if (path == "/datasets") return answer("application/json", bytes_of(R"({"datasets":[{"name":"p"}]})"));
  if (path == "/p/meta.json") return answer("application/json", bytes_of(encode_manifest(manifest_)));
  if (path == "/p/layer.json") return answer("application/json", bytes_of(make_layer()));
  unsigned level = 0, x = 0, y = 0;
  char suffix[64] = "", direction = 0;
  const char* text = path.c_str();
  if (std::sscanf(text, "/p/%u/%u/%u.%63s", &level, &x, &y, suffix) == 4) {
    const TileKey key{static_cast<std::uint8_t>(level), x, y};
    if (level > static_cast<unsigned>(manifest_.bottom_level) || !key.valid() || !manifest_.has_tile(key))
      return not_found;
    const std::string kind(suffix);
    if (kind == "vn") {
      return answer("application/vnd.tind.vn",
                    encode_vn(manifest_.lattice, node(key), manifest_.levels[level].tolerance_m));
    }
    if (kind == "parts") {
      std::array<Bytes, 9> values;
      const auto keys = pieces_of(key);
      for (std::size_t k = 0; k < 9; ++k) values[k] = stored(keys[k]);
      return answer("application/vnd.tind.parts", bundle_of(key, values));
    }
    if (kind.rfind("terrain", 0) == 0) return answer("application/vnd.quantized-mesh", make_terrain(key));
    return not_found;
  }
  if (std::sscanf(text, "/p/codes/%u/%u/%u", &level, &x, &y) == 3) {
    return answer("application/json", bytes_of(make_codes({static_cast<std::uint8_t>(level), x, y})));
  }
  PieceKey piece;
  if (std::sscanf(text, "/p/corner/%u/%u/%u", &level, &x, &y) == 3) {
    piece = {PieceKind::kCorner, static_cast<std::uint8_t>(level), x, y};
  } else if (std::sscanf(text, "/p/edge/%u/%c/%u/%u", &level, &direction, &x, &y) == 4) {
    piece = {direction == 'h' ? PieceKind::kEdgeH : PieceKind::kEdgeV, static_cast<std::uint8_t>(level), x, y};
  } else if (std::sscanf(text, "/p/body/%u/%u/%u", &level, &x, &y) == 3) {
    piece = {PieceKind::kBody, static_cast<std::uint8_t>(level), x, y};
  } else {
    return not_found;
  }
  if (!piece.valid()) return not_found;
  const Bytes value = stored(piece);
  if (value.empty()) return not_found;
  return answer("application/vnd.tind.piece", must(unpack_value(value), "piece"));
}

const SmallWorld& small_world() {
  static const SmallWorld world = [] {
    const auto folder = std::filesystem::temp_directory_path() / fmt::format("tind-client-{}", getpid());
    std::filesystem::create_directories(folder);
    SmallWorld made{(folder / "world.tif").string(), (folder / "world.tind").string()};
    constexpr int kColumns = 400, kRows = 300;
    constexpr double kSpacing = 0.02;
    GDALAllRegister();
    GDALDriver* driver = GetGDALDriverManager()->GetDriverByName("GTiff");
    GDALDataset* dataset = driver->Create(made.raster.c_str(), kColumns, kRows, 1, GDT_Int16, nullptr);
    // From 176 degrees east across longitude 180 to 184, that is -176. Posts are at whole multiples of the spacing.
    double transform[6] = {176 - kSpacing / 2, kSpacing, 0, 46 + kSpacing / 2, 0, -kSpacing};
    dataset->SetGeoTransform(transform);
    dataset->SetProjection(SRS_WKT_WGS84_LAT_LONG);
    const HeightAt height = rough_terrain(7, 900);
    std::vector<std::int16_t> row(kColumns);
    for (int r = 0; r < kRows; ++r) {
      for (int c = 0; c < kColumns; ++c)
        row[static_cast<std::size_t>(c)] = static_cast<std::int16_t>(std::lround(height(r, c)));
      if (dataset->GetRasterBand(1)->RasterIO(GF_Write, 0, r, kColumns, 1, row.data(), kColumns, 1, GDT_Int16, 0, 0) !=
          CE_None) {
        std::abort();
      }
    }
    GDALClose(dataset);
    BuildOptions options;
    options.source.inputs = {made.raster};
    options.output = made.tind;
    options.levels.tolerance_m = 80;
    options.falloff_posts = 16;
    options.threads = 2;
    Progress silent(nullptr);
    must(build_pyramid(options, silent), "build");
    std::atexit([] {
      std::error_code ignored;
      std::filesystem::remove_all(std::filesystem::temp_directory_path() / fmt::format("tind-client-{}", getpid()),
                                  ignored);
    });
    return made;
  }();
  return world;
}

}  // namespace tind::test
