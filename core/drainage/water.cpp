// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/drainage/water.hpp"

#include <algorithm>
#include <atomic>
#include <limits>
#include <utility>

#include "core/registers.hpp"

namespace tind {
namespace {

// Bits that have no meaning yet when these functions are called; they are cleared again.
constexpr std::uint8_t kSeen = kInFlat;
constexpr std::uint8_t kCore = kBasin;

/// Collects 4-connected pieces of posts, run by run.
class PieceFill {
 public:
  explicit PieceFill(const FlowGrid& grid) : g_(grid) {}

  /// The piece of `seed`: its posts with `member(i)` that are not kSeen; they are, after that. Valid until the next
  /// call.
  template <class Member>
  const std::vector<PostRun>& fill(std::int64_t seed, Member&& member) {
    runs_.clear();
    const auto open = [&](std::int64_t i) { return !(g_.marks[i] & kSeen) && member(i); };
    // Adds the run around an open post; returns the index behind it.
    const auto add = [&](std::int64_t i, std::int64_t row) {
      std::int64_t begin = i, end = i;
      while (begin > row && open(begin - 1)) --begin;
      while (end < row + g_.n_cols && open(end)) ++end;
      for (std::int64_t k = begin; k < end; ++k) g_.marks[k] |= kSeen;
      runs_.push_back({begin, end});
      return end;
    };
    add(seed, seed - seed % g_.n_cols);
    for (std::size_t k = 0; k < runs_.size(); ++k) {
      const PostRun run = runs_[k];
      const std::int64_t r = run.begin / g_.n_cols, row = r * g_.n_cols, last = row + g_.n_cols - 1;
      if (g_.wraps && run.begin == row && open(last)) add(last, row);
      if (g_.wraps && run.end == last + 1 && open(row)) add(row, row);
      for (const std::int64_t step : {-g_.n_cols, g_.n_cols}) {
        if (r + (step < 0 ? -1 : 1) < 0 || r + (step < 0 ? -1 : 1) >= g_.n_rows) continue;
        for (std::int64_t i = run.begin + step; i < run.end + step; ++i) {
          if (open(i)) i = add(i, row + step);
        }
      }
    }
    return runs_;
  }

 private:
  const FlowGrid& g_;
  std::vector<PostRun> runs_;
};

void clear_marks(const FlowGrid& g, std::uint8_t bits, const FlowRun& run) {
  for_row_bands(run, g.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
    for (std::int64_t i = row_begin * g.n_cols; i < row_end * g.n_cols; ++i) {
      g.marks[i] = static_cast<std::uint8_t>(g.marks[i] & ~bits);
    }
  });
}

/// Of the 4-connected pieces of posts with `bit` leaves it to those of a size. Returns the number of posts that have
/// it.
std::int64_t keep_large(const FlowGrid& g, std::uint8_t bit, double min_area_m2, std::int64_t min_posts,
                        const FlowRun& run) {
  PieceFill pieces(g);
  std::int64_t n_kept = 0;
  for (std::int64_t r = 0; r < g.n_rows && !run.stopped(); ++r) {
    const std::int64_t end = (r + 1) * g.n_cols;
    for (std::int64_t i = next_marked(g.marks, r * g.n_cols, end, bit); i < end;
         i = next_marked(g.marks, i + 1, end, bit)) {
      if (g.marks[i] & kSeen) continue;
      const auto& runs = pieces.fill(i, [&](std::int64_t n) { return (g.marks[n] & bit) != 0; });
      double area_m2 = 0;
      std::int64_t n = 0;
      for (const PostRun& part : runs) {
        area_m2 += g.area_m2(part.begin / g.n_cols) * static_cast<double>(part.end - part.begin);
        n += part.end - part.begin;
      }
      if (n >= min_posts && area_m2 >= min_area_m2) {
        n_kept += n;
        continue;
      }
      for (const PostRun& part : runs) {
        for (std::int64_t k = part.begin; k < part.end; ++k) g.marks[k] = static_cast<std::uint8_t>(g.marks[k] & ~bit);
      }
    }
  }
  clear_marks(g, kSeen, run);
  return n_kept;
}

/// Sets `bit` where member(i). True iff it is set anywhere.
template <class Member>
bool mark_where(const FlowGrid& g, std::uint8_t bit, const FlowRun& run, Member&& member) {
  std::atomic<bool> any{false};
  for_row_bands(run, g.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
    std::uint8_t found = 0;
    for (std::int64_t i = row_begin * g.n_cols; i < row_end * g.n_cols; ++i) {
      const std::uint8_t add = member(i) ? bit : std::uint8_t{0};
      g.marks[i] = static_cast<std::uint8_t>(g.marks[i] | add);
      found = static_cast<std::uint8_t>(found | add);
    }
    if (found) any = true;
  });
  return any;
}

