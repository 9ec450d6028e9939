// SPDX-License-Identifier: GPL-3.0-or-later
// What the daemon does for a request besides the kernel's part: parsing, finding a tile's nine pieces three ways,
// answering out of the cache, and making a tile's encodings. Tiles are those of the .tind file named in the environment
// variable TIND_BENCH_FILE, in an order that has nothing to do with where they lie (docs/decisions/0014-serving.md).

#include <benchmark/benchmark.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <string>
#include <vector>

#include "server/catalog.hpp"
#include "server/content_coding.hpp"
#include "server/handler.hpp"
#include "server/request_parser.hpp"
#include "server/write_batch.hpp"
#include "storage/value_hash.hpp"

namespace {

constexpr const char* kRequest =
    "GET /x/12/1234/567.terrain?v=0123456789abcdef HTTP/1.1\r\nHost: tiles.example.org\r\n"
    "User-Agent: Mozilla/5.0 (X11; Linux x86_64)\r\nAccept-Encoding: gzip, deflate, br, zstd\r\n"
    "Accept: application/vnd.quantized-mesh;extensions=octvertexnormals,application/octet-stream;q=0.9,*/*;q=0.01\r\n"
    "Referer: https://globe.example.org/\r\nConnection: keep-alive\r\n\r\n";

struct World {
  tind::Settings settings;
  std::unique_ptr<tind::Catalog> catalog;
  std::unique_ptr<tind::WorkerState> state;
  const tind::ServedDataset* served = nullptr;
  std::vector<tind::TileKey> tiles;
  std::vector<std::string> targets;  // by tile, without suffix

  World() {
    const char* path = std::getenv("TIND_BENCH_FILE");
    settings.datasets = {path ? path : "(TIND_BENCH_FILE is not set)"};
    auto opened = tind::Catalog::open(settings);
    if (!opened) {
      std::fprintf(stderr, "bench_serving: %s\n", opened.error().message.c_str());
      std::exit(1);
    }
    catalog = std::move(*opened);
    state = std::make_unique<tind::WorkerState>(catalog->holder());
    const std::string name = state->site().slots.front()->source().name;
    served = *state->dataset(name);
    for (const tind::LevelInfo& level : served->dataset->manifest.levels) {
      for (const tind::TileRun& run : level.rows) {
        for (std::uint32_t x = run.x_first; x <= run.x_last; ++x) {
          tiles.push_back({static_cast<std::uint8_t>(level.level), x, run.y});
        }
      }
    }
    std::shuffle(tiles.begin(), tiles.end(), std::mt19937(1));
    for (const tind::TileKey& t : tiles) {
      std::string target("/");
      target.append(name).append("/").append(std::to_string(t.level)).append("/").append(std::to_string(t.x));
      targets.push_back(target.append("/").append(std::to_string(t.y)));
    }
  }
  const tind::TileStore::Snapshot& snapshot() { return **state->snapshot(served->dataset); }
};

World& world() {
  static World it;
  return it;
}

void parse_request(benchmark::State& state) {
  tind::FieldScratch scratch;
  for (auto _ : state) {
    auto parsed = tind::parse_request(kRequest, scratch);
    benchmark::DoNotOptimize(parsed);
  }
}
BENCHMARK(parse_request);

void nine_gets(benchmark::State& state) {
  World& w = world();
  std::size_t k = 0;
  for (auto _ : state) {
    for (const tind::PieceKey& key : tind::pieces_of(w.tiles[k++ % w.tiles.size()])) {
      benchmark::DoNotOptimize(w.snapshot().find(key));
    }
  }
}
BENCHMARK(nine_gets);

void find_tile(benchmark::State& state) {
  World& w = world();
  std::array<tind::ByteView, 9> values;
  std::size_t k = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(w.snapshot().find_tile(w.tiles[k++ % w.tiles.size()], values));
  }
}
BENCHMARK(find_tile);

