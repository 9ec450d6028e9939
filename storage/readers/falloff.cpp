// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/falloff.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <vector>

#include "core/drainage/flow_run.hpp"
#include "core/registers.hpp"

namespace tind {
namespace {

/// Rows that a thread takes at once for their nearest posts: many more than those around them that are looked at.
constexpr std::int64_t kBandOfRows = 256;
/// Rows that a thread relaxes before it says so.
constexpr std::int64_t kRowsAtOnce = 16;

/// Posts [begin, end) of one row. Columns may be unwrapped.
struct Run {
  std::int64_t row, begin, end;
};

/// The nearest post with a height for every void post of one row: squared distances from one-dimensional ones
/// (Meijster, Roerdink, Hesselink 2000, "A general algorithm for computing distance transforms in linear time").
class NearestInRow {
 public:
  struct Site {
    std::int64_t col;    ///< Unwrapped column.
    std::int64_t row;    ///< Nearest row with a height in that column.
    std::int64_t rise2;  ///< Squared distance to it, in rows.
  };
  /// Starts a row whose columns begin at `first_col`.
  void clear(std::int64_t first_col) {
    hull_.clear();
    first_col_ = first_col;
  }
  /// Columns in ascending order.
  void add(const Site& site) {
    if (!hull_.empty()) {
      // Beside a straight rim each column is the nearest to itself.
      const auto& [before, from] = hull_.back();
      if (before.rise2 == site.rise2 && before.col + 1 == site.col && from <= before.col) {
        hull_.push_back({site, site.col});
        return;
      }
    }
    while (!hull_.empty()) {
      const auto& [top, from] = hull_.back();
      if (gap(top, from) <= gap(site, from)) break;
      hull_.pop_back();
    }
    if (hull_.empty()) {
      hull_.push_back({site, first_col_});
      return;
    }
    const Site& top = hull_.back().site;
    const std::int64_t numerator = site.col * site.col - top.col * top.col + site.rise2 - top.rise2;
    const std::int64_t denominator = 2 * (site.col - top.col);
    std::int64_t last = numerator / denominator;
    if (numerator < 0 && last * denominator != numerator) --last;
    hull_.push_back({site, last + 1});
  }
  bool empty() const { return hull_.empty(); }
  /// Sites in the order of columns, each with the first column where it is the nearest one.
  struct Entry {
    Site site;
    std::int64_t from;
  };
  const std::vector<Entry>& hull() const { return hull_; }
  static std::int64_t gap(const Site& site, std::int64_t col) {
    return (col - site.col) * (col - site.col) + site.rise2;
  }

 private:
  std::vector<Entry> hull_;
  std::int64_t first_col_ = 0;
};

/// Nearest rows with a height at or south, and at or north, of a post. Columns are followed as long as rows ask for
/// them one after the other, and looked up anew after a pause.
class NearestInColumn {
 public:
  static constexpr std::int64_t kNone = -1;
  struct Rows {
    std::int64_t south = kNone, north = kNone;  ///< kNone: none within the limit.
  };

  NearestInColumn(const PostGrid& grid, std::int64_t limit)
      : grid_(grid), limit_(limit), columns_(static_cast<std::size_t>(grid.n_cols)) {}

  /// Rows are asked for in ascending order.
  const Rows& at(std::int64_t r, std::int64_t c) {
    Column& column = columns_[static_cast<std::size_t>(c)];
    if (column.row == r) return column.nearest;
    Rows& nearest = column.nearest;
    if (column.row + 1 != r) {
      nearest.north = find_north(r, c);
      nearest.south = nearest.north == r ? r : find_south(r, c);
    } else {
      if (nearest.north == kNone) {
        if (r + limit_ < grid_.n_rows && has_height(r + limit_, c)) nearest.north = r + limit_;
      } else if (nearest.north < r) {
        nearest.north = find_north(r, c);
      }
      if (nearest.north == r) nearest.south = r;
      if (nearest.south != kNone && r - nearest.south > limit_) nearest.south = kNone;
    }
    column.row = r;
    return nearest;
  }

 private:
  struct Column {
    std::int64_t row = -2;  ///< The last one asked for.
    Rows nearest;
  };

