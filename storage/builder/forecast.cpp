// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/forecast.hpp"

#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <optional>
#include <set>
#include <thread>
#include <utility>

#include "core/virtual_node.hpp"
#include "storage/builder/duration.hpp"
#include "storage/builder/elevation_source.hpp"
#include "storage/builder/ordered_pipeline.hpp"
#include "storage/builder/plan.hpp"
#include "storage/builder/plan_problems.hpp"
#include "storage/builder/source_levels.hpp"
#include "storage/builder/surface_lines.hpp"
#include "storage/builder/tile_posts.hpp"
#include "storage/builder/vertex_estimate.hpp"

namespace tind {
namespace {

using Clock = std::chrono::steady_clock;

// Regions of this many posts are built: large enough for three levels, small enough for several.
constexpr double kRegionPosts = 1.1e6;
constexpr int kLevelsBelow = 2;
constexpr std::size_t kMostRegions = 16, kLeastRegions = 8;
constexpr double kRegionSeconds = 6;
// Places looked at to find where the data is rough, and where it is not at all.
constexpr std::size_t kMostProbes = 400, kLeastProbes = 16;
constexpr double kProbeSeconds = 3;
constexpr std::int64_t kProbePosts = 24;
// Vertices fall by this much per coarser level where the sample does not tell.
constexpr double kLeastFall = 2, kMostFall = 4, kMostGrowth = 1.12;
constexpr double kFillerBytes = 160, kMostBytesPerVertex = 7;
constexpr double kMostTileKeys = 4e6;
// Measured on whole builds (tind-build-plan(1)): what the sample does not see of the work on tiles and lines, seconds
// of reading a post, the share of the work that more threads do not share.
constexpr double kTileFactor = 1.0, kLineFactor = 1.0, kMostReadSecondsPerPost = 100e-9, kPostSeconds = 20e-9;
constexpr double kThreadEfficiency = 0.93;
// Of the working copy: heights, origins and block pyramid a post; of drainage while it is derived.
constexpr double kCopyBytesPerPost = 7.4, kDrainageBytesPerPost = 14, kPointBytes = 24;
constexpr double kBaseMemory = 40e6, kMemoryPerThread = 20e6, kMemoryPerBorderVertex = 20, kResidentShare = 0.4;

struct Region {
  TileKey key;
  double roughness = 0;
};

// Systematic along the order of roughness: each stands for as many.
std::vector<Region> spread(std::vector<Region> regions, std::size_t n) {
  std::stable_sort(regions.begin(), regions.end(),
                   [](const Region& a, const Region& b) { return a.roughness < b.roughness; });
  if (regions.size() <= n) return regions;
  std::vector<Region> chosen;
  for (std::size_t i = 0; i < n; ++i) chosen.push_back(regions[(2 * i + 1) * regions.size() / (2 * n)]);
  return chosen;
}

struct Cost {
  RegionSample region;
  double posts = 0, read_seconds = 0, line_seconds = 0;
};

class Forecaster {
 public:
  Forecaster(const BuildOptions& options, ElevationSource& source, const LevelTable& table, Forecast& out)
      : options_(options), source_(source), table_(table), out_(out) {
    lattice_.level = table.lattice_level;
    lattice_.height_exponent = table.height_exponent;
    const auto folder = std::filesystem::path(options.output).parent_path();
    // A folder that is not there is a problem to tell, not the end.
    scratch_dir_ = folder.empty() ? "." : folder.string();
    if (options.output.empty() || ::access(scratch_dir_.c_str(), W_OK | X_OK) != 0) {
      scratch_dir_ = std::filesystem::temp_directory_path().string();
    }
    const double posts_per_level0 = 180.0 / source.lon_spacing_deg() * (180.0 / source.lat_spacing_deg());
    region_level_ = table.bottom_level();
    while (region_level_ > 0 && region_level_ > table.bottom_level() - kLevelsBelow &&
           posts_per_level0 / std::exp2(2 * (region_level_ - 1)) <= kRegionPosts) {
      --region_level_;
    }
    out_.levels.resize(static_cast<std::size_t>(table.bottom_level()) + 1);
  }

