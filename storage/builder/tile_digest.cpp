// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/tile_digest.hpp"

#include <algorithm>
#include <cmath>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "core/drainage/flow_run.hpp"
#include "storage/digest.hpp"
#include "storage/builder/version.hpp"

namespace tind {
namespace {

// Numbers of one kind, with how many there are.
template <class T>
void add_all(Digest& digest, const std::vector<T>& values) {
  digest.add_value(static_cast<std::uint64_t>(values.size()));
  digest.add(values.data(), values.size() * sizeof(T));
}

void add_vertex(std::vector<std::int64_t>& numbers, const LocalVertex& v) {
  numbers.insert(numbers.end(), {v.x, v.y, std::int64_t{v.z}});
}

void add_task(Digest& digest, const TileTask& task) {
  std::vector<std::int64_t> numbers = {task.key.level, task.key.x, task.key.y};
  add_all(digest, numbers);
  digest.add_value(task.tolerance_m);
  digest.add_value(task.height_step_m);
  numbers.clear();
  for (const LocalVertex& v : task.initial) add_vertex(numbers, v);
  add_all(digest, numbers);
  numbers.clear();
  for (const auto& piece : task.constraints) {
    add_vertex(numbers, piece[0]);
    add_vertex(numbers, piece[1]);
  }
  add_all(digest, numbers);
}

void add_borders(Digest& digest, const std::array<std::span<const LineVertex>, 4>& borders) {
  std::vector<std::int64_t> numbers;
  for (const auto& border : borders) {
    numbers.clear();
    for (const LineVertex& v : border) {
      numbers.insert(numbers.end(), {v.t - border.front().t, std::int64_t{v.z}, std::int64_t{v.entry}});
    }
    add_all(digest, numbers);
  }
}

bool is_all_source(const PostOrigin* origins, std::size_t n) {
  return std::all_of(origins, origins + n, [](PostOrigin origin) { return origin == PostOrigin::kSource; });
}

// Heights of a window that lies in the grid, row by row, and then, where not all are the source's, origins.
void add_window(Digest& digest, const HeightField& field, const PostBlocks::Extent& w) {
  const auto n_cols = static_cast<std::size_t>(w.n_cols), n = static_cast<std::size_t>(w.n_posts());
  const bool is_known = field.pages != nullptr && field.pages->is_known_source(w.row, w.col, w.n_rows, w.n_cols);
  bool all_source = true;
  thread_local std::vector<float> heights;
  thread_local std::vector<PostOrigin> origins;
  if (field.pages == nullptr) {
    for (std::int64_t r = w.row; r < w.row + w.n_rows; ++r) {
      const HeightField::Posts row = field.posts_from(r, w.col);
      digest.add(row.heights_m, n_cols * sizeof(float));
      all_source = all_source && is_all_source(row.origins, n_cols);
    }
  } else {
    origins.resize(is_known ? 0 : n);
    // As many rows at once as pages have.
    for (std::int64_t r = w.row, end = r; r < w.row + w.n_rows; r = end) {
      end = std::min(w.row + w.n_rows, (r / PostPages::kSide + 1) * PostPages::kSide);
      const std::size_t n_now = static_cast<std::size_t>(end - r) * n_cols;
      heights.resize(std::max(heights.size(), n_now));
      PostOrigin* const to = is_known ? nullptr : origins.data() + static_cast<std::size_t>(r - w.row) * n_cols;
      field.pages->copy(r, w.col, end - r, w.n_cols, heights.data(), to);
      digest.add(heights.data(), n_now * sizeof(float));
    }
    all_source = is_known || is_all_source(origins.data(), n);
  }
  digest.add_value(static_cast<std::uint8_t>(all_source ? 1 : 0));
  if (all_source) return;
  if (field.pages != nullptr) {
    digest.add(origins.data(), n * sizeof(PostOrigin));
    return;
  }
  for (std::int64_t r = w.row; r < w.row + w.n_rows; ++r) {
    digest.add(field.posts_from(r, w.col).origins, n_cols * sizeof(PostOrigin));
  }
}

// The grid where it meets the tile and one post more, told as the tile sees it: a grid that grew elsewhere is the same.
void add_posts(Digest& digest, const HeightField& field, const TileKey& key) {
  const double side = static_cast<double>(field.lattice.tile_side(key.level));
  const double width = static_cast<double>(field.lattice.width());
  const double west = side * key.x, south = side * key.y;
  const auto r_low = static_cast<std::int64_t>(std::floor((south - field.y0) / field.dy));
  const auto r_high = static_cast<std::int64_t>(std::ceil((south + side - field.y0) / field.dy));
  const std::int64_t r_first = std::max<std::int64_t>(r_low, 0), r_last = std::min(r_high, field.n_rows - 1);
  for (const double turn : {-width, 0.0, width}) {
    const auto c_low = static_cast<std::int64_t>(std::floor((west - field.x0 - turn) / field.dx));
    const auto c_high = static_cast<std::int64_t>(std::ceil((west + side - field.x0 - turn) / field.dx));
    const std::int64_t c_first = std::max<std::int64_t>(c_low, 0), c_last = std::min(c_high, field.n_cols - 1);
    if (c_first > c_last || r_first > r_last) continue;
    const std::array<std::int64_t, 4> size = {c_first - c_low, c_high - c_last, r_first - r_low, r_high - r_last};
    digest.add(size.data(), sizeof size);
    digest.add_value(field.post_x(c_first) + turn - west);
    digest.add_value(field.post_y(r_first) - south);
    add_window(digest, field, {r_first, c_first, r_last - r_first + 1, c_last - c_first + 1});
  }
}

// Morton codes of the tiles that add_posts may find a post for, ascending.
std::vector<std::uint64_t> tiles_near_posts(const HeightField& field, int level) {
  const double side = static_cast<double>(field.lattice.tile_side(level));
  const double width = static_cast<double>(field.lattice.width());
  const auto tiles = [side](double first, double last, std::uint32_t n) {
    const double end = static_cast<double>(n - 1);
    const auto low = static_cast<std::uint32_t>(std::clamp(std::floor(first / side), 0.0, end));
    const bool any = last >= 0 && first <= side * static_cast<double>(n);
    return std::pair(low, any ? static_cast<std::uint32_t>(std::clamp(std::floor(last / side), 0.0, end)) + 1 : low);
  };
  const auto [y_begin, y_end] =
      tiles(field.y0 - field.dy, field.post_y(field.n_rows - 1) + field.dy, TileKey::count_y(level));
  std::vector<std::uint64_t> codes;
  for (const double turn : {-width, 0.0, width}) {
    const auto [x_begin, x_end] =
        tiles(field.x0 - field.dx + turn, field.post_x(field.n_cols - 1) + field.dx + turn, TileKey::count_x(level));
    for (std::uint32_t y = y_begin; y < y_end; ++y) {
      for (std::uint32_t x = x_begin; x < x_end; ++x) codes.push_back(morton_code(x, y));
    }
  }
  std::sort(codes.begin(), codes.end());
  codes.erase(std::unique(codes.begin(), codes.end()), codes.end());
  return codes;
}

// What the grid is like, whatever its posts are.
void add_grid(Digest& digest, const HeightField& field, const TileKey& key) {
  digest.add_value(field.dx);
  digest.add_value(field.dy);
  digest.add_value(field.base_height_m);
  digest.add_value(static_cast<std::int32_t>(field.lattice.level));
  digest.add_value(static_cast<std::int32_t>(field.lattice.height_exponent));
  // Beyond the last rows the surface may go on to the pole.
  const bool at_south = key.y == 0, at_north = key.y + 1 == TileKey::count_y(key.level);
  digest.add_value(static_cast<std::uint8_t>(field.wraps));
  digest.add_value(static_cast<std::uint8_t>(at_south && field.continues_south));
  digest.add_value(static_cast<std::uint8_t>(at_north && field.continues_north));
  if (at_south) digest.add_value(field.south_pole_m);
  if (at_north) digest.add_value(field.north_pole_m);
}

// Lattice points with a height of their own, ascending by (y, x). A coarse tile has nearly all of them: they are not
// collected.
void add_pinned(Digest& digest, std::span<const LatticePoint> all, std::int64_t west, std::int64_t south,
                std::int64_t side) {
  const auto from = [&all](auto first, std::int64_t y, std::int64_t x) {
    return std::lower_bound(first, all.end(), std::pair{y, x}, [](const LatticePoint& p, const auto& yx) {
      return std::pair{p.y, p.x} < yx;
    });
  };
  std::vector<std::span<const LatticePoint>> rows;
  std::uint64_t n = 0;
  for (auto at = from(all.begin(), south, west); at != all.end() && at->y <= south + side;) {
    if (at->x < west || at->x > west + side) {  // on to the next row that can meet the tile
      at = from(at, at->x < west ? at->y : at->y + 1, west);
      continue;
    }
    const auto first = at;
    while (at != all.end() && at->y == first->y && at->x <= west + side) ++at;
    rows.emplace_back(first, at);
    n += rows.back().size();
  }
  digest.add_value(3 * n);
  std::vector<std::int64_t> numbers;
  for (const std::span<const LatticePoint> row : rows) {
    numbers.clear();
    for (const LatticePoint& p : row) numbers.insert(numbers.end(), {p.x - west, p.y - south, std::int64_t{p.z}});
    digest.add(numbers.data(), numbers.size() * sizeof(std::int64_t));
  }
}

// Irregular posts, and lattice points with a height of their own.
void add_points(Digest& digest, const HeightField& field, const TileKey& key) {
  const std::int64_t side = field.lattice.tile_side(key.level);
  const std::int64_t west = side * key.x, south = side * key.y;
  std::vector<double> posts;
  for (const double turn : {0.0, static_cast<double>(field.lattice.width())}) {
    const double x = static_cast<double>(west) + turn, y = static_cast<double>(south), s = static_cast<double>(side);
    field.points.for_blocks(x - 1, y - 1, x + s + 1, y + s + 1, [&](const PointPost& p) {
      if (p.x < x - 1 || p.x > x + s + 1 || p.y < y - 1 || p.y > y + s + 1) return;
      posts.insert(posts.end(), {p.x - x, p.y - y, static_cast<double>(p.height_m)});
    });
  }
  add_all(digest, posts);
  add_pinned(digest, field.pinned.points(), west, south, side);
}

}  // namespace

PostDigests::PostDigests(const HeightField& field, int finest_level, int threads, const std::atomic<bool>* cancel)
    : levels_(static_cast<std::size_t>(finest_level) + 1) {
  std::vector<Entry>& finest = levels_.back();
  for (const std::uint64_t code : tiles_near_posts(field, finest_level)) finest.push_back({code, {}});
  for_each_job({threads, cancel, {}}, static_cast<std::int64_t>(finest.size()), [&](int, std::int64_t job) {
    Entry& entry = finest[static_cast<std::size_t>(job)];
    Digest digest;
    add_posts(
        digest, field,
        {static_cast<std::uint8_t>(finest_level), morton_decode_even(entry.code), morton_decode_even(entry.code >> 1)});
    entry.digest = digest.finish();
  });
  for (std::size_t level = levels_.size() - 1; level > 0; --level) {
    const std::vector<Entry>& finer = levels_[level];
    for (auto at = finer.begin(); at != finer.end();) {
      const std::uint64_t parent = at->code / 4;
      Digest digest;
      for (; at != finer.end() && at->code / 4 == parent; ++at) {
        digest.add_value(static_cast<std::uint8_t>(at->code % 4));
        digest.add(at->digest.data(), at->digest.size());
      }
      levels_[level - 1].push_back({parent, digest.finish()});
    }
  }
}

TileInputs::Digest PostDigests::of(const TileKey& key) const {
  const std::vector<Entry>& level = levels_[key.level];
  const std::uint64_t code = morton_code(key.x, key.y);
  const auto at = std::lower_bound(level.begin(), level.end(), code,
                                   [](const Entry& entry, std::uint64_t wanted) { return entry.code < wanted; });
  return at != level.end() && at->code == code ? at->digest : TileInputs::Digest{};
}

TileInputs::Digest frame_digest(const HeightField& field, const TileTask& task,
                                const std::array<std::span<const LineVertex>, 4>& borders, int n_gaps) {
  Digest digest;
  constexpr std::string_view kMaker = kGenerator;
  digest.add(kMaker.data(), kMaker.size());
  digest.add_value(static_cast<std::int32_t>(n_gaps));
  add_task(digest, task);
  add_borders(digest, borders);
  add_grid(digest, field, task.key);
  add_points(digest, field, task.key);
  return digest.finish();
}

std::uint64_t vertex_posts_digest(const VertexPosts& posts) {
  Digest digest;
  digest.add_value(posts.served_step_m);
  add_all(digest, posts.heights_m);
  const TileInputs::Digest all = digest.finish();
  std::uint64_t first = 0;
  for (std::size_t k = 0; k < sizeof first; ++k) first = first << 8 | all[k];
  return first;
}

}  // namespace tind
