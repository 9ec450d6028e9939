// SPDX-License-Identifier: GPL-3.0-or-later
// What the bytes of a tile's body cost: encode, pack (zstd), unpack, decode, and append to a file. The bodies are those
// of the deepest level of the .tind file named in the environment variable TIND_BENCH_FILE, one after another.

#include <benchmark/benchmark.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "storage/manifest.hpp"
#include "storage/piece_blob.hpp"
#include "storage/tile_store.hpp"
#include "storage/zstd_codec.hpp"

namespace {

struct Body {
  tind::PieceKey key;
  tind::TileBody body;
  tind::Bytes record, value;
};

// Ends the program with a message: a benchmark without its data measures nothing.
template <class T>
T value_or_exit(tind::Result<T> result) {
  if (result) return std::move(*result);
  std::fprintf(stderr, "bench_pieces: %s\n", result.error().message.c_str());
  std::exit(1);
}

const std::vector<Body>& bodies() {
  static const std::vector<Body> all = [] {
    const char* path = std::getenv("TIND_BENCH_FILE");
    const auto store = value_or_exit(tind::TileStore::open(path ? path : "(TIND_BENCH_FILE is not set)"));
    const auto snapshot = value_or_exit(store.snapshot());
    const auto manifest =
        value_or_exit(tind::decode_manifest(value_or_exit(tind::unpack_value(*snapshot.find_manifest()))));
    const auto level = static_cast<std::uint8_t>(manifest.bottom_level);
    std::vector<Body> out;
    for (const tind::TileRun& run : manifest.levels.back().rows) {
      for (std::uint32_t x = run.x_first; x <= run.x_last; ++x) {
        const tind::PieceKey key{tind::PieceKind::kBody, level, x, run.y};
        Body body{key, {}, value_or_exit(tind::unpack_value(*snapshot.find(key))), {}};
        body.body = value_or_exit(tind::decode_body(body.record));
        body.value = tind::pack_body(body.body);
        out.push_back(std::move(body));
      }
    }
    std::sort(out.begin(), out.end(), [](const Body& a, const Body& b) { return a.key < b.key; });
    return out;
  }();
  return all;
}

// `work(body)` per iteration; bytes are those of the record.
template <class Work>
void each_body(benchmark::State& state, Work work) {
  std::size_t i = 0, n_bytes = 0;
  bodies();
  for (auto _ : state) {
    const Body& body = bodies()[i++ % bodies().size()];
    benchmark::DoNotOptimize(work(body));
    n_bytes += body.record.size();
  }
  state.SetBytesProcessed(static_cast<std::int64_t>(n_bytes));
}

void encode(benchmark::State& state) {
  each_body(state, [](const Body& b) { return tind::encode_body(b.body); });
}
void encode_and_pack(benchmark::State& state) {
  each_body(state, [](const Body& b) { return tind::pack_body(b.body); });
}
void unpack(benchmark::State& state) {
  each_body(state, [](const Body& b) { return tind::unpack_value(b.value); });
}
void decode(benchmark::State& state) {
  each_body(state, [](const Body& b) { return tind::decode_body(b.record); });
}
void unpack_and_decode(benchmark::State& state) {
  each_body(state, [](const Body& b) { return tind::decode_body(*tind::unpack_value(b.value)); });
}
void decode_interior(benchmark::State& state) {
  each_body(state, [](const Body& b) { return tind::decode_interior(b.value); });
}
BENCHMARK(encode);
BENCHMARK(encode_and_pack);
BENCHMARK(unpack);
BENCHMARK(decode);
BENCHMARK(unpack_and_decode);
BENCHMARK(decode_interior);

// Packed bodies go into a new file until the iterations are over; syncing it to disk is not counted.
void append(benchmark::State& state) {
  const std::string path = (std::filesystem::temp_directory_path() / "bench_pieces.tind").string();
  std::filesystem::remove(path);
  std::optional<tind::TileStoreWriter> writer;
  std::size_t i = 0, n_bytes = 0;
  for (auto _ : state) {
    if (i % bodies().size() == 0) {
      state.PauseTiming();
      writer.reset();
      std::filesystem::remove(path);
      writer = value_or_exit(tind::TileStoreWriter::create(path));
      state.ResumeTiming();
    }
    const Body& body = bodies()[i++ % bodies().size()];
    if (const auto done = writer->append(body.key, body.value); !done) {
      state.SkipWithError(done.error().message.c_str());
      break;
    }
    n_bytes += body.value.size();
  }
  writer.reset();
  std::filesystem::remove(path);
  state.SetBytesProcessed(static_cast<std::int64_t>(n_bytes));
}
BENCHMARK(append);

}  // namespace

BENCHMARK_MAIN();