  Result<void> run() {
    const RasterMosaic* raster = source_.raster();
    const bool whole = raster == nullptr || static_cast<double>(raster->n_rows) * static_cast<double>(raster->n_cols) <=
                                                static_cast<double>(kWholePosts);
    auto done = whole ? sample_whole() : sample_windows(*raster);
    if (!done) return done;
    extrapolate();
    return {};
  }

  /// Posts of the grid with its falloff.
  double grid_posts() const { return grid_posts_; }

 private:
  // Everything is read as a build reads it, then regions of the one field are built.
  Result<void> sample_whole() {
    const double before = process_seconds();
    if (auto loaded = source_.load(lattice_, options_.base_height_m, options_.falloff_posts, scratch_dir_, out_.threads,
                                   [](double) {});
        !loaded) {
      return loaded;
    }
    out_.read_seconds = process_seconds() - before;
    HeightField field = source_.field();
    out_.whole_source_read = true;
    const double before_lines = process_seconds();
    auto lines = make_surface_lines(field, table_, line_options(), {scratch_dir_}, out_.threads);
    if (!lines) return tl::unexpected(lines.error());
    out_.line_seconds = options_.lines.drainage ? process_seconds() - before_lines : 0;
    field.pinned = lines->pyramid.pinned();
    take_signs(field);
    const TilePlan plan(field, table_.bottom_level());
    for (int level = 0; level <= table_.bottom_level(); ++level) {
      out_.levels[static_cast<std::size_t>(level)].tiles = static_cast<double>(plan.tiles(level).size());
    }
    std::vector<Region> regions;
    const auto& keys =
        region_level_ == table_.bottom_level() ? plan.tiles(region_level_) : plan.split_tiles(region_level_);
    for (const TileKey& key : keys) regions.push_back({key, roughness_of(field, key)});
    out_.n_all_regions = static_cast<std::int64_t>(regions.size());
    const auto chosen = spread(regions, kMostRegions);
    std::vector<Cost> costs;
    run_ordered<std::size_t, Cost>(
        chosen.size(), out_.threads, [](std::size_t i) { return i; },
        [&](std::size_t&& i) {
          return Cost{build_region(field, table_, lines->pyramid, chosen[i].key, static_cast<int>(i)), 0, 0, 0};
        },
        [&](std::size_t, Cost&& cost) {
          costs.push_back(std::move(cost));
          return true;
        });
    take_costs(costs, static_cast<double>(regions.size()));
    // Tiles are known here, so the sample only tells what one takes.
    const auto deepest =
        std::min<std::size_t>(costs.empty() ? 0 : costs.front().region.levels.size(), out_.levels.size());
    for (std::size_t k = 0; k < deepest; ++k) {
      const auto level = static_cast<std::size_t>(region_level_) + k;
      LevelCost& cost = out_.levels[level];
      const double tiles = static_cast<double>(plan.tiles(static_cast<int>(level)).size());
      const double of_regions = regions_tiles(plan, static_cast<int>(level));
      if (cost.tiles > 0) {
        for (double* value : {&cost.vertices, &cost.bytes, &cost.seconds}) *value *= of_regions / cost.tiles;
      }
      cost.bytes += (tiles - of_regions) * kFillerBytes;
      cost.tiles = tiles;
    }
    return {};
  }

  // Stored tiles of `level` below a region.
  double regions_tiles(const TilePlan& plan, int level) const {
    if (level == region_level_ && region_level_ < table_.bottom_level())
      return static_cast<double>(plan.split_tiles(level).size());
    return static_cast<double>(plan.tiles(level).size());
  }

