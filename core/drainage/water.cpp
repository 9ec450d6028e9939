// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/drainage/water.hpp"

#include <algorithm>
#include <unordered_map>

namespace tind {
namespace {

/// Union-find over the posts, in one array: labels[i] is a post of the same piece, at most i; the root is the first.
std::int64_t find_root(std::int64_t* labels, std::int64_t i) {
  while (labels[i] != i) {
    labels[i] = labels[labels[i]];
    i = labels[i];
  }
  return i;
}

void unite(std::int64_t* labels, std::int64_t a, std::int64_t b) {
  a = find_root(labels, a);
  b = find_root(labels, b);
  if (a < b) {
    labels[b] = a;
  } else {
    labels[a] = b;
  }
}

/// Labels 4-connected pieces of posts with `member(i)`, joined where `same(i, j)`, by their first post; -1 elsewhere.
template <class Member, class Same>
void label_pieces(const FlowGrid& g, std::int64_t* labels, Member&& member, Same&& same) {
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    for (std::int64_t c = 0; c < g.n_cols; ++c) {
      const std::int64_t i = r * g.n_cols + c;
      labels[i] = member(i) ? i : -1;
      if (labels[i] < 0) continue;
      const auto join = [&](std::int64_t j) {
        if (labels[j] >= 0 && same(i, j)) unite(labels, i, j);
      };
      if (c > 0) join(i - 1);
      if (r > 0) join(i - g.n_cols);
      if (g.wraps && c == g.n_cols - 1 && c > 0) join(r * g.n_cols);
    }
  }
  // A label never exceeds its post, so one pass in order leaves the root everywhere.
  for (std::int64_t i = 0; i < g.size(); ++i) {
    if (labels[i] >= 0) labels[i] = labels[labels[i]];
  }
}

struct Piece {
  double area_m2 = 0;
  std::int64_t n_posts = 0;
};

/// Area and number of the counted posts of each piece, by root. Only ever looked up, never walked through.
template <class Counted>
std::unordered_map<std::int64_t, Piece> measure(const FlowGrid& g, const std::int64_t* labels, Counted&& counted) {
  std::unordered_map<std::int64_t, Piece> pieces;
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    for (std::int64_t c = 0; c < g.n_cols; ++c) {
      const std::int64_t i = r * g.n_cols + c;
      if (labels[i] < 0 || !counted(r, c)) continue;
      Piece& piece = pieces[labels[i]];
      piece.area_m2 += g.area_m2(r);
      ++piece.n_posts;
    }
  }
  return pieces;
}

/// One step of shore: from post `first` in direction `second` (0, 2, 4 or 6), the lake on the left.
using Side = std::pair<std::int64_t, int>;

}  // namespace

std::int64_t mark_sea(const FlowGrid& g, std::optional<double> sea_level_m, std::int64_t* labels) {
  const auto low = [&](std::int64_t i) {
    return (g.marks[i] & kInside) && static_cast<double>(g.heights_m[i]) <= sea_level_m.value_or(0);
  };
  std::unordered_map<std::int64_t, Piece> pieces;
  if (!sea_level_m) {
    label_pieces(g, labels, low, [](std::int64_t, std::int64_t) { return true; });
    pieces = measure(g, labels, [](std::int64_t, std::int64_t) { return true; });
  }
  std::int64_t n = 0;
  for (std::int64_t i = 0; i < g.size(); ++i) {
    if (!low(i) || (!sea_level_m && pieces.at(labels[i]).area_m2 < kSeaAreaM2)) continue;
    g.marks[i] |= kSea;
    ++n;
  }
  return n;
}

void label_flats(const FlowGrid& g, double sea_level_m, std::int64_t* labels) {
  const auto member = [&](std::int64_t i) {
    return (g.marks[i] & (kInside | kVoid)) == kInside &&
           (!(g.marks[i] & kSea) || static_cast<double>(g.heights_m[i]) == sea_level_m);
  };
  label_pieces(g, labels, member, [&](std::int64_t i, std::int64_t j) { return g.heights_m[i] == g.heights_m[j]; });
}