/// Whether a post may be of a flat that carries a lake. Looks at no bit that changes here.
bool may_be_lake(const FlowGrid& g, std::int64_t i, float sea_level_m) {
  const std::uint8_t mark = g.marks[i] & (kInside | kVoid | kSea);
  return mark == kInside || (mark == (kInside | kSea) && g.heights_m[i] == sea_level_m);
}

/// Of posts [0, n): whether the eight neighbours have the post's height. Most chunks are told by the first two.
TIND_WIDE_OR_MASKED void mark_level(const float* heights, std::int64_t n_cols, std::int64_t n, std::uint8_t* level) {
  constexpr std::int64_t kChunk = 64;
  for (std::int64_t begin = 0; begin < n; begin += kChunk) {
    const std::int64_t end = begin + kChunk < n ? begin + kChunk : n;
    for (std::int64_t c = begin; c < end; ++c) {
      level[c] = (heights[c - 1] == heights[c]) & (heights[c + 1] == heights[c]) ? 1 : 0;
    }
    for (const std::int64_t step : {n_cols, -n_cols}) {
      std::uint8_t any = 0;
      for (std::int64_t c = begin; c < end; ++c) any = static_cast<std::uint8_t>(any | level[c]);
      if (any == 0) break;
      const float* const beside = heights + step;
      for (std::int64_t c = begin; c < end; ++c) {
        const bool equal = (beside[c - 1] == heights[c]) & (beside[c] == heights[c]) & (beside[c + 1] == heights[c]);
        level[c] = static_cast<std::uint8_t>(level[c] & (equal ? 1 : 0));
      }
    }
  }
}

/// Sets kCore in a row: posts whose eight neighbours may be of a lake, as they may, and have their height.
void mark_cores(const FlowGrid& g, std::int64_t r, float sea_level_m, std::vector<std::uint8_t>& core) {
  if (r == 0 || r + 1 == g.n_rows || g.n_cols < 3) return;
  const float* const heights = g.heights_m + r * g.n_cols;
  core.front() = core.back() = 1;  // what lies beside them is looked at below
  mark_level(heights + 1, g.n_cols, g.n_cols - 2, core.data() + 1);
  const std::int64_t row = r * g.n_cols;
  const auto all_may = [&](std::int64_t c) {
    for (int d = 0; d < 8; ++d) {
      const std::int64_t n = g.neighbour(r, c, d);
      if (n < 0 || !may_be_lake(g, n, sea_level_m) || g.heights_m[n] != heights[c]) return false;
    }
    return may_be_lake(g, row + c, sea_level_m);
  };
  for (std::int64_t c = next_marked(core.data(), 0, g.n_cols, 1); c < g.n_cols;
       c = next_marked(core.data(), c + 1, g.n_cols, 1)) {
    if (all_may(c)) g.marks[row + c] |= kCore;
  }
}

/// One step of shore: from post `first` in direction `second` (0, 2, 4 or 6), the lake on the left.
using Side = std::pair<std::int64_t, int>;

}  // namespace

std::int64_t mark_sea(const FlowGrid& g, std::optional<double> sea_level_m, const FlowRun& run) {
  const double level_m = sea_level_m.value_or(0);
  const bool any = mark_where(g, kSea, run, [&](std::int64_t i) {
    return (g.marks[i] & kInside) && static_cast<double>(g.heights_m[i]) <= level_m;
  });
  if (!any) return 0;
  return sea_level_m ? keep_large(g, kSea, 0, 0, run) : keep_large(g, kSea, kSeaAreaM2, 0, run);
}