  Result<void> sample_windows(const RasterMosaic& raster) {
    const std::vector<TileKey> all = count_tiles(raster);
    auto probed = probe(raster, all);
    if (!probed) return tl::unexpected(probed.error());
    std::vector<Region>& regions = *probed;
    if (regions.empty()) return {};  // the problems say that there is no data
    const auto n_probed = static_cast<double>(std::min(all.size(), n_probed_));
    const double n_data = static_cast<double>(all.size()) * static_cast<double>(regions.size()) / n_probed;
    data_share_ = n_data / static_cast<double>(all.size());
    out_.n_all_regions = std::llround(n_data);
    LineOptions lines = line_options();
    // How long a region takes tells how many there is time for.
    const auto begin = Clock::now();
    std::vector<Region> one = spread(regions, 1);
    if (lines.drainage && (!lines.drainage_cells || !lines.lake_area_m2)) {
      auto posts = read_posts(raster, posts_around(raster, lattice_, one[0].key));
      if (!posts) return tl::unexpected(posts.error());
      const WindowField window(raster, lattice_, posts_around(raster, lattice_, one[0].key), std::move(*posts),
                               options_.base_height_m, options_.falloff_posts);
      const double vertices = std::max(1.0, estimate_bottom_vertices(window.field(), table_, out_.threads));
      const double n = static_cast<double>(window.field().n_rows) * static_cast<double>(window.field().n_cols);
      if (!lines.drainage_cells)
        lines.drainage_cells = std::max<std::int64_t>(1, std::llround(kCellsPerVertex * n / vertices));
    }
    std::vector<Cost> costs;
    if (auto built = build_windows(raster, one, lines, costs); !built) return built;
    const double each = std::max(1e-3, seconds_since(begin)) / std::min(2, out_.threads);
    const auto n = std::clamp(static_cast<std::size_t>(kRegionSeconds / each), kLeastRegions, kMostRegions);
    costs.clear();
    if (auto built = build_windows(raster, spread(regions, n), lines, costs); !built) return built;
    take_costs(costs, n_data);
    double posts = 0, read = 0, drawn = 0;
    for (const Cost& cost : costs) {
      posts += cost.posts;
      read += cost.read_seconds;
      drawn += cost.line_seconds;
    }
    grid_posts_ = static_cast<double>(raster.n_rows + 2 * options_.falloff_posts) *
                  static_cast<double>(raster.n_cols + (raster.wraps ? 0 : 2 * options_.falloff_posts));
    const double read_each = std::min(read / posts, raster.warped ? 1.0 : kMostReadSecondsPerPost) + kPostSeconds;
    out_.read_seconds = read_each * grid_posts_;
    out_.line_seconds = options_.lines.drainage ? drawn / posts * grid_posts_ : 0;
    for (std::size_t k = 0; k < costs.front().region.levels.size(); ++k) {
      const auto level = static_cast<std::size_t>(region_level_) + k;
      LevelCost& cost = out_.levels[level];
      // There are no more than the sources' rectangles touch.
      if (cost.tiles > counted_[level]) {
        const double excess = cost.tiles / counted_[level];
        for (double* value : {&cost.tiles, &cost.vertices, &cost.bytes, &cost.seconds}) *value /= excess;
      }
      const double tiles = std::max(cost.tiles, counted_[level] * data_share_);
      cost.bytes += (tiles - cost.tiles) * kFillerBytes;
      cost.tiles = tiles;
    }
    for (int level = 0; level < region_level_; ++level) {
      const auto l = static_cast<std::size_t>(level);
      out_.levels[l].tiles = std::max(std::min(counted_[l], 2.0), counted_[l] * data_share_);
    }
    return {};
  }