  bool has_height(std::int64_t r, std::int64_t c) const {
    // Another thread may be making a void a post of the falloff, which is none that counts here either.
    const PostOrigin origin = std::atomic_ref(grid_.origins[grid_.index(r, c)]).load(std::memory_order_relaxed);
    return origin == PostOrigin::kSource || origin == PostOrigin::kFilled;
  }
  std::int64_t find_north(std::int64_t r, std::int64_t c) const {
    for (std::int64_t rr = r; rr <= std::min(r + limit_, grid_.n_rows - 1); ++rr) {
      if (has_height(rr, c)) return rr;
    }
    return kNone;
  }
  std::int64_t find_south(std::int64_t r, std::int64_t c) const {
    for (std::int64_t rr = r; rr >= std::max<std::int64_t>(r - limit_, 0); --rr) {
      if (has_height(rr, c)) return rr;
    }
    return kNone;
  }

  const PostGrid& grid_;
  const std::int64_t limit_;
  std::vector<Column> columns_;
};

/// The mean of each post's neighbours; `old` begins a post to the west of the others.
TIND_WIDE void relax_all(const float* south, const float* north, const float* old, float* __restrict out,
                         std::int64_t n) {
  for (std::int64_t k = 0; k < n; ++k) out[k] = (((south[k] + north[k]) + old[k]) + old[k + 2]) / 4.0f;
}

/// One row of one sweep: every post becomes the mean of its neighbours, those in the row as they were before it.
void relax_run(PostGrid& grid, const Run& run, std::vector<float>& before) {
  float* const own = grid.heights_m + grid.index(run.row, run.begin);
  const std::int64_t n = run.end - run.begin;
  before.resize(static_cast<std::size_t>(n + 2));
  std::copy(own, own + n, before.begin() + 1);
  const bool has_west = run.begin > 0 || grid.wraps, has_east = run.end < grid.n_cols || grid.wraps;
  if (has_west) before.front() = run.begin > 0 ? own[-1] : grid.heights_m[grid.index(run.row, grid.n_cols - 1)];
  if (has_east) before.back() = run.end < grid.n_cols ? own[n] : grid.heights_m[grid.index(run.row, 0)];
  const bool has_south = run.row > 0, has_north = run.row + 1 < grid.n_rows;
  const float* const south = has_south ? grid.heights_m + grid.index(run.row - 1, run.begin) : nullptr;
  const float* const north = has_north ? grid.heights_m + grid.index(run.row + 1, run.begin) : nullptr;
  const auto relax = [&](std::int64_t k) {
    float sum = 0;
    int n_sides = 0;
    const auto add = [&](float v) { sum += v, ++n_sides; };
    if (has_south) add(south[k]);
    if (has_north) add(north[k]);
    if (k > 0 || has_west) add(before[static_cast<std::size_t>(k)]);
    if (k + 1 < n || has_east) add(before[static_cast<std::size_t>(k + 2)]);
    own[k] = sum / static_cast<float>(n_sides);
  };
  if (!has_south || !has_north) {
    for (std::int64_t k = 0; k < n; ++k) relax(k);
    return;
  }
  relax(0);
  if (n == 1) return;
  relax_all(south + 1, north + 1, before.data() + 1, own + 1, n - 2);
  relax(n - 1);
}

/// Smooths the falloff posts in place; data and base posts are fixed. Runs are in the order of rows. A sweep goes from
/// south to north, and the next one follows it a row behind: the rows at work fit into caches, and a large grid's pages
/// are needed once. Threads share the sweeps: each begins a row when the sweeps before its own are through with it and
/// with the row north of it.
void relax_falloff(PostGrid& grid, const std::vector<Run>& runs, int threads) {
  if (runs.empty()) return;
  std::vector<std::size_t> first(static_cast<std::size_t>(grid.n_rows) + 1, 0);  // run of each row
  for (const Run& run : runs) ++first[static_cast<std::size_t>(run.row) + 1];
  for (std::size_t r = 1; r < first.size(); ++r) first[r] += first[r - 1];
  // Rows that a thread is through with. However it ends, those that wait for it go on.
  struct alignas(64) Done {
    std::atomic<std::int64_t> n_rows{0};

    void set(std::int64_t rows) {
      n_rows.store(rows, std::memory_order_release);
      n_rows.notify_all();
    }
    void wait_for(std::int64_t rows) const {
      for (std::int64_t now = 0; (now = n_rows.load(std::memory_order_acquire)) < rows;) n_rows.wait(now);
    }
  };
  struct AllDone {
    Done& done;
    std::int64_t n_rows;
    ~AllDone() { done.set(n_rows); }
  };
  const int n_parts = std::clamp(threads, 1, kFalloffSweeps);
  std::vector<Done> done(static_cast<std::size_t>(n_parts));
  for_each_job({n_parts, grid.cancel, {}}, n_parts, [&](int, std::int64_t part) {
    const AllDone at_end{done[static_cast<std::size_t>(part)], grid.n_rows};
    const std::int64_t n_sweeps = kFalloffSweeps * (part + 1) / n_parts - kFalloffSweeps * part / n_parts;
    std::vector<float> before;
    for (std::int64_t front = 0; front < grid.n_rows + n_sweeps - 1 && !is_set(grid.cancel); ++front) {
      if (part > 0) done[static_cast<std::size_t>(part - 1)].wait_for(std::min(front + 2, grid.n_rows));
      const std::int64_t last = std::max<std::int64_t>(0, front - n_sweeps + 1);
      for (std::int64_t row = std::min(front, grid.n_rows - 1); row >= last; --row) {
        const auto r = static_cast<std::size_t>(row);
        for (std::size_t k = first[r]; k < first[r + 1]; ++k) relax_run(grid, runs[k], before);
      }
      if (front + 1 >= n_sweeps && front % kRowsAtOnce == 0) at_end.done.set(last + 1);
    }
  });
}

/// Gives the voids of a band of rows that lie near posts the height of the nearest one, less the nearer the base is.
class FalloffRows {
 public:
  FalloffRows(PostGrid& grid, double base_height_m, std::int64_t limit)
      : grid_(grid), base_height_m_(base_height_m), limit_(limit), columns_(grid, limit) {
    constexpr std::int64_t kMostKept = std::int64_t{1} << 14;
    for (std::int64_t d2 = 0; d2 < std::min(limit * limit, kMostKept); ++d2) {
      shares_.push_back(share_of(static_cast<double>(d2)));
    }
  }

