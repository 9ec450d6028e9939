// SPDX-License-Identifier: GPL-3.0-or-later
// Cutting break lines at each other (docs/decisions/0009-break-lines.md): lines that all cross, and lines that nothing
// touches.

#include <benchmark/benchmark.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "storage/readers/noding.hpp"

namespace {

using tind::BreakVertex;
using tind::LatticeLine;

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

BreakVertex vertex(double x, double y) { return {std::llround(x), std::llround(y), kNone}; }

/// `n` segments of random place and direction; each crosses about 1.4 others.
std::vector<LatticeLine> segments(int n) {
  constexpr double kSize = 1e8;
  std::mt19937_64 random(1);
  const auto uniform = [&] { return std::ldexp(static_cast<double>(random() >> 11), -53); };
  const double length = 1.5 * kSize / std::sqrt(n);
  std::vector<LatticeLine> out;
  for (int i = 0; i < n; ++i) {
    const double x = uniform() * kSize, y = uniform() * kSize, angle = uniform() * 2 * std::numbers::pi;
    out.push_back({vertex(x, y), vertex(x + length * std::cos(angle), y + length * std::sin(angle))});
  }
  return out;
}

/// Rings of 1000 vertices side by side, `n` vertices in all.
std::vector<LatticeLine> rings(int n) {
  constexpr double kRadius = 50'000;
  std::vector<LatticeLine> out;
  for (int i = 0; i < n / 1000; ++i) {
    LatticeLine& ring = out.emplace_back();
    for (int j = 0; j <= 1000; ++j) {
      const double angle = j % 1000 * 2 * std::numbers::pi / 1000;
      ring.push_back(vertex((i % 100 * 2.5 + std::cos(angle)) * kRadius, (i / 100 * 2.5 + std::sin(angle)) * kRadius));
    }
  }
  return out;
}

void node(benchmark::State& state, const std::vector<LatticeLine>& lines) {
  std::size_t n_pieces = 0;
  for (auto _ : state) {
    const auto noded = tind::node_lines(lines);
    if (!noded) return state.SkipWithError(noded.error().message.c_str());
    n_pieces = noded->pieces.size();
  }
  state.counters["pieces"] = static_cast<double>(n_pieces);
}

void crossing_segments(benchmark::State& state) { node(state, segments(static_cast<int>(state.range(0)))); }
void lone_rings(benchmark::State& state) { node(state, rings(static_cast<int>(state.range(0)))); }

BENCHMARK(crossing_segments)->Arg(10'000)->Arg(100'000)->Unit(benchmark::kMillisecond);
BENCHMARK(lone_rings)->Arg(100'000)->Arg(1'000'000)->Unit(benchmark::kMillisecond);

}  // namespace

BENCHMARK_MAIN();