  Result<void> build_windows(const RasterMosaic& raster, const std::vector<Region>& regions, const LineOptions& lines,
                             std::vector<Cost>& costs) {
    struct Job {
      std::optional<WindowField> window;
      TileKey key;
      int turn = 0;
      double read_seconds = 0;
      std::optional<Error> error;
    };
    struct Done {
      Cost cost;
      std::optional<Error> error;
    };
    std::optional<Error> error;
    const auto prepare = [&](std::size_t i) {
      Job job;
      job.key = regions[i].key;
      job.turn = static_cast<int>(i);
      const PostRange range = posts_around(raster, lattice_, job.key);
      auto posts = read_posts(raster, range);
      if (!posts) {
        job.error = posts.error();
        return job;
      }
      out_.signs.add(posts->signs);
      job.read_seconds = posts->read_seconds;
      job.window.emplace(raster, lattice_, range, std::move(*posts), options_.base_height_m, options_.falloff_posts);
      return job;
    };
    const auto work = [&](Job&& job) {
      Done done;
      done.error = job.error;
      if (done.error) return done;
      HeightField field = job.window->field();
      const double before = thread_seconds();
      auto drawn = make_surface_lines(field, table_, lines, {scratch_dir_}, 1);
      if (!drawn) {
        done.error = drawn.error();
        return done;
      }
      done.cost.line_seconds = thread_seconds() - before;
      field.pinned = drawn->pyramid.pinned();
      done.cost.read_seconds = job.read_seconds;
      done.cost.posts = static_cast<double>(field.n_rows) * static_cast<double>(field.n_cols);
      done.cost.region = build_region(field, table_, drawn->pyramid, job.key, job.turn);
      return done;
    };
    const auto consume = [&](std::size_t, Done&& done) {
      error = done.error;
      costs.push_back(std::move(done.cost));
      return !error.has_value();
    };
    run_ordered<Job, Done>(regions.size(), std::min(out_.threads, 4), prepare, work, consume);
    if (error) return tl::unexpected(*error);
    return {};
  }

  // Tiles of each level that the sources' rectangles and their falloff touch; returns the regions that data is in.
  std::vector<TileKey> count_tiles(const RasterMosaic& raster) {
    std::set<std::pair<std::int64_t, std::int64_t>> touched, with_data;
    int level = table_.bottom_level();
    const auto spread_deg = [&](int l) { return 180.0 / std::exp2(l); };
    double keys = 0;
    for (const RasterSource& s : raster.sources) {
      keys += (static_cast<double>(s.n_used_cols) * raster.lon_spacing_deg / spread_deg(level) + 2) *
              (static_cast<double>(s.n_used_rows) * raster.lat_spacing_deg / spread_deg(level) + 2);
    }
    for (; keys > kMostTileKeys && level > region_level_; --level) keys /= 4;
    const auto add = [&](const RasterSource& s, int l, double margin, auto& set) {
      const double side = spread_deg(l);
      const double west = raster.west_deg + 180 + (static_cast<double>(s.grid_col) - margin) * raster.lon_spacing_deg;
      const double east = west + (static_cast<double>(s.n_used_cols - 1) + 2 * margin) * raster.lon_spacing_deg;
      const double south = raster.south_deg + 90 + (static_cast<double>(s.grid_row) - margin) * raster.lat_spacing_deg;
      const double north = south + (static_cast<double>(s.n_used_rows - 1) + 2 * margin) * raster.lat_spacing_deg;
      const std::int64_t n_x = TileKey::count_x(l), n_y = TileKey::count_y(l);
      const std::int64_t y_first = std::clamp<std::int64_t>(std::llround(std::floor(south / side)), 0, n_y - 1);
      const std::int64_t y_last = std::clamp<std::int64_t>(std::llround(std::floor(north / side)), 0, n_y - 1);
      const std::int64_t x_first = std::llround(std::floor(west / side));
      const std::int64_t x_last = std::min<std::int64_t>(std::llround(std::floor(east / side)), x_first + n_x - 1);
      for (std::int64_t y = y_first; y <= y_last; ++y) {
        for (std::int64_t x = x_first; x <= x_last; ++x) set.insert({y, ((x % n_x) + n_x) % n_x});
      }
    };
    for (const RasterSource& s : raster.sources) {
      add(s, level, static_cast<double>(options_.falloff_posts) + 1, touched);
      add(s, region_level_, 0, with_data);
    }
    counted_.assign(out_.levels.size(), 0);
    for (int l = table_.bottom_level(); l > level; --l)
      counted_[static_cast<std::size_t>(l)] = static_cast<double>(touched.size()) * std::exp2(2 * (l - level));
    for (; level > 0; --level) {
      std::set<std::pair<std::int64_t, std::int64_t>> parents;
      for (const auto& [y, x] : touched) parents.insert({y / 2, x / 2});
      counted_[static_cast<std::size_t>(level)] = 4 * static_cast<double>(parents.size());
      touched = std::move(parents);
    }
    counted_[0] = kRootCountX;
    std::vector<TileKey> regions;
    for (const auto& [y, x] : with_data) {
      regions.push_back(
          {static_cast<std::uint8_t>(region_level_), static_cast<std::uint32_t>(x), static_cast<std::uint32_t>(y)});
    }
    return regions;
  }