  /// Adds the runs of falloff posts. Bands come in ascending order.
  void settle(std::int64_t row_begin, std::int64_t row_end, std::vector<Run>& falloff) {
    for (std::int64_t r = row_begin; r < row_end && !is_set(grid_.cancel); ++r) settle_row(r, falloff);
  }

 private:
  /// How much is left of the nearest post's height above the base, at the square of a whole distance in posts.
  double share_of(double distance2) const { return 1.0 - std::sqrt(distance2) / static_cast<double>(limit_); }
  double share_at(double distance2) const {
    const auto at = static_cast<std::size_t>(distance2);
    return at < shares_.size() ? shares_[at] : share_of(distance2);
  }

  void settle_row(std::int64_t r, std::vector<Run>& falloff) {
    const std::int64_t n_cols = grid_.n_cols, rim = grid_.rim;
    if (rim == 0 || r < rim || r >= grid_.n_rows - rim) {
      settle_part(r, 0, n_cols, falloff);
    } else {
      settle_part(r, 0, rim, falloff);
      settle_part(r, n_cols - rim, n_cols, falloff);
    }
  }

  // Columns [first, end) of a row, which lie together.
  void settle_part(std::int64_t r, std::int64_t first, std::int64_t end, std::vector<Run>& falloff) {
    const PostOrigin* const part = grid_.origins + grid_.index(r, first);
    const std::int64_t n = end - first;
    for (std::int64_t k = next_void(part, 0, n); k < n; k = next_void(part, k, n)) {
      const std::int64_t begin = k;
      k = next_post(part, k, n);
      settle_run({r, first + begin, first + k}, falloff);
    }
  }

  // The nearest posts of a run's columns. A post beside the run is nearer to it than all beyond, so only a run that
  // ends at the grid's seam is looked at further.
  void find_nearest(const Run& run) {
    const std::int64_t r = run.row, n_cols = grid_.n_cols;
    const std::int64_t at_seam = grid_.wraps ? limit_ : 0;
    const std::int64_t begin = run.begin - (run.begin > 0 ? 1 : at_seam),
                       end = run.end + (run.end < n_cols ? 1 : at_seam);
    nearest_.clear(begin);
    for (std::int64_t col = begin; col < end; ++col) {
      const bool is_wrapped = col < 0 || col >= n_cols;
      const NearestInColumn::Rows& rows = columns_.at(r, is_wrapped ? ((col % n_cols) + n_cols) % n_cols : col);
      if (rows.south == NearestInColumn::kNone && rows.north == NearestInColumn::kNone) continue;
      const bool south = rows.north == NearestInColumn::kNone ||
                         (rows.south != NearestInColumn::kNone && r - rows.south <= rows.north - r);
      const std::int64_t nearest_row = south ? rows.south : rows.north;
      nearest_.add({col, nearest_row, (nearest_row - r) * (nearest_row - r)});
    }
  }

