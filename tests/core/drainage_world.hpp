// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "core/drainage/drainage.hpp"
#include "tests/support/test_field.hpp"

namespace tind::test {

inline constexpr float kNone = std::numeric_limits<float>::quiet_NaN();  ///< No post here.

/// A plain grid with all that flows over it. Rows are written as on a map: the northernmost first.
struct FlowWorld {
  std::int64_t n_rows = 0, n_cols = 0;
  std::vector<float> heights_m, filled_m;
  std::vector<std::uint8_t> marks, directions;
  std::vector<FlatSteps> steps;
  std::vector<std::uint64_t> accumulation;
  FlowGrid grid;

  explicit FlowWorld(const std::vector<std::vector<float>>& map, double east_m = 1, double north_m = 1)
      : n_rows(static_cast<std::int64_t>(map.size())), n_cols(static_cast<std::int64_t>(map[0].size())) {
    for (auto row = map.rbegin(); row != map.rend(); ++row) heights_m.insert(heights_m.end(), row->begin(), row->end());
    marks.resize(heights_m.size());
    grid = make_flow_grid(heights_m.data(), n_rows, n_cols, east_m, north_m, marks.data());
  }
  FlowWorld(const FlowWorld&) = delete;

  void run(std::int64_t block_side = kBlockSide, int threads = 1) {
    const FlowRun run{threads, nullptr, {}};
    mark_outlets(grid, run);
    filled_m.resize(heights_m.size());
    steps.resize(heights_m.size());
    directions.resize(heights_m.size());
    accumulation.resize(heights_m.size());
    fill_depressions(grid, block_side, filled_m.data(), run);
    direct_flow(grid, block_side, filled_m.data(), steps.data(), directions.data(), run);
    accumulate_flow(grid, block_side, directions.data(), accumulation.data(), run);
  }
  /// Index of a post by its place on the map.
  std::size_t at(std::int64_t map_row, std::int64_t col) const {
    return static_cast<std::size_t>((n_rows - 1 - map_row) * n_cols + col);
  }
  std::int64_t downstream(std::int64_t i) const {
    const int d = directions[static_cast<std::size_t>(i)];
    return d < 8 ? grid.neighbour(i / n_cols, i % n_cols, d) : -1;
  }
};

/// A height field of posts on whole lattice points about the equator, some 300 m apart; `height(row, col)` counts rows
/// from the south.
inline TestField equator_field(std::int64_t n_rows, std::int64_t n_cols, const HeightAt& height) {
  GridPlace place;
  place.lattice_level = 8;
  place.n_rows = n_rows;
  place.n_cols = n_cols;
  place.x0 = 5000;
  place.y0 = 128 * 65536.0 - static_cast<double>(n_rows / 2) * 256;
  return TestField(place, height);
}

/// Drainage with scratch of its own.
inline Result<Drainage> drain(const HeightField& field, const DrainageOptions& options) {
  std::vector<std::vector<double>> memory;
  return derive_drainage(field, options, [&](std::size_t n_bytes) -> void* {
    memory.emplace_back(n_bytes / sizeof(double) + 1, -1.5e300);  // contents must not matter
    return memory.back().data();
  });
}

inline DrainageOptions options(std::int64_t cells, int bottom_level = 4) {
  DrainageOptions o;
  o.cells = cells;
  o.bottom_level = bottom_level;
  o.max_change_m = 10;
  return o;
}

/// Post (row, col) of a vertex.
inline std::pair<std::int64_t, std::int64_t> post_of(const HeightField& f, const BreakVertex& v) {
  return {std::llround((static_cast<double>(v.y) - f.y0) / f.dy),
          std::llround((static_cast<double>(v.x) - f.x0) / f.dx)};
}

/// A valley along column `centre`, running south at 1 m a post, with sides of 20 m a post.
inline double valley(std::int64_t r, std::int64_t c, std::int64_t centre) {
  return static_cast<double>(r) + 20 * static_cast<double>(std::abs(c - centre)) + 100;
}

/// All chains keep the rules of break lines: no two equal neighbours, and shared vertices only at ends.
inline void expect_nodes_only(const Drainage& d) {
  std::map<std::pair<std::int64_t, std::int64_t>, int> inner, ends;
  for (const auto* chains : {&d.streams, &d.shores}) {
    for (const BreakChain& chain : *chains) {
      ASSERT_GE(chain.vertices.size(), 2u);
      for (std::size_t k = 0; k < chain.vertices.size(); ++k) {
        const BreakVertex& v = chain.vertices[k];
        if (k > 0) {
          ASSERT_FALSE(v.x == chain.vertices[k - 1].x && v.y == chain.vertices[k - 1].y);
        }
        ++(k == 0 || k + 1 == chain.vertices.size() ? ends : inner)[{v.x, v.y}];
      }
    }
  }
  for (const auto& [at, n] : inner) {
    ASSERT_EQ(n, 1) << at.first << " " << at.second;
    ASSERT_FALSE(ends.contains(at)) << at.first << " " << at.second;
  }
}

}  // namespace tind::test
