// SPDX-License-Identifier: GPL-3.0-or-later
// What one tile costs to read, put together and encode: every tile of the bottom level of the .tind file named in the
// environment variable TIND_BENCH_FILE, one after another.

#include <benchmark/benchmark.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "core/assembler.hpp"
#include "core/format/quantized_mesh.hpp"
#include "core/format/vn.hpp"
#include "storage/manifest.hpp"
#include "storage/piece_blob.hpp"
#include "storage/tile_store.hpp"
#include "storage/zstd_codec.hpp"

namespace {

struct Dataset {
  tind::TileStore store;
  tind::Manifest manifest;
  std::vector<tind::TileKey> tiles;
};

// Ends the program with a message: a benchmark without its data measures nothing.
template <class T>
T value_or_exit(tind::Result<T> result) {
  if (result) return std::move(*result);
  std::fprintf(stderr, "bench_tiles: %s\n", result.error().message.c_str());
  std::exit(1);
}

const Dataset& dataset() {
  static const Dataset data = [] {
    const char* path = std::getenv("TIND_BENCH_FILE");
    auto store = value_or_exit(tind::TileStore::open(path ? path : "(TIND_BENCH_FILE is not set)"));
    const auto snapshot = value_or_exit(store.snapshot());
    const auto json = value_or_exit(tind::unpack_value(*snapshot.find_manifest()));
    auto manifest = value_or_exit(tind::decode_manifest(json));
    std::vector<tind::TileKey> tiles;
    for (const tind::TileRun& run : manifest.levels.back().rows) {
      for (std::uint32_t x = run.x_first; x <= run.x_last; ++x) {
        tiles.push_back({static_cast<std::uint8_t>(manifest.bottom_level), x, run.y});
      }
    }
    return Dataset{std::move(store), std::move(manifest), std::move(tiles)};
  }();
  return data;
}

tind::VirtualNode read_tile(const tind::TileStore::Snapshot& snapshot, const tind::TileKey& key) {
  const auto record = [&](const tind::PieceKey& piece) {
    return value_or_exit(tind::unpack_value(*snapshot.find(piece)));
  };
  const auto pieces = tind::pieces_of(key);
  tind::TilePieces parts;
  for (std::size_t b = 0; b < 4; ++b) {
    parts.corners[b] = value_or_exit(tind::decode_corner(record(pieces[2 * b])));
    parts.edges[b] = value_or_exit(tind::decode_edge(record(pieces[2 * b + 1])));
  }
  parts.body = value_or_exit(tind::decode_body(record(pieces[8])));
  return value_or_exit(tind::assemble(dataset().manifest.lattice, key, std::move(parts)));
}

void find_nine_pieces(benchmark::State& state) {
  const auto snapshot = value_or_exit(dataset().store.snapshot());
  std::size_t i = 0;
  for (auto _ : state) {
    for (const auto& piece : tind::pieces_of(dataset().tiles[i++ % dataset().tiles.size()])) {
      benchmark::DoNotOptimize(snapshot.find(piece));
    }
  }
}
BENCHMARK(find_nine_pieces);

void assemble_tile(benchmark::State& state) {
  const auto snapshot = value_or_exit(dataset().store.snapshot());
  std::size_t i = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(read_tile(snapshot, dataset().tiles[i++ % dataset().tiles.size()]));
  }
}
BENCHMARK(assemble_tile);

template <class Encode>
void encode_tiles(benchmark::State& state, Encode encode) {
  const auto snapshot = value_or_exit(dataset().store.snapshot());
  std::vector<tind::VirtualNode> nodes;
  for (const auto& key : dataset().tiles) nodes.push_back(read_tile(snapshot, key));
  std::size_t i = 0, bytes = 0;
  for (auto _ : state) bytes += encode(nodes[i++ % nodes.size()]);
  state.SetBytesProcessed(static_cast<std::int64_t>(bytes));
}

void encode_vn_tile(benchmark::State& state) {
  encode_tiles(state, [](const tind::VirtualNode& node) {
    return tind::encode_vn(dataset().manifest.lattice, node, dataset().manifest.levels.back().tolerance_m).size();
  });
}
BENCHMARK(encode_vn_tile);

void encode_quantized_mesh_tile(benchmark::State& state) {
  encode_tiles(state, [](const tind::VirtualNode& node) {
    tind::QuantizedMeshOptions options;
    options.border_step_m = dataset().manifest.levels.back().height_step_m;
    return value_or_exit(tind::encode_quantized_mesh(dataset().manifest.lattice, node, options)).size();
  });
}
BENCHMARK(encode_quantized_mesh_tile);

}  // namespace

BENCHMARK_MAIN();