  void settle_run(const Run& run, std::vector<Run>& falloff) {
    find_nearest(run);
    const std::int64_t n_cols = grid_.n_cols;
    float* const heights = grid_.heights_m + grid_.index(run.row, run.begin);
    PostOrigin* const origins = grid_.origins + grid_.index(run.row, run.begin);
    const auto& hull = nearest_.hull();
    const auto n = static_cast<std::size_t>(run.end - run.begin);
    // Before neighbours are read: a page of the map that is read first is faulted in a second time to be written.
    std::fill_n(heights, n, static_cast<float>(base_height_m_));
    if (hull.empty()) return;
    distances2_.resize(n);
    values_.resize(n);
    auto entry = std::upper_bound(hull.begin(), hull.end(), run.begin,
                                  [](std::int64_t c, const NearestInRow::Entry& e) { return c < e.from; });
    if (entry != hull.begin()) --entry;
    for (std::int64_t c = run.begin; c < run.end; ++entry) {
      const std::int64_t end = entry + 1 == hull.end() ? run.end : std::min(run.end, (entry + 1)->from);
      const NearestInRow::Site& site = entry->site;
      const std::int64_t col = site.col < 0 || site.col >= n_cols ? ((site.col % n_cols) + n_cols) % n_cols : site.col;
      const double value = c < end ? grid_.heights_m[grid_.index(site.row, col)] : 0;
      for (; c < end; ++c) {
        distances2_[static_cast<std::size_t>(c - run.begin)] = static_cast<double>(NearestInRow::gap(site, c));
        values_[static_cast<std::size_t>(c - run.begin)] = value;
      }
    }
    const double limit2 = static_cast<double>(limit_ * limit_), base = base_height_m_;
    const auto base_height = static_cast<float>(base_height_m_);
    const double *distances2 = distances2_.data(), *values = values_.data();
    float* __restrict out = heights;
    for (std::size_t k = 0; k < n; ++k) {
      out[k] = distances2[k] < limit2 ? static_cast<float>(base + share_at(distances2[k]) * (values[k] - base))
                                      : base_height;
    }
    for (std::int64_t c = run.begin; c < run.end;) {
      const auto is_near = [&] { return distances2_[static_cast<std::size_t>(c - run.begin)] < limit2; };
      const std::int64_t begin = c;
      for (; c < run.end && is_near(); ++c)
        std::atomic_ref(origins[c - run.begin]).store(PostOrigin::kFalloff, std::memory_order_relaxed);
      if (c > begin) falloff.push_back({run.row, begin, c});
      while (c < run.end && !is_near()) ++c;
    }
  }

  PostGrid& grid_;
  const double base_height_m_;
  const std::int64_t limit_;
  NearestInColumn columns_;
  NearestInRow nearest_;
  std::vector<double> shares_;               ///< share_of() the first squares.
  std::vector<double> distances2_, values_;  ///< Of a run: squared distances to the nearest posts, and their heights.
};

}  // namespace

std::uint64_t add_falloff(PostGrid& grid, double base_height_m, std::int64_t falloff_posts, int threads) {
  const std::int64_t n_bands = (grid.n_rows + kBandOfRows - 1) / kBandOfRows;
  std::vector<FalloffRows> workers;
  for (int k = 0; k < threads; ++k) workers.emplace_back(grid, base_height_m, falloff_posts);
  std::vector<std::vector<Run>> bands(static_cast<std::size_t>(n_bands));
  for_each_job({threads, grid.cancel, {}}, n_bands, [&](int worker, std::int64_t band) {
    const std::int64_t begin = band * kBandOfRows, end = std::min(begin + kBandOfRows, grid.n_rows);
    workers[static_cast<std::size_t>(worker)].settle(begin, end, bands[static_cast<std::size_t>(band)]);
  });
  std::vector<Run> falloff;
  std::uint64_t n_falloff = 0;
  for (std::vector<Run>& band : bands) {
    falloff.insert(falloff.end(), band.begin(), band.end());
    band = {};
  }
  for (const Run& run : falloff) n_falloff += static_cast<std::uint64_t>(run.end - run.begin);
  relax_falloff(grid, falloff, threads);
  return n_falloff;
}

}  // namespace tind