std::vector<Lake> mark_lakes(const FlowGrid& g, double min_area_m2, double sea_level, const FlowRun& run) {
  // A sea level that is no float has no post at it.
  const auto nearest = static_cast<float>(sea_level);
  const float sea_level_m =
      static_cast<double>(nearest) == sea_level ? nearest : std::numeric_limits<float>::quiet_NaN();
  for_row_bands(run, g.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
    std::vector<std::uint8_t> core(static_cast<std::size_t>(g.n_cols));
    for (std::int64_t r = row_begin; r < row_end; ++r) mark_cores(g, r, sea_level_m, core);
  });
  std::vector<Lake> lakes;
  PieceFill pieces(g);
  const auto is_core = [&](std::int64_t i) { return (g.marks[i] & kCore) != 0; };
  const auto measure = [&](std::int64_t first) {
    const float height_m = g.heights_m[first];
    const auto& runs = pieces.fill(
        first, [&](std::int64_t i) { return g.heights_m[i] == height_m && may_be_lake(g, i, sea_level_m); });
    Lake lake;
    lake.height_m = static_cast<double>(height_m);
    lake.root = first;
    for (const PostRun& part : runs) {
      lake.root = std::min(lake.root, part.begin);
      std::int64_t n = 0;
      for (std::int64_t i = part.begin; i < part.end; ++i) n += is_core(i) ? 1 : 0;
      lake.core_posts += n;
      lake.core_area_m2 += g.area_m2(part.begin / g.n_cols) * static_cast<double>(n);
    }
    if (lake.core_posts < kLakePosts || lake.core_area_m2 < min_area_m2) return;
    for (const PostRun& part : runs) {
      const std::int64_t r = part.begin / g.n_cols;
      for (std::int64_t i = part.begin; i < part.end; ++i) {
        for (const int d : {0, 2, 4, 6}) {
          const std::int64_t n = g.neighbour(r, i - r * g.n_cols, d);
          if (n < 0 || !(g.marks[n] & kInside)) continue;
          if (g.heights_m[n] == height_m && may_be_lake(g, n, sea_level_m)) continue;  // of the flat
          ++lake.rim;
          if (g.heights_m[n] < height_m) ++lake.lower_rim;
        }
      }
    }
    if (static_cast<double>(lake.lower_rim) > kLakeLowerRim * static_cast<double>(lake.rim)) return;
    for (const PostRun& part : runs) {
      const std::int64_t r = part.begin / g.n_cols;
      for (std::int64_t i = part.begin; i < part.end; ++i) {
        if (!is_core(i)) continue;
        g.marks[i] |= kLake;
        for (int d = 0; d < 8; ++d) g.marks[g.neighbour(r, i - r * g.n_cols, d)] |= kLake;
      }
    }
    lake.runs = runs;
    lakes.push_back(std::move(lake));
  };
  for (std::int64_t r = 0; r < g.n_rows && !run.stopped(); ++r) {
    const std::int64_t end = (r + 1) * g.n_cols;
    for (std::int64_t i = next_marked(g.marks, r * g.n_cols, end, kCore); i < end;
         i = next_marked(g.marks, i + 1, end, kCore)) {
      if (!(g.marks[i] & kSeen)) measure(i);
    }
  }
  clear_marks(g, kSeen | kCore, run);
  std::sort(lakes.begin(), lakes.end(), [](const Lake& a, const Lake& b) { return a.root < b.root; });
  return lakes;
}

std::int64_t mark_basins(const FlowGrid& g, const float* filled_m, double max_depth_m, double min_area_m2,
                         const FlowRun& run) {
  const bool any = mark_where(g, kBasin, run, [&](std::int64_t i) {
    return (g.marks[i] & kInside) &&
           static_cast<double>(filled_m[i]) - static_cast<double>(g.heights_m[i]) > max_depth_m;
  });
  return any ? keep_large(g, kBasin, min_area_m2, kLakePosts, run) : 0;
}