  // Looks at four places in each of up to kMostProbes regions; returns those that have data, with their roughness.
  Result<std::vector<Region>> probe(const RasterMosaic& raster, const std::vector<TileKey>& all) {
    const auto begin = Clock::now();
    std::vector<Region> regions;
    const std::size_t n = std::min(all.size(), kMostProbes);
    // Passes that halve the distance: whenever time is up the places are spread over all regions.
    std::vector<bool> seen(n);
    for (std::size_t step = std::bit_ceil(n); step > 0; step /= 2) {
      for (std::size_t i = 0; i < n; i += step) {
        if (seen[i]) continue;
        if (n_probed_ >= kLeastProbes && seconds_since(begin) > kProbeSeconds) return regions;
        seen[i] = true;
        ++n_probed_;
        Region region{all[i * all.size() / n], 0};
        const PostRange around = inside(raster, posts_around(raster, lattice_, region.key));
        const std::int64_t n_rows = std::min(kProbePosts, around.n_rows), n_cols = std::min(kProbePosts, around.n_cols);
        std::uint64_t heights = 0;
        for (int quarter = 0; quarter < 4; ++quarter) {
          const PostRange range{around.row + (around.n_rows - n_rows) * (1 + 2 * (quarter / 2)) / 4,
                                around.col + (around.n_cols - n_cols) * (1 + 2 * (quarter % 2)) / 4, n_rows, n_cols};
          auto posts = read_posts(raster, range);
          if (!posts) return tl::unexpected(posts.error());
          out_.signs.add(posts->signs);
          heights += posts->signs.heights;
          region.roughness += posts->roughness_m;
        }
        if (heights > 0) regions.push_back(region);
      }
    }
    return regions;
  }

  // The part of a range that is in the mosaic's grid.
  static PostRange inside(const RasterMosaic& raster, PostRange range) {
    const std::int64_t row_end = std::min(range.row + range.n_rows, raster.n_rows);
    range.row = std::max<std::int64_t>(range.row, 0);
    range.n_rows = std::max<std::int64_t>(row_end - range.row, 0);
    if (raster.wraps) return range;
    const std::int64_t col_end = std::min(range.col + range.n_cols, raster.n_cols);
    range.col = std::max<std::int64_t>(range.col, 0);
    range.n_cols = std::max<std::int64_t>(col_end - range.col, 0);
    return range;
  }

  static double roughness_of(const HeightField& field, const TileKey& key) {
    double sum = 0, n = 0;
    for_posts_around(field, key, [&](std::int64_t r, std::int64_t c) {
      if (c < 2 || (r + c) % 4 != 0) return;
      sum += std::abs(field.height_at(r, c) - 2 * field.height_at(r, c - 1) + field.height_at(r, c - 2));
      n += 1;
    });
    return n > 0 ? sum / n : 0;
  }

  void take_signs(const HeightField& field) {
    PostSigns& signs = out_.signs;
    const SourceCounts& counts = source_.counts();
    signs.heights = counts.source;
    signs.posts = source_.has_points() ? counts.source
                                       : static_cast<std::uint64_t>(source_.raster()->n_rows) *
                                             static_cast<std::uint64_t>(source_.raster()->n_cols);
    signs.voids = signs.posts - std::min(signs.posts, counts.source);
    signs.overlapping = counts.overlapping;
    signs.disagreeing = counts.disagreeing;
    signs.largest_disagreement_m = field.disagreement_m;
    bool any = false;
    for (std::int64_t r = 0; r < field.n_rows; ++r) {
      for (std::int64_t c = 0; c < field.n_cols; ++c) {
        if (!is_of_source(field.origin_at(r, c))) continue;
        const double height = field.height_at(r, c);
        signs.lowest_m = any ? std::min(signs.lowest_m, height) : height;
        signs.highest_m = any ? std::max(signs.highest_m, height) : height;
        signs.whole_metres = signs.whole_metres && height == std::round(height);
        any = true;
      }
    }
    grid_posts_ = static_cast<double>(field.n_rows) * static_cast<double>(field.n_cols);
  }

