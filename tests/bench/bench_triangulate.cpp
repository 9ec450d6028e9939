// SPDX-License-Identifier: GPL-3.0-or-later
// The parts of refining one tile of 512 x 512 posts of made-up mountains: scanning its posts, inserting vertices that
// are known beforehand, greedy insertion as a whole.

#include <benchmark/benchmark.h>

#include "core/triangulator.hpp"
#include "tests/support/test_field.hpp"
#include "tests/support/test_tile.hpp"

namespace {

constexpr tind::TileKey kTile{5, 20, 13};
constexpr double kSpacing = 512.3;  // lattice steps; a tile of level 5 has 2^18 a side
constexpr double kToleranceM = 20;

const tind::test::TestField& mountains() {
  static const tind::test::TestField field(tind::test::place_over(5, 20, 13, 7, kSpacing, 3),
                                           tind::test::rough_terrain(8, 1500));
  return field;
}

/// The tile refined to `tolerance_m`; borders are those of kToleranceM, so that they stay the same.
tind::TileTask task_of(double tolerance_m) {
  const auto spec = tind::test::spec_from(5, kToleranceM, 2, mountains().field.lattice);
  tind::TileTask task = tind::test::make_task(mountains().field, spec, kTile).task;
  task.tolerance_m = tolerance_m;
  return task;
}

void triangulate(benchmark::State& state, const tind::TileTask& task) {
  tind::TileSurface surface;
  for (auto _ : state) surface = tind::triangulate(mountains().field, task);
  state.counters["posts"] = static_cast<double>(surface.stats.n_posts);
  state.counters["vertices"] = static_cast<double>(surface.interior.size());
  state.counters["ns_per_post"] =
      benchmark::Counter(static_cast<double>(surface.stats.n_posts) * 1e-9,
                         benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

// Border vertices only, and a tolerance that all posts meet: what is left is looking at them.
void scan(benchmark::State& state) { triangulate(state, task_of(1e5)); }
// The vertices of the refined tile given at once: like scan, and their insertion.
void insert(benchmark::State& state) {
  tind::TileTask task = task_of(kToleranceM);
  task.initial = tind::triangulate(mountains().field, task).interior;
  task.tolerance_m = 1e5;
  triangulate(state, task);
}
void refine(benchmark::State& state) { triangulate(state, task_of(kToleranceM)); }

BENCHMARK(scan)->Unit(benchmark::kMillisecond);
BENCHMARK(insert)->Unit(benchmark::kMillisecond);
BENCHMARK(refine)->Unit(benchmark::kMillisecond);

}  // namespace

BENCHMARK_MAIN();
