// SPDX-License-Identifier: GPL-3.0-or-later
#include "test_site.hpp"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>

#include "storage/piece_blob.hpp"
#include "storage/zstd_codec.hpp"

namespace tind::test {
namespace {

std::int32_t height_at(std::int64_t x, std::int64_t y) {
  return static_cast<std::int32_t>(((x >> 7) * 31 + (y >> 7) * 17) % 5000);
}

EdgeChain make_edge(const Lattice& lattice, const PieceKey& key, std::uint32_t n_side) {
  const std::int64_t side = lattice.tile_side(key.level);
  EdgeChain edge;
  for (std::uint32_t k = 1; k <= n_side; ++k) {
    const std::int64_t t = side * k / (n_side + 1);
    const bool horizontal = key.kind == PieceKind::kEdgeH;
    edge.inner.push_back({t, height_at(key.i * side + (horizontal ? t : 0), key.j * side + (horizontal ? 0 : t)),
                          static_cast<std::uint8_t>(key.level == 1 && k % 2 == 0 ? 1 : 0)});
  }
  return edge;
}

TileBody make_body(const Lattice& lattice, const PieceKey& key, std::uint32_t n_side, bool changed,
                   TileCoverage coverage) {
  const std::int64_t side = lattice.tile_side(key.level);
  TileBody body;
  body.stats.coverage = coverage;
  body.stats.max_z = 5000;
  body.n_side = {n_side, n_side, n_side, n_side};
  body.interior = {{side / 2, side / 2, height_at(key.i * side, key.j * side) + (changed ? 777 : 0)}};
  const std::uint32_t n_ring = body.ring_size();
  for (std::uint32_t k = 0; k + 1 < n_ring; ++k) body.triangles.push_back({k, k + 1, n_ring});
  body.triangles.insert(body.triangles.begin() + 1, {0, n_ring, n_ring - 1});
  return body;
}

}  // namespace

TemporaryDirectory::TemporaryDirectory() {
  std::string pattern = (std::filesystem::temp_directory_path() / "tind-test-XXXXXX").string();
  path = mkdtemp(pattern.data());
}
TemporaryDirectory::~TemporaryDirectory() { std::filesystem::remove_all(path); }

void write_pyramid(const std::string& path, std::uint32_t n_side, std::optional<TileKey> changed, int n_levels,
                   const std::function<TileCoverage(const TileKey&)>& coverage) {
  Manifest manifest;
  manifest.generator = "test";
  manifest.attribution = "A & B";
  manifest.vertical_datum = "unknown";
  manifest.mode = "non-standard";
  manifest.lattice.level = n_levels - 1;
  manifest.lattice.height_exponent = 3;
  manifest.bottom_level = n_levels - 1;
  manifest.bounds_deg = {-180, -90, 180, 90};
  manifest.spacing_deg = {1, 1};
  auto writer = TileStoreWriter::create(path);
  ASSERT_TRUE(writer.has_value()) << writer.error().message;
  for (std::uint8_t level = 0; level < n_levels; ++level) {
    std::map<PieceKey, Bytes> pieces;
    LevelInfo info;
    info.level = level;
    info.tolerance_m = 8.0 * (1 << (n_levels - 1 - level));
    info.spacing_m = 20;
    info.height_step_m = 0.25;
    for (std::uint32_t y = 0; y < TileKey::count_y(level); ++y) {
      for (std::uint32_t x = 0; x < TileKey::count_x(level); ++x) {
        const TileCoverage covers = coverage ? coverage({level, x, y}) : TileCoverage::kReal;
        ++info.n_tiles;
        ++(covers == TileCoverage::kReal      ? info.n_real
           : covers == TileCoverage::kPartial ? info.n_partial
                                              : info.n_filler);
        if (x > 0 && info.rows.back().coverage == covers) {
          info.rows.back().x_last = x;
        } else {
          info.rows.push_back({y, x, x, covers});
        }
        for (const PieceKey& key : pieces_of({level, x, y})) {
          const PieceKey canonical = key.canonical();
          pieces[canonical] =
              key.kind == PieceKind::kCorner ? encode_corner({height_at(0, key.j)})
              : key.kind == PieceKind::kBody
                  ? encode_body(make_body(manifest.lattice, key, n_side, changed == TileKey{level, x, y}, covers))
                  : encode_edge(make_edge(manifest.lattice, canonical, n_side));
        }
      }
    }
    manifest.levels.push_back(info);
    for (auto& [key, record] : pieces) {
      const auto appended = writer->append(key, pack_value(std::move(record)));
      ASSERT_TRUE(appended.has_value()) << appended.error().message;
    }
  }
  manifest.content_hash = writer->content_hash();
  const std::string json = encode_manifest(manifest);
  const auto finished = writer->finish(pack_value(Bytes(json.begin(), json.end())));
  ASSERT_TRUE(finished.has_value()) << finished.error().message;
}

std::string write_cesium(const std::string& directory) {
  namespace fs = std::filesystem;
  const std::string root = directory + "/Cesium";
  fs::create_directories(root + "/Widgets");
  std::ofstream(root + "/Cesium.js") << "var Cesium = " << std::string(5000, '0') << ";";
  std::ofstream(root + "/Widgets/a.png") << "not really";
  std::ofstream(root + "/.hidden") << "no";
  std::ofstream(directory + "/secret.txt") << "no";
  fs::create_symlink(directory + "/secret.txt", root + "/link.txt");
  return root;
}

}  // namespace tind::test