std::vector<Lake> mark_lakes(const FlowGrid& g, double min_area_m2, double sea_level_m, std::int64_t* labels) {
  label_flats(g, sea_level_m, labels);
  const auto is_core = [&](std::int64_t r, std::int64_t c) {
    const std::int64_t root = labels[r * g.n_cols + c];
    for (int d = 0; d < 8; ++d) {
      const std::int64_t n = g.neighbour(r, c, d);
      if (n < 0 || labels[n] != root) return false;
    }
    return true;
  };
  const auto cores = measure(g, labels, is_core);
  std::vector<Lake> lakes;
  for (std::int64_t i = 0; i < g.size(); ++i) {
    if (labels[i] != i) continue;
    const auto core = cores.find(i);
    if (core == cores.end() || core->second.n_posts < kLakePosts || core->second.area_m2 < min_area_m2) continue;
    lakes.push_back({i, static_cast<double>(g.heights_m[i]), core->second.area_m2, core->second.n_posts, 0, 0});
  }
  const auto lake_of = [&](std::int64_t i) {
    const auto lake = std::lower_bound(lakes.begin(), lakes.end(), labels[i],
                                       [](const Lake& a, std::int64_t root) { return a.root < root; });
    return lake != lakes.end() && lake->root == labels[i] ? &*lake : nullptr;
  };
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    for (std::int64_t c = 0; c < g.n_cols; ++c) {
      const std::int64_t i = r * g.n_cols + c;
      Lake* const lake = labels[i] < 0 ? nullptr : lake_of(i);
      if (!lake) continue;
      for (const int d : {0, 2, 4, 6}) {
        const std::int64_t n = g.neighbour(r, c, d);
        if (n < 0 || !(g.marks[n] & kInside) || labels[n] == labels[i]) continue;
        ++lake->rim;
        if (g.heights_m[n] < g.heights_m[i]) ++lake->lower_rim;
      }
    }
  }
  std::erase_if(lakes, [](const Lake& lake) {
    return static_cast<double>(lake.lower_rim) > kLakeLowerRim * static_cast<double>(lake.rim);
  });
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    for (std::int64_t c = 0; c < g.n_cols; ++c) {
      const std::int64_t i = r * g.n_cols + c;
      if (labels[i] < 0 || !lake_of(i) || !is_core(r, c)) continue;
      g.marks[i] |= kLake;
      for (int d = 0; d < 8; ++d) g.marks[g.neighbour(r, c, d)] |= kLake;
    }
  }
  return lakes;
}

std::int64_t mark_basins(const FlowGrid& g, const float* filled_m, double max_depth_m, double min_area_m2,
                         std::int64_t* labels) {
  const auto any = [](std::int64_t, std::int64_t) { return true; };
  label_pieces(
      g, labels,
      [&](std::int64_t i) {
        return (g.marks[i] & kInside) &&
               static_cast<double>(filled_m[i]) - static_cast<double>(g.heights_m[i]) > max_depth_m;
      },
      any);
  const auto pieces = measure(g, labels, any);
  std::int64_t n = 0;
  for (std::int64_t i = 0; i < g.size(); ++i) {
    if (labels[i] < 0) continue;
    const Piece& piece = pieces.at(labels[i]);
    if (piece.n_posts < kLakePosts || piece.area_m2 < min_area_m2) continue;
    g.marks[i] |= kBasin;
    ++n;
  }
  return n;
}

std::vector<ShoreLine> shore_lines(const FlowGrid& g, const std::int64_t* labels,
                                   const std::function<bool(std::int64_t)>& is_node) {
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
      if (!(g.marks[post] & kLake) || labels[post] != labels[i]) return false;
    }
    return true;
  };
  std::vector<Side> sides;
  for (std::int64_t r = 0; r < g.n_rows; ++r) {
    for (std::int64_t c = 0; c < g.n_cols; ++c) {
      if (!(g.marks[r * g.n_cols + c] & kLake)) continue;
      const bool ne = full(r, c), nw = full(r, c - 1), sw = full(r - 1, c - 1), se = full(r - 1, c);
      const std::int64_t i = r * g.n_cols + c;
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
    line.root = labels[sides[first].first];
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
