// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/triangulator_result.hpp"

#include <algorithm>
#include <array>
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
  vertices_.resize(static_cast<std::size_t>(mesh.n_vertices()));
  surface.interior.resize(interior_.size());
  const auto ring = static_cast<std::uint32_t>(n_ring);
  for (std::size_t k = 0; k < order_.size(); ++k) {
    surface.interior[k] = interior_[order_[k]];
    index_[ring + order_[k]] = ring + static_cast<std::uint32_t>(k);
  }
  for (std::size_t v = 0; v < index_.size(); ++v) vertices_[index_[v]] = mesh.vertex(static_cast<std::int32_t>(v));

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
  for (std::size_t f = 0; f < n_faces; ++f) {
    const Triangle& t = turned_[f];
    // Those of one vertex are a handful: each goes to its place among those that are there.
    std::uint32_t at = first_[t[0]]++;
    for (; at > 0 && surface.triangles[at - 1][0] == t[0] && surface.triangles[at - 1][1] > t[1]; --at) {
      surface.triangles[at] = surface.triangles[at - 1];
    }
    surface.triangles[at] = t;
  }
}

}  // namespace tind