void resolve_from_table(benchmark::State& state) {
  World& w = world();
  for (const tind::TileKey& key : w.tiles) (void)w.state->resolve(w.served->dataset, key);
  std::size_t k = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(w.state->resolve(w.served->dataset, w.tiles[k++ % w.tiles.size()]));
  }
}
BENCHMARK(resolve_from_table);

void hash_pieces(benchmark::State& state) {
  World& w = world();
  std::array<tind::ByteView, 9> values;
  std::size_t k = 0;
  for (auto _ : state) {
    w.snapshot().find_tile(w.tiles[k++ % w.tiles.size()], values);
    for (const tind::ByteView value : values) benchmark::DoNotOptimize(tind::value_hash(value));
  }
}
BENCHMARK(hash_pieces);

// From the bytes of a request to the buffers of a write.
void answer(benchmark::State& state, const char* suffix, const char* coding) {
  World& w = world();
  tind::Handler handler(w.settings);
  tind::FieldScratch scratch;
  tind::Response response;
  tind::WriteBatch batch;
  std::vector<std::string> requests;
  for (const std::string& target : w.targets) {
    std::string request = "GET ";
    request.append(target).append(suffix).append(" HTTP/1.1\r\nHost: localhost\r\n");
    if (coding[0] != '\0') request.append("Accept-Encoding: ").append(coding).append("\r\n");
    requests.push_back(request.append("\r\n"));
  }
  const auto ask = [&](const std::string& bytes) {
    const auto parsed = tind::parse_request(bytes, scratch);
    handler.handle(std::get<tind::ParsedRequest>(parsed).request, *w.state, response);
    batch.add(response, "Server: tind\r\nDate: Sun, 06 Nov 1994 08:49:37 GMT\r\n", true);
    benchmark::DoNotOptimize(batch.buffers());
    batch.clear();
  };
  for (const std::string& request : requests) ask(request);
  std::size_t k = 0;
  for (auto _ : state) ask(requests[k++ % requests.size()]);
}
BENCHMARK_CAPTURE(answer, terrain_gzip, ".terrain", "gzip");
BENCHMARK_CAPTURE(answer, vn_zstd, ".vn", "zstd");
BENCHMARK_CAPTURE(answer, parts, ".parts", "");

// What an answer costs whose tile nobody asked for before, and how long it is beside the stored pieces.
void make(benchmark::State& state, tind::EncodedFormat format, tind::Coding coding) {
  World& w = world();
  std::size_t k = 0, n_bytes = 0, n_stored = 0;
  for (auto _ : state) {
    const tind::TileKey& key = w.tiles[k++ % w.tiles.size()];
    auto bytes = tind::encode_tile(*w.served->dataset, w.snapshot(), key, format);
    if (!bytes) return state.SkipWithError(bytes.error().message.c_str());
    n_bytes += tind::apply_coding(std::move(*bytes), coding).bytes.size();
    std::array<tind::ByteView, 9> values;
    w.snapshot().find_tile(key, values);
    for (const tind::ByteView value : values) n_stored += value.size();
  }
  const auto n = static_cast<double>(std::max<std::size_t>(k, 1));
  state.counters["bytes"] = static_cast<double>(n_bytes) / n;
  state.counters["stored"] = static_cast<double>(n_stored) / n;
}
BENCHMARK_CAPTURE(make, terrain, tind::EncodedFormat::kTerrain, tind::Coding::kIdentity)->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(make, terrain_gzip, tind::EncodedFormat::kTerrain, tind::Coding::kGzip)
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(make, terrain_zstd, tind::EncodedFormat::kTerrain, tind::Coding::kZstd)
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(make, normals_gzip, tind::EncodedFormat::kTerrainWithNormals, tind::Coding::kGzip)
    ->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(make, vn_zstd, tind::EncodedFormat::kVn, tind::Coding::kZstd)->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(make, vn_gzip, tind::EncodedFormat::kVn, tind::Coding::kGzip)->Unit(benchmark::kMicrosecond);

}  // namespace

BENCHMARK_MAIN();