  LineOptions line_options() const {
    LineOptions lines = options_.lines;
    lines.given.clear();
    lines.lines_out.clear();
    return lines;
  }

  // Sums the sample up for all regions.
  void take_costs(const std::vector<Cost>& costs, double n_regions) {
    out_.n_regions = static_cast<std::int64_t>(costs.size());
    if (costs.empty()) return;
    const double stands_for = n_regions / static_cast<double>(costs.size());
    for (const Cost& cost : costs) {
      for (std::size_t k = 0; k < cost.region.levels.size(); ++k) {
        const LevelCost& from = cost.region.levels[k];
        LevelCost& to = out_.levels[static_cast<std::size_t>(region_level_) + k];
        if (&cost == &costs.front()) to = {};
        to.tiles += from.tiles * stands_for;
        to.vertices += from.vertices * stands_for;
        to.bytes += from.bytes * stands_for;
        to.seconds += from.seconds * stands_for;
      }
    }
  }

  // Levels above the regions, from those of the regions: vertices go on falling as they do, and work is so much a post
  // and so much a vertex.
  void extrapolate() {
    if (out_.n_regions == 0) return;
    const auto top = static_cast<std::size_t>(region_level_);
    const LevelCost& first = out_.levels[top];
    double fall = 3, growth = 1.1, per_vertex = first.vertices > 0 ? first.seconds / first.vertices : 0, fixed = 0;
    if (top + 1 < out_.levels.size()) {
      const LevelCost& second = out_.levels[top + 1];
      fall = second.vertices / std::max(1.0, first.vertices);
      if (top + 2 < out_.levels.size())
        growth = fall / (out_.levels[top + 2].vertices / std::max(1.0, second.vertices));
      const double slope = (second.seconds - first.seconds) / std::max(1.0, second.vertices - first.vertices);
      per_vertex = std::clamp(slope, 0.0, per_vertex);
      fixed = first.seconds - per_vertex * first.vertices;
    }
    growth = std::clamp(growth, 1.0, kMostGrowth);
    for (std::size_t level = top; level-- > 0;) {
      LevelCost& cost = out_.levels[level];
      const LevelCost& finer = out_.levels[level + 1];
      const int seeds =
          seed_segments(static_cast<int>(level), table_.levels[level].tolerance_m, lattice_.ellipsoid.semi_major_m);
      fall = std::clamp(fall * growth, kLeastFall, kMostFall);
      cost.vertices = std::max(finer.vertices / fall, cost.tiles * seeds * seeds);
      const double bytes_each = finer.vertices > 0 ? finer.bytes / finer.vertices : kMostBytesPerVertex;
      cost.bytes = std::max(cost.vertices * std::min(bytes_each, kMostBytesPerVertex), cost.tiles * kFillerBytes);
      cost.seconds = fixed + per_vertex * cost.vertices;
    }
  }

  static double process_seconds() {
    timespec t{};
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
  }

