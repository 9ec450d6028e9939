// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/drainage/drainage.hpp"

#include <algorithm>
#include <atomic>
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
  vertices.reserve(posts.size());
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
  if (o.run.threads < 1) return refuse("drainage: at least one thread is needed");
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
    accumulation_ = static_cast<std::uint64_t*>(scratch(n * sizeof(std::uint64_t)));
    marks_ = static_cast<std::uint8_t*>(accumulation_ ? scratch(n) : nullptr);
    directions_ = static_cast<std::uint8_t*>(marks_ ? scratch(n) : nullptr);
    // Sums need no surface any more.
    static_assert(sizeof(float) + sizeof(FlatSteps) == sizeof(std::uint64_t));
    filled_m_ = reinterpret_cast<float*>(accumulation_);
    steps_ = reinterpret_cast<FlatSteps*>(filled_m_ + n);
    return directions_ != nullptr;
  }

  Result<Drainage> run(const ScratchAllocator& scratch) {
    const double lake_level_m = o_.sea_level_m.value_or(0);
    DrainageCounts& counts = result_.counts;
    std::vector<Lake> lakes;
    Result<void> traced;
    // Shares of the time, measured on mountains.
    step(0, 0.05, [&](const FlowRun& run) { grid_ = make_flow_grid(field_, marks_, run); });
    step(0.05, 0.15, [&](const FlowRun& run) {
      counts.sea_posts = mark_sea(grid_, o_.sea_level_m, run);
      lakes = mark_lakes(grid_, o_.lake_area_m2, lake_level_m, run);
      mark_outlets(grid_, run);
    });
    step(0.15, 0.5, [&](const FlowRun& run) { fill_depressions(grid_, o_.block_side, filled_m_, run); });
    step(0.5, 0.55, [&](const FlowRun& run) {
      counts.basin_posts = mark_basins(grid_, filled_m_, 2 * o_.max_change_m, o_.lake_area_m2, run);
    });
    step(0.55, 0.8, [&](const FlowRun& run) {
      counts.flat_posts = direct_flow(grid_, o_.block_side, filled_m_, steps_, directions_, run);
      count_posts(run);
    });
    step(0.8, 0.9, [&](const FlowRun& run) { accumulate_flow(grid_, o_.block_side, directions_, accumulation_, run); });
    step(0.9, 1, [&](const FlowRun& run) { traced = add_streams(scratch, run); });
    if (o_.run.stopped()) return fail(ErrorKind::kInterrupted, "interrupted");
    if (!traced) return tl::unexpected(traced.error());
    counts.lakes = static_cast<std::int64_t>(lakes.size());
    if (!lakes.empty()) add_shores(lakes);
    return std::move(result_);
  }

 private:
  // A step of the whole that takes it from one share to another.
  template <class F>
  void step(double from, double to, F&& f) {
    if (o_.run.stopped()) return;
    FlowRun part = o_.run.quiet();
    if (o_.run.progress) {
      part.progress = [this, from, to, last = from](double share) mutable {
        // What a step does in several passes begins anew with each.
        last = std::max(last, from + (to - from) * std::clamp(share, 0.0, 1.0));
        o_.run.progress(last);
      };
    }
    f(part);
    part.report(1, 1);
  }

  // Also marks what is too deep to condition.
  void count_posts(const FlowRun& run) {
    std::atomic<std::int64_t> n_posts{0}, n_filled{0}, n_lake{0};
    for_row_bands(run.quiet(), grid_.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
      std::int64_t posts = 0, filled = 0, lake = 0;
      for (std::int64_t i = row_begin * grid_.n_cols; i < row_end * grid_.n_cols; ++i) {
        const std::uint8_t mark = marks_[i];
        const bool inside = mark & kInside;
        const double depth_m = static_cast<double>(filled_m_[i]) - static_cast<double>(field_.heights_m[i]);
        posts += inside ? 1 : 0;
        filled += inside && depth_m > 0 ? 1 : 0;
        lake += inside && (mark & kLake) ? 1 : 0;
        const std::uint8_t deep = inside && depth_m > 2 * o_.max_change_m ? kDeep : std::uint8_t{0};
        marks_[i] = static_cast<std::uint8_t>((mark & ~kDeep) | deep);
      }
      n_posts += posts;
      n_filled += filled;
      n_lake += lake;
    });
    result_.counts.posts = n_posts;
    result_.counts.filled_posts = n_filled;
    result_.counts.lake_posts = n_lake;
  }

  Result<void> add_streams(const ScratchAllocator& scratch, const FlowRun& run) {
    const StreamOptions options{level_thresholds(o_), o_.max_change_m, o_.deviation_limits_m};
    const auto take = [&](const StreamLink& link) {
      const double cells = static_cast<double>(link.accumulation) / static_cast<double>(kCell);
      BreakChain chain{lay_out(field_, link.posts), link.first_level, cells, true};
      for (std::size_t k = 0; k < link.posts.size(); ++k) chain.vertices[k].height_m = link.heights_m[k];
      for (const std::int64_t end : {link.posts.front(), link.posts.back()}) {
        if (marks_[end] & kLake) mouths_.push_back(end);
      }
      if (o_.kept) move_vertices(chain);
      result_.streams.push_back(std::move(chain));
      result_.strahler.push_back(link.strahler);
      result_.area_km2.push_back(cells * grid_.cell_area_m2 / 1e6);
    };
    auto network = find_streams(grid_, directions_, accumulation_, options, scratch, run, take);
    if (!network) return tl::unexpected(network.error());
    result_.downstream = std::move(network->downstream);
    const StreamCounts& from = network->counts;
    DrainageCounts& counts = result_.counts;
    counts.channel_posts = from.channel_posts;
    counts.stream_posts = from.stream_posts;
    counts.deep_posts = from.deep_posts;
    counts.clamped = from.clamped;
    counts.uphill_steps = from.uphill_steps;
    counts.largest_uphill_m = from.largest_uphill_m;
    counts.largest_deviation_m = from.largest_deviation_m;
    counts.deviations_above = from.deviations_above;
    std::sort(mouths_.begin(), mouths_.end());
    return {};
  }

  // From the heap into memory of the caller's, as long as there is some.
  void move_vertices(BreakChain& chain) {
    constexpr std::size_t kChunk = std::size_t{1} << 18;  // 6 MB
    const std::size_t n = chain.vertices.size();
    if (free_vertices_.size() < n) {
      const std::size_t wanted = std::max(kChunk, n);
      auto* const memory = static_cast<BreakVertex*>(o_.kept(wanted * sizeof(BreakVertex)));
      if (memory == nullptr) return;
      free_vertices_ = {memory, wanted};
    }
    const std::span<BreakVertex> kept = free_vertices_.first(n);
    std::copy(chain.vertices.begin(), chain.vertices.end(), kept.begin());
    free_vertices_ = free_vertices_.subspan(n);
    chain.kept = kept;
    std::vector<BreakVertex>().swap(chain.vertices);  // an empty list in its place would leave the memory
  }

  void add_shores(const std::vector<Lake>& lakes) {
    const double least_area_m2 = std::max(o_.lake_area_m2, static_cast<double>(kLakePosts) * grid_.cell_area_m2);
    const auto is_mouth = [&](std::int64_t post) { return std::binary_search(mouths_.begin(), mouths_.end(), post); };
    for (const ShoreLine& line : shore_lines(grid_, lakes, is_mouth)) {
      const Lake& lake = lakes[line.lake];
      BreakChain chain{lay_out(field_, line.posts), o_.bottom_level,
                       kShoreWeight + static_cast<double>(lake.core_posts)};
      for (BreakVertex& v : chain.vertices) v.height_m = lake.height_m;
      for (double least = 4 * least_area_m2; chain.first_level > 0 && lake.core_area_m2 >= least; least *= 4) {
        --chain.first_level;
      }
      result_.shores.push_back(std::move(chain));
    }
  }

  const HeightField& field_;
  const DrainageOptions& o_;
  FlowGrid grid_;
  std::uint64_t* accumulation_ = nullptr;  ///< In its place first, half each:
  float* filled_m_ = nullptr;
  FlatSteps* steps_ = nullptr;
  std::uint8_t* marks_ = nullptr;
  std::uint8_t* directions_ = nullptr;
  std::span<BreakVertex> free_vertices_;  ///< Memory of o_.kept that no chain has.
  std::vector<std::int64_t> mouths_;      ///< Lake posts where streams end or begin, ascending.
  Drainage result_;
};

}  // namespace

Result<Drainage> derive_drainage(const HeightField& field, const DrainageOptions& options,
                                 const ScratchAllocator& scratch) {
  if (auto checked = check(field, options); !checked) return tl::unexpected(checked.error());
  Analysis analysis(field, options);
  if (!analysis.take(scratch)) {
    return fail(ErrorKind::kIo,
                "drainage: no room for its scratch arrays (10 bytes a post); free disk space, or build "
                "without drainage");
  }
  return analysis.run(scratch);
}

}  // namespace tind