std::vector<ShoreLine> shore_lines(const FlowGrid& g, std::span<const Lake> lakes,
                                   const std::function<bool(std::int64_t)>& is_node) {
  struct Part {
    std::int64_t begin = 0;
    std::size_t lake = 0;
  };
  std::vector<Part> parts;
  for (std::size_t k = 0; k < lakes.size(); ++k) {
    for (const PostRun& part : lakes[k].runs) parts.push_back({part.begin, k});
  }
  std::sort(parts.begin(), parts.end(), [](const Part& a, const Part& b) { return a.begin < b.begin; });
  const auto lake_of = [&](std::int64_t post) {
    const auto above = std::upper_bound(parts.begin(), parts.end(), post,
                                        [](std::int64_t i, const Part& part) { return i < part.begin; });
    return std::prev(above)->lake;
  };
  // Square (r, c) has post (r, c) as its south-western corner.
  const auto full = [&](std::int64_t r, std::int64_t c) {
    if (r < 0 || r + 1 >= g.n_rows) return false;
    if (c < 0 || c >= g.n_cols) {
      if (!g.wraps) return false;
      c = c < 0 ? g.n_cols - 1 : 0;
    }
    const std::int64_t east = g.neighbour(r, c, 0);
    if (east < 0) return false;
    const std::int64_t i = r * g.n_cols + c;
    for (const std::int64_t post : {i, east, i + g.n_cols, east + g.n_cols}) {
      // Posts of one height side by side belong to one lake.
      if (!(g.marks[post] & kLake) || g.heights_m[post] != g.heights_m[i]) return false;
    }
    return true;
  };
  std::vector<Side> sides;
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    const std::int64_t row = r * g.n_cols, end = row + g.n_cols;
    for (std::int64_t i = next_marked(g.marks, row, end, kLake); i < end; i = next_marked(g.marks, i + 1, end, kLake)) {
      const std::int64_t c = i - row;
      const bool ne = full(r, c), nw = full(r, c - 1), sw = full(r - 1, c - 1), se = full(r - 1, c);
      if (ne && !se) sides.emplace_back(i, 0);
      if (nw && !ne) sides.emplace_back(i, 2);
      if (sw && !nw) sides.emplace_back(i, 4);
      if (se && !sw) sides.emplace_back(i, 6);
    }
  }
  const auto from = [&](std::int64_t post) {
    return std::lower_bound(sides.begin(), sides.end(), Side{post, 0}) - sides.begin();
  };
  const auto count_from = [&](std::int64_t post) {
    std::int64_t n = 0;
    for (auto k = static_cast<std::size_t>(from(post)); k < sides.size() && sides[k].first == post; ++k) ++n;
    return n;
  };
  const auto cut_at = [&](std::int64_t post) { return count_from(post) > 1 || is_node(post); };
  std::vector<bool> used(sides.size(), false);
  std::vector<ShoreLine> lines;
  const auto trace = [&](std::size_t first) {
    ShoreLine line;
    line.lake = lake_of(sides[first].first);
    std::size_t k = first;
    line.posts.push_back(sides[k].first);
    for (;;) {
      used[k] = true;
      const auto [post, direction] = sides[k];
      const std::int64_t next = g.neighbour(post / g.n_cols, post % g.n_cols, direction);
      line.posts.push_back(next);
      if (next == line.posts.front() || cut_at(next)) break;
      k = static_cast<std::size_t>(from(next));  // the only way on
    }
    lines.push_back(std::move(line));
  };
  // First the stretches between nodes, then the rings without one.
  for (std::size_t k = 0; k < sides.size(); ++k) {
    if (cut_at(sides[k].first)) trace(k);
  }
  for (std::size_t k = 0; k < sides.size(); ++k) {
    if (!used[k]) trace(k);
  }
  std::sort(lines.begin(), lines.end(), [](const ShoreLine& a, const ShoreLine& b) {
    return std::lexicographical_compare(a.posts.begin(), a.posts.begin() + 2, b.posts.begin(), b.posts.begin() + 2);
  });
  return lines;
}

}  // namespace tind
