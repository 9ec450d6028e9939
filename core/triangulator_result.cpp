// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/triangulator_result.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

namespace tind {
namespace {

struct CodedIndex {
  std::uint64_t code = 0;
  std::uint32_t index = 0;
};

// By code, stable: as many passes as the codes have digits.
void radix_sort(std::vector<CodedIndex>& items, std::vector<CodedIndex>& spare) {
  constexpr int kDigitBits = 11;
  constexpr std::size_t kDigits = std::size_t{1} << kDigitBits;
  std::uint64_t all = 0;
  for (const CodedIndex& item : items) all |= item.code;
  spare.resize(items.size());
  std::array<std::uint32_t, kDigits> first;
  for (int shift = 0; shift < 64 && all >> shift != 0; shift += kDigitBits) {
    first.fill(0);
    for (const CodedIndex& item : items) ++first[item.code >> shift & (kDigits - 1)];
    std::uint32_t n = 0;
    for (std::uint32_t& f : first) n += std::exchange(f, n);
    for (const CodedIndex& item : items) spare[first[item.code >> shift & (kDigits - 1)]++] = item;
    items.swap(spare);
  }
}

}  // namespace

void morton_order(const std::vector<LocalVertex>& points, std::vector<std::uint32_t>& order) {
  order.resize(points.size());
  std::int64_t all = 0;
  for (const LocalVertex& p : points) all |= p.x | p.y;
  if (all >> 32 != 0) {  // coarse tiles: few points, codes too long for one word
    for (std::size_t k = 0; k < points.size(); ++k) order[k] = static_cast<std::uint32_t>(k);
    std::stable_sort(order.begin(), order.end(), [&](std::uint32_t i, std::uint32_t j) {
      const LocalVertex &a = points[i], &b = points[j];
      return morton_less(static_cast<std::uint64_t>(a.x), static_cast<std::uint64_t>(a.y),
                         static_cast<std::uint64_t>(b.x), static_cast<std::uint64_t>(b.y));
    });
    return;
  }
  thread_local std::vector<CodedIndex> items, spare;
  items.resize(points.size());
  for (std::size_t k = 0; k < points.size(); ++k) {
    items[k] = {morton_code(static_cast<std::uint32_t>(points[k].x), static_cast<std::uint32_t>(points[k].y)),
                static_cast<std::uint32_t>(k)};
  }
  radix_sort(items, spare);
  for (std::size_t k = 0; k < points.size(); ++k) order[k] = items[k].index;
}

void TileExtractor::extract(const Mesh& mesh, std::int32_t n_ring, TileSurface& surface) {
  TileStats& stats = surface.stats;
  stats.min_z = std::numeric_limits<std::int32_t>::max();
  stats.max_z = std::numeric_limits<std::int32_t>::min();
  interior_.clear();
  for (std::int32_t v = 0; v < mesh.n_vertices(); ++v) {
    const Mesh::Vertex& p = mesh.vertex(v);
    stats.min_z = std::min(stats.min_z, p.z);
    stats.max_z = std::max(stats.max_z, p.z);
    if (v >= n_ring) interior_.push_back({static_cast<std::int64_t>(p.x), static_cast<std::int64_t>(p.y), p.z});
  }
  morton_order(interior_, order_);
  index_.resize(static_cast<std::size_t>(mesh.n_vertices()));
  for (std::int32_t v = 0; v < n_ring; ++v) index_[static_cast<std::size_t>(v)] = static_cast<std::uint32_t>(v);
  surface.interior.resize(interior_.size());
  const auto ring = static_cast<std::uint32_t>(n_ring);
  for (std::size_t k = 0; k < order_.size(); ++k) {
    surface.interior[k] = interior_[order_[k]];
    index_[ring + order_[k]] = ring + static_cast<std::uint32_t>(k);
  }

  // Each triangle turned so that its smallest index comes first; by that one first, then by the second: there is one
  // triangle for each directed edge.
  const auto n_faces = static_cast<std::size_t>(mesh.n_faces());
  turned_.resize(n_faces);
  first_.assign(static_cast<std::size_t>(mesh.n_vertices()) + 1, 0);
  for (std::size_t f = 0; f < n_faces; ++f) {
    const Mesh::Face& face = mesh.face(static_cast<std::int32_t>(f));
    const std::uint32_t a = index_[static_cast<std::size_t>(face.v[0])],
                        b = index_[static_cast<std::size_t>(face.v[1])],
                        c = index_[static_cast<std::size_t>(face.v[2])];
    Triangle& t = turned_[f];
    if (a < b && a < c) {
      t = {a, b, c};
    } else if (b < c) {
      t = {b, c, a};
    } else {
      t = {c, a, b};
    }
    ++first_[t[0] + 1];
  }
  for (std::size_t k = 1; k < first_.size(); ++k) first_[k] += first_[k - 1];
  surface.triangles.resize(n_faces);
  faces_.resize(n_faces);
  for (std::size_t f = 0; f < n_faces; ++f) {
    const Triangle& t = turned_[f];
    // Those of one vertex are a handful: each goes to its place among those that are there.
    std::uint32_t at = first_[t[0]]++;
    for (; at > 0 && surface.triangles[at - 1][0] == t[0] && surface.triangles[at - 1][1] > t[1]; --at) {
      surface.triangles[at] = surface.triangles[at - 1];
      faces_[at] = faces_[at - 1];
    }
    surface.triangles[at] = t;
    faces_[at] = static_cast<std::int32_t>(f);
  }
}

void TileExtractor::measure(const Mesh& mesh, const TilePosts& posts, const FaceScanner& scanner, double side,
                            bool at_pole, TileStats& stats) {
  Errors errors;
  for (const PostWindow& w : posts.windows()) {
    if (!w.is_base_grid) measure_window(mesh, posts, w, scanner, side, at_pole, errors);
  }
  if (posts.n_points() != 0) measure_points(mesh, posts, scanner, side, at_pole, errors);
  stats.n_posts = errors.n;
  stats.max_error_m = std::nextafter(static_cast<float>(errors.largest), std::numeric_limits<float>::max());
  if (errors.largest == 0) stats.max_error_m = 0;
  stats.rmse_m = errors.n ? static_cast<float>(std::sqrt(errors.sum / static_cast<double>(errors.n))) : 0;
}

void TileExtractor::measure_window(const Mesh& mesh, const TilePosts& posts, const PostWindow& w,
                                   const FaceScanner& scanner, double side, bool at_pole, Errors& errors) {
  // The posts that are to be measured.
  const double nudge = posts.nudge(), end = side - nudge;
  std::int64_t n_cols = w.n_cols, n_rows = w.n_rows;
  while (n_cols > 0 && w.x(n_cols - 1) >= end) --n_cols;
  while (!at_pole && n_rows > 0 && w.y(n_rows - 1) >= end) --n_rows;
  const std::uint64_t expected = posts.count_source(w, n_rows, n_cols);
  const bool all_source = expected == static_cast<std::uint64_t>(n_cols * n_rows);

  // The tile's sides are moved to where its half-open box of posts begins and ends.
  const double beyond = side + 4 * nudge;
  const auto moved = [&](double at, double last) { return at == 0 ? -4 * nudge : at == side ? last : at; };
  Errors found;
  for (const std::int32_t f : faces_) {
    PlanTriangle plan = mesh.plan_of(f);
    for (int i = 0; i < 3; ++i) {
      plan.x[i] = moved(plan.x[i], end);
      plan.y[i] = moved(plan.y[i], at_pole ? beyond : end);
    }
    const TriangleInPosts in(plan, w);
    const TriangleRows rows(in.u, in.v);
    const std::int64_t r_first = std::max<std::int64_t>(0, ceil_of(rows.south()));
    const std::int64_t r_end = std::min(n_rows, ceil_of(rows.north()));
    if (r_first >= r_end) continue;
    const FacePlane plane = scanner.plane_of(f);
    const double per_col = plane.slope_x * w.dx;
    const auto add_row = [&](std::int64_t r, std::int64_t c_from, std::int64_t c_to) {
      const auto [west, east] = rows.cuts(static_cast<double>(r));
      const std::int64_t c_first = std::max(c_from, ceil_of(west)), c_end = std::min(c_to, ceil_of(east));
      if (c_first >= c_end) return;
      const double z = plane.at(w.x0, w.y(r));
      const auto add_part = [&](const float* heights, const PostOrigin* origins, std::int64_t begin,
                                std::int64_t part_end) {
        double col = static_cast<double>(begin);
        const std::int64_t n = part_end - begin;
        if (all_source) {
          for (std::int64_t k = 0; k < n; ++k, ++col) {
            found.add(std::abs(z + per_col * col - static_cast<double>(heights[k])));
          }
          return;
        }
        for (std::int64_t k = 0; k < n; ++k, ++col) {
          if (origins[k] != PostOrigin::kSource) continue;
          found.add(std::abs(z + per_col * col - static_cast<double>(heights[k])));
        }
      };
      posts.for_parts(w, r, c_first, c_end, add_part);
    };
    if (!posts.has_blocks() || !in.is_large()) {
      for (std::int64_t r = r_first; r < r_end; ++r) add_row(r, 0, n_cols);
      continue;
    }
    // Blocks that lie in the triangle and cannot hold the largest error are summed in closed form.
    const PostBlocks& blocks = posts.blocks();
    const TriangleBlocks walk(blocks, w.field_row, w.field_col, in.u, in.v, 1e-6);
    const auto is_inside = [&](std::int64_t r, std::int64_t c0, std::int64_t c1) {
      const auto [west, east] = rows.cuts(static_cast<double>(r));
      return r >= r_first && r < r_end && ceil_of(west) <= c0 && c1 < ceil_of(east);
    };
    const auto descend = [&](const BlockInWindow& b, const auto& self) -> void {
      const PostBlocks::Extent& e = b.posts;
      const PostBlock& block = blocks.block(b.level, b.i, b.j);
      if (block.is_all(PostOrigin::kSource) && b.is_within(n_rows, n_cols) &&
          is_inside(e.row, e.col, e.col + e.n_cols - 1) &&
          is_inside(e.row + e.n_rows - 1, e.col, e.col + e.n_cols - 1) &&
          scanner.plane_bound(plane, w, block, e) <= found.largest) {
        const PostPlane own{plane.at(w.x(e.col), w.y(e.row)), per_col, plane.slope_y * w.dy};
        found.sum += blocks.squared_distance_m2(b.level, b.i, b.j, own);
        found.n += static_cast<std::uint64_t>(e.n_posts());
      } else if (b.level > 0) {
        walk.for_children(b, [&](const BlockInWindow& child) { self(child, self); });
      } else {
        const std::int64_t row_end = std::min(r_end, e.row + e.n_rows);
        for (std::int64_t r = std::max(r_first, e.row); r < row_end; ++r) {
          add_row(r, std::max<std::int64_t>(0, e.col), std::min(n_cols, e.col + e.n_cols));
        }
      }
    };
    walk.for_coarsest([&](const BlockInWindow& b) { descend(b, descend); });
  }
  // Where two edges of a sliver cut a row within a rounding of a post, both or none of its neighbours may have it.
  if (found.n != expected) found = measure_one_by_one(mesh, posts, w, scanner, n_rows, n_cols);
  errors.largest = std::max(errors.largest, found.largest);
  errors.sum += found.sum;
  errors.n += found.n;
}

// The slow and sure way: closed triangles, and a mark for each post.
TileExtractor::Errors TileExtractor::measure_one_by_one(const Mesh& mesh, const TilePosts& posts, const PostWindow& w,
                                                        const FaceScanner& scanner, std::int64_t n_rows,
                                                        std::int64_t n_cols) {
  Errors found;
  seen_.assign(static_cast<std::size_t>(w.n_rows * w.n_cols), false);
  for (const std::int32_t f : faces_) {
    const FacePlane plane = scanner.plane_of(f);
    TilePosts::for_rows(mesh.plan_of(f), w, [&](std::int64_t r, std::int64_t c_first, std::int64_t c_last) {
      if (r >= n_rows) return;
      const std::int64_t c_end = std::min(c_last + 1, n_cols);
      posts.for_parts(w, r, c_first, c_end,
                      [&](const float* heights, const PostOrigin* origins, std::int64_t begin, std::int64_t end) {
                        for (std::int64_t c = begin; c < end; ++c) {
                          const auto at = static_cast<std::size_t>(r * w.n_cols + c);
                          if (seen_[at] || origins[c - begin] != PostOrigin::kSource) continue;
                          seen_[at] = true;
                          const double height = static_cast<double>(heights[c - begin]);
                          found.add(std::abs(plane.at(w.x(c), w.y(r)) - height));
                        }
                      });
    });
  }
  return found;
}

void TileExtractor::measure_points(const Mesh& mesh, const TilePosts& posts, const FaceScanner& scanner, double side,
                                   bool at_pole, Errors& errors) {
  const double nudge = posts.nudge(), end = side - nudge;
  const double end_y = at_pole ? std::numeric_limits<double>::infinity() : end;
  seen_.assign(posts.n_points(), false);
  for (const std::int32_t f : faces_) {
    const FacePlane plane = scanner.plane_of(f);
    posts.for_points(mesh.plan_of(f), [&](std::uint32_t k, const TilePoint& p) {
      if (seen_[k] || p.x < -nudge || p.y < -nudge || p.x >= end || p.y >= end_y) return;
      seen_[k] = true;
      errors.add(std::abs(plane.at(p.x, p.y) - p.height_m));
    });
  }
}

}  // namespace tind
