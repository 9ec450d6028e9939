// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/report/stream_quality.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/drainage/flow.hpp"
#include "core/drainage/water.hpp"

namespace tind {
namespace {

constexpr std::uint8_t kNoStream = kVoid | kSea | kLake | kBasin;

}  // namespace

StreamQuality::StreamQuality(const SourceGrid& source, const DrainageOptions& options, double buffer_cells,
                             ScratchMap map)
    : source_(source), options_(options), buffer_cells_(buffer_cells), map_(std::move(map)) {
  const HeightField& field = source.field();
  const std::int64_t n = field.n_rows * field.n_cols;
  cells_ = static_cast<std::uint64_t*>(map_.data());
  surface_m_ = reinterpret_cast<float*>(cells_ + n);
  filled_m_ = surface_m_ + n;
  marks_ = reinterpret_cast<std::uint8_t*>(filled_m_ + n);
  directions_ = marks_ + n;
}

Result<StreamQuality> StreamQuality::make(const SourceGrid& source, const DrainageOptions& options,
                                          const std::vector<int>& levels, double buffer_cells,
                                          const std::string& scratch_dir) {
  const HeightField& field = source.field();
  constexpr std::uint64_t kBytesPerPost = 8 + 2 * sizeof(float) + 2;
  const auto n = static_cast<std::uint64_t>(field.n_rows) * static_cast<std::uint64_t>(field.n_cols);
  auto map = ScratchMap::create(scratch_dir, n * kBytesPerPost);
  if (!map) return tl::unexpected(map.error());
  StreamQuality q(source, options, buffer_cells, std::move(*map));
  std::copy_n(field.heights_m, n, q.surface_m_);
  q.grid_ = make_flow_grid(field, q.marks_);
  q.grid_.heights_m = q.surface_m_;
  mark_sea(q.grid_, options.sea_level_m);
  mark_lakes(q.grid_, options.lake_area_m2, options.sea_level_m.value_or(0));
  mark_outlets(q.grid_);
  fill_depressions(q.grid_, options.block_side, q.filled_m_);
  mark_basins(q.grid_, q.filled_m_, 2 * options.max_change_m, options.lake_area_m2);
  q.drain();
  for (const int level : levels) q.reference_[level] = q.streams(level);
  return q;
}

double StreamQuality::threshold_cells(int level) const {
  return static_cast<double>(options_.cells) * std::pow(options_.growth, options_.bottom_level - level);
}

void StreamQuality::drain() {
  fill_depressions(grid_, options_.block_side, filled_m_);
  direct_flow(grid_, options_.block_side, filled_m_, reinterpret_cast<FlatSteps*>(cells_), directions_);
  accumulate_flow(grid_, options_.block_side, directions_, cells_);
}

std::vector<StreamPost> StreamQuality::streams(int level) const {
  const double least = threshold_cells(level) * static_cast<double>(kCell);
  std::vector<std::uint8_t> mask(static_cast<std::size_t>(grid_.size()));
  for (std::int64_t i = 0; i < grid_.size(); ++i) {
    mask[static_cast<std::size_t>(i)] =
        (marks_[i] & kInside) && !(marks_[i] & kNoStream) && static_cast<double>(cells_[i]) >= least;
  }
  return stream_posts(grid_.n_rows, grid_.n_cols, mask.data(), directions_);
}

StreamMatch StreamQuality::match(int level) {
  drain();
  return compare_streams(grid_.n_rows, grid_.n_cols, streams(level), reference_.at(level), buffer_cells_);
}

}  // namespace tind
