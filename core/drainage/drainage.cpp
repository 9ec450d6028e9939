// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/drainage/drainage.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "core/drainage/stream_links.hpp"
#include "core/drainage/water.hpp"

namespace tind {
namespace {

/// Smallest accumulation of a stream per level, in 1 / kCell cells.
std::vector<std::uint64_t> level_thresholds(const DrainageOptions& options) {
  constexpr double kMost = 9e18;  // below 2^63; nothing accumulates that much
  std::vector<std::uint64_t> thresholds;
  for (int level = 0; level <= options.bottom_level; ++level) {
    const double units = static_cast<double>(options.cells) * std::pow(options.growth, options.bottom_level - level) *
                         static_cast<double>(kCell);
    thresholds.push_back(static_cast<std::uint64_t>(std::min(units, kMost)));
  }
  return thresholds;
}

/// Positions of posts that follow each other step by step, on the lattice.
std::vector<BreakVertex> lay_out(const HeightField& field, std::span<const std::int64_t> posts) {
  std::vector<BreakVertex> vertices;
  const std::int64_t width = field.lattice.width();
  std::int64_t turns = 0, least_x = std::numeric_limits<std::int64_t>::max(), last_col = posts.front() % field.n_cols;
  for (const std::int64_t post : posts) {
    const std::int64_t col = post % field.n_cols;
    if (field.wraps && std::abs(col - last_col) > 1) turns += col < last_col ? 1 : -1;
    last_col = col;
    const std::int64_t x = std::llround(field.post_x(col)) + turns * width;
    least_x = std::min(least_x, x);
    vertices.push_back({x, std::llround(field.post_y(post / field.n_cols)), 0});
  }
  const std::int64_t shift =
      -width * static_cast<std::int64_t>(std::floor(static_cast<double>(least_x) / static_cast<double>(width)));
  for (BreakVertex& v : vertices) v.x += shift;
  return vertices;
}

Result<void> check(const HeightField& field, const DrainageOptions& o) {
  const auto refuse = [](const char* why) { return fail(ErrorKind::kInvalidInput, why); };
  if (o.cells < 1) return refuse("drainage: the smallest stream must drain at least 1 cell");
  if (!(o.growth >= 1)) return refuse("drainage: the growth of the area per coarser level must be at least 1");
  if (!(o.lake_area_m2 >= 0)) return refuse("drainage: the area of the smallest lake must not be negative");
  if (!(o.max_change_m >= 0)) return refuse("drainage: the largest change of a height must not be negative");
  if (o.sea_level_m && !std::isfinite(*o.sea_level_m)) return refuse("drainage: the sea level must be a number");
  if (o.bottom_level < 0 || o.bottom_level > kMaxLevel) return refuse("drainage: no such bottom level");
  if (o.block_side < 1 || o.block_side > 32768) return refuse("drainage: blocks must have 1 to 32768 posts a side");
  if (field.n_rows < 1 || field.n_cols < 1) return refuse("drainage: the height field has no posts");
  if (!(field.dx >= 1) || !(field.dy >= 1)) return refuse("drainage: posts are closer than a step of the lattice");
  return {};
}

/// The steps of the analysis over one set of scratch arrays.
class Analysis {
 public:
  Analysis(const HeightField& field, const DrainageOptions& options) : field_(field), o_(options) {}

  bool take(const ScratchAllocator& scratch) {
    const auto n = static_cast<std::size_t>(field_.n_rows * field_.n_cols);
    eights_ = scratch(n * 8);
    filled_m_ = static_cast<float*>(eights_ ? scratch(n * sizeof(float)) : nullptr);
    marks_ = static_cast<std::uint8_t*>(filled_m_ ? scratch(n) : nullptr);
    directions_ = static_cast<std::uint8_t*>(marks_ ? scratch(n) : nullptr);
    return directions_ != nullptr;
  }