  const BuildOptions& options_;
  ElevationSource& source_;
  const LevelTable& table_;
  Forecast& out_;
  Lattice lattice_;
  std::string scratch_dir_;
  int region_level_ = 0;
  std::vector<double> counted_;
  std::size_t n_probed_ = 0;
  double data_share_ = 1;
  double grid_posts_ = 0;
};

// Inputs records: digests and counts, and of rasters the errors of cells with posts, which are about as many as there
// are tiles that far down.
double inputs_bytes(const std::vector<LevelCost>& levels, const ElevationSource& source) {
  constexpr double kRecordBytes = 90, kCellBytes = 15;
  constexpr std::size_t kLeastCellLevels = 2;
  double bytes = 0;
  for (std::size_t level = 0; level < levels.size(); ++level) {
    bytes += levels[level].tiles * kRecordBytes;
    const std::size_t below = std::min<std::size_t>(kMostCellLevels, levels.size() - 1 - level);
    if (source.has_points() || below < kLeastCellLevels) continue;
    bytes += levels[level + below].tiles * kCellBytes;
  }
  return bytes;
}

// Time of all, memory and disk, from the parts.
void sum_up(const BuildOptions& options, const ElevationSource& source, double grid_posts, Forecast& out) {
  out.tile_seconds = out.total(&LevelCost::seconds) * kTileFactor;
  out.line_seconds *= kLineFactor;
  out.seconds_one = out.read_seconds + out.line_seconds + out.tile_seconds;
  out.seconds = out.read_seconds + out.line_seconds +
                out.tile_seconds / std::max(1.0, out.threads * (out.threads > 1 ? kThreadEfficiency : 1.0));
  out.output_bytes = static_cast<std::uint64_t>(out.total(&LevelCost::bytes) + inputs_bytes(out.levels, source));
  double copy = grid_posts * kCopyBytesPerPost + (source.has_points() ? out.posts * kPointBytes : 0);
  double peak = copy + (options.lines.drainage ? grid_posts * kDrainageBytesPerPost : 0);
  out.scratch_bytes = static_cast<std::uint64_t>(peak);
  const double resident = std::min(peak, static_cast<double>(options.memory_bytes) * kResidentShare);
  out.memory_bytes = static_cast<std::uint64_t>(
      std::min(static_cast<double>(options.memory_bytes), kBaseMemory + kMemoryPerThread * out.threads + resident));
}

}  // namespace

Result<Forecast> make_forecast(const BuildOptions& given) {
  BuildOptions options = given;
  options.source.raster.hash_files = false;
  auto source = ElevationSource::open(options.source);
  if (!source) return tl::unexpected(source.error());
  auto table = make_source_levels(*source, options);
  if (!table) return tl::unexpected(table.error());
  // A pyramid that is cut off above the posts' own level is sampled where its tiles are small.
  LevelTable sampled = *table;
  if (options.levels.max_level) {
    BuildOptions uncut = options;
    uncut.levels.max_level.reset();
    const auto full = make_source_levels(*source, uncut);
    const auto same = [](const LevelSpec& a, const LevelSpec& b) { return a.tolerance_m == b.tolerance_m; };
    if (full && full->levels.size() > table->levels.size() &&
        std::equal(table->levels.begin(), table->levels.end(), full->levels.begin(), same)) {
      sampled = *full;
    }
  }
  Forecast out;
  out.table = *table;
  out.threads =
      options.threads > 0 ? options.threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  out.bounds_deg = source->bounds_deg();
  out.spacing_deg = {source->lon_spacing_deg(), source->lat_spacing_deg()};
  if (const RasterMosaic* raster = source->raster()) {
    out.source_kind = raster->warped ? "warped" : "raster";
    for (const RasterSource& s : raster->sources) out.sources.push_back(s.name);
  } else {
    out.source_kind = "points";
    for (const std::string& path : options.source.inputs)
      out.sources.push_back(std::filesystem::path(path).filename().string());
  }
  const auto [west, south, east, north] = out.bounds_deg;
  out.n_cols = std::llround((east - west) / out.spacing_deg[0]) + 1;
  out.n_rows = std::llround((north - south) / out.spacing_deg[1]) + 1;
  Forecaster forecaster(options, *source, sampled, out);
  if (auto done = forecaster.run(); !done) return tl::unexpected(done.error());
  out.levels.resize(std::min(out.levels.size(), table->levels.size()));
  const double share =
      out.signs.posts ? static_cast<double>(out.signs.heights) / static_cast<double>(out.signs.posts) : 0;
  out.posts = out.whole_source_read ? static_cast<double>(out.signs.heights)
                                    : static_cast<double>(out.n_cols) * static_cast<double>(out.n_rows) * share;
  out.notes = source->notes();
  sum_up(options, *source, forecaster.grid_posts(), out);
  add_data_problems(*source, options, out);
  add_output_problems(options, out);
  return out;
}

}  // namespace tind
