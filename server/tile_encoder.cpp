// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/tile_encoder.hpp"

#include <array>
#include <bit>
#include <nlohmann/json.hpp>

#include "core/format/quantized_mesh.hpp"
#include "core/format/vn.hpp"
#include "core/tessellation.hpp"
#include "storage/value_hash.hpp"

#ifndef TIND_VERSION
#error "the build gives TIND_VERSION"
#endif

namespace tind {
namespace {

// Crack-tessellation codes against each coarser level.
Bytes encode_codes(const TileKey& key, const VirtualNode& node) {
  using nlohmann::ordered_json;
  ordered_json gaps = ordered_json::array();
  for (int gap = 1; gap <= key.level; ++gap) {
    ordered_json borders = ordered_json::array();
    for (const auto& entries : node.side_entries) {
      const CoarseRuns runs = coarse_runs(entries, key.level - gap);
      borders.push_back(
          {{"runs", runs.runs}, {"starts_inside", runs.starts_inside}, {"ends_inside", runs.ends_inside}});
    }
    gaps.push_back({{"gap", gap}, {"level", key.level - gap}, {"borders", std::move(borders)}});
  }
  const ordered_json all = {{"level", key.level}, {"x", key.x}, {"y", key.y}, {"gaps", std::move(gaps)}};
  const std::string text = all.dump();
  return {text.begin(), text.end()};
}

}  // namespace

Result<Bytes> encode_tile(const Dataset& dataset, const TileStore::Snapshot& snapshot, const TileKey& key,
                          EncodedFormat format) {
  auto node = load_tile(dataset, snapshot, key);
  if (!node) return tl::unexpected(node.error());
  if (!*node || key.level >= dataset.manifest.levels.size()) {
    return fail(ErrorKind::kCorrupt, dataset.name + ": a tile that the manifest does not know");
  }
  const LevelInfo& level = dataset.manifest.levels[key.level];
  const Lattice& lattice = dataset.manifest.lattice;
  if (format == EncodedFormat::kVn) return encode_vn(lattice, **node, level.tolerance_m);
  if (format == EncodedFormat::kCodes) return encode_codes(key, **node);
  const bool normals = format == EncodedFormat::kTerrainWithNormals;
  std::vector<VirtualNode> neighbours;
  if (normals) {
    auto loaded = load_neighbours(dataset, snapshot, key);
    if (!loaded) return tl::unexpected(loaded.error());
    neighbours = std::move(*loaded);
  }
  return encode_quantized_mesh(lattice, **node, {level.height_step_m, normals, neighbours});
}

std::uint64_t encoding_fingerprint(const Dataset& dataset, const TileKey& key) {
  static const std::uint64_t version = [] {
    const std::string_view text = TIND_VERSION;
    return value_hash({reinterpret_cast<const std::uint8_t*>(text.data()), text.size()});
  }();
  const Manifest& manifest = dataset.manifest;
  const bool known = key.level < manifest.levels.size();
  const Ellipsoid& ellipsoid = manifest.lattice.ellipsoid;
  const std::array<std::uint64_t, 7> parts = {
      version,
      std::bit_cast<std::uint64_t>(ellipsoid.semi_major_m),
      std::bit_cast<std::uint64_t>(ellipsoid.inverse_flattening),
      static_cast<std::uint64_t>(manifest.lattice.level),
      static_cast<std::uint64_t>(manifest.lattice.height_exponent),
      known ? std::bit_cast<std::uint64_t>(manifest.levels[key.level].tolerance_m) : 0,
      known ? std::bit_cast<std::uint64_t>(manifest.levels[key.level].height_step_m) : 0};
  return value_hash({reinterpret_cast<const std::uint8_t*>(parts.data()), sizeof parts});
}

}  // namespace tind