  Drainage run() {
    grid_ = make_flow_grid(field_, marks_);
    DrainageCounts& counts = result_.counts;
    counts.sea_posts = mark_sea(grid_, o_.sea_level_m, labels());
    const std::vector<Lake> lakes = mark_lakes(grid_, o_.lake_area_m2, o_.sea_level_m.value_or(0), labels());
    counts.lakes = static_cast<std::int64_t>(lakes.size());
    mark_outlets(grid_);
    fill_depressions(grid_, o_.block_side, filled_m_);
    counts.basin_posts = mark_basins(grid_, filled_m_, 2 * o_.max_change_m, o_.lake_area_m2, labels());
    counts.flat_posts = direct_flow(grid_, o_.block_side, filled_m_, static_cast<FlatSteps*>(eights_), directions_);
    accumulate_flow(grid_, o_.block_side, directions_, static_cast<std::uint64_t*>(eights_));
    for (std::int64_t i = 0; i < grid_.size(); ++i) {
      if (!(marks_[i] & kInside)) continue;
      ++counts.posts;
      if (filled_m_[i] > field_.heights_m[i]) ++counts.filled_posts;
      if (marks_[i] & kLake) ++counts.lake_posts;
    }
    add_streams();
    if (!lakes.empty()) add_shores(lakes);
    return std::move(result_);
  }

 private:
  std::int64_t* labels() { return static_cast<std::int64_t*>(eights_); }

  void add_streams() {
    StreamNetwork network = find_streams(grid_, filled_m_, directions_, static_cast<std::uint64_t*>(eights_),
                                         {level_thresholds(o_), o_.max_change_m, o_.deviation_limits_m});
    const StreamCounts& from = network.counts;
    DrainageCounts& counts = result_.counts;
    counts.channel_posts = from.channel_posts;
    counts.stream_posts = from.stream_posts;
    counts.deep_posts = from.deep_posts;
    counts.clamped = from.clamped;
    counts.uphill_steps = from.uphill_steps;
    counts.largest_uphill_m = from.largest_uphill_m;
    counts.largest_deviation_m = from.largest_deviation_m;
    counts.deviations_above = from.deviations_above;
    for (const StreamLink& link : network.links) {
      const double cells = static_cast<double>(link.accumulation) / static_cast<double>(kCell);
      BreakChain chain{lay_out(field_, link.posts), link.first_level, cells, true};
      for (std::size_t k = 0; k < link.posts.size(); ++k) chain.vertices[k].height_m = link.heights_m[k];
      for (const std::int64_t end : {link.posts.front(), link.posts.back()}) {
        if (marks_[end] & kLake) mouths_.push_back(end);
      }
      result_.streams.push_back(std::move(chain));
      result_.strahler.push_back(link.strahler);
      result_.area_km2.push_back(cells * grid_.cell_area_m2 / 1e6);
      result_.downstream.push_back(link.downstream);
    }
    std::sort(mouths_.begin(), mouths_.end());
  }

  void add_shores(const std::vector<Lake>& lakes) {
    // The labels' array has served other ends since.
    label_flats(grid_, o_.sea_level_m.value_or(0), labels());
    const double least_area_m2 = std::max(o_.lake_area_m2, static_cast<double>(kLakePosts) * grid_.cell_area_m2);
    const auto is_mouth = [&](std::int64_t post) { return std::binary_search(mouths_.begin(), mouths_.end(), post); };
    for (const ShoreLine& line : shore_lines(grid_, labels(), is_mouth)) {
      const auto lake = std::lower_bound(lakes.begin(), lakes.end(), line.root,
                                         [](const Lake& a, std::int64_t root) { return a.root < root; });
      BreakChain chain{lay_out(field_, line.posts), o_.bottom_level,
                       kShoreWeight + static_cast<double>(lake->core_posts)};
      for (BreakVertex& v : chain.vertices) v.height_m = lake->height_m;
      for (double least = 4 * least_area_m2; chain.first_level > 0 && lake->core_area_m2 >= least; least *= 4) {
        --chain.first_level;
      }
      result_.shores.push_back(std::move(chain));
    }
  }

  const HeightField& field_;
  const DrainageOptions& o_;
  FlowGrid grid_;
  void* eights_ = nullptr;  ///< 8 bytes a post: labels, then steps in flats, then accumulation, then labels again.
  float* filled_m_ = nullptr;
  std::uint8_t* marks_ = nullptr;
  std::uint8_t* directions_ = nullptr;
  std::vector<std::int64_t> mouths_;  ///< Lake posts where streams end or begin, ascending.
  Drainage result_;
};

}  // namespace

Result<Drainage> derive_drainage(const HeightField& field, const DrainageOptions& options,
                                 const ScratchAllocator& scratch) {
  if (auto checked = check(field, options); !checked) return tl::unexpected(checked.error());
  Analysis analysis(field, options);
  if (!analysis.take(scratch)) {
    return fail(ErrorKind::kIo,
                "drainage: no room for its scratch arrays (14 bytes a post); free disk space, or build "
                "without drainage");
  }
  return analysis.run();
}

}  // namespace tind
