// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/drainage/flow.hpp"

namespace tind {

Flow flow_of(const float* heights_m, std::int64_t n_rows, std::int64_t n_cols, double east_m, double north_m) {
  Flow flow;
  flow.n_rows = n_rows;
  flow.n_cols = n_cols;
  const auto n = static_cast<std::size_t>(n_rows * n_cols);
  std::vector<std::uint8_t> marks(n);
  const FlowGrid g = make_flow_grid(heights_m, n_rows, n_cols, east_m, north_m, marks.data());
  mark_outlets(g);
  flow.filled_m.resize(n);
  fill_depressions(g, kBlockSide, flow.filled_m.data());
  flow.directions.resize(n);
  {
    std::vector<FlatSteps> steps(n);
    direct_flow(g, kBlockSide, flow.filled_m.data(), steps.data(), flow.directions.data());
  }
  std::vector<std::uint64_t> accumulation(n);
  accumulate_flow(g, kBlockSide, flow.directions.data(), accumulation.data());
  flow.cells.resize(n);
  flow.in_flat.resize(n);
  flow.raised.resize(n);
  for (std::size_t i = 0; i < n; ++i) {
    flow.cells[i] = static_cast<double>(accumulation[i]) / double{kCell};
    flow.in_flat[i] = marks[i] & kInFlat ? 1 : 0;
    flow.raised[i] = (marks[i] & kInside) && flow.filled_m[i] > heights_m[i] ? 1 : 0;
  }
  return flow;
}

std::vector<std::uint8_t> channel_mask(const Flow& flow, double min_cells) {
  std::vector<std::uint8_t> mask(flow.cells.size());
  for (std::size_t i = 0; i < mask.size(); ++i) mask[i] = flow.cells[i] > 0 && flow.cells[i] >= min_cells ? 1 : 0;
  return mask;
}

}  // namespace tind
