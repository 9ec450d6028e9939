// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/tessellation.hpp"

#include <algorithm>
#include <cassert>
#include <numeric>

namespace tind {

std::vector<std::uint32_t> encode_runs(std::span<const std::uint8_t> entries, int level, int n_gaps) {
  std::vector<std::uint32_t> runs(static_cast<std::size_t>(n_gaps), 0);
  for (const std::uint8_t entry : entries) {
    const int gap = entry - level;
    if (gap >= 1 && gap <= n_gaps) ++runs[static_cast<std::size_t>(gap - 1)];
  }
  std::partial_sum(runs.begin(), runs.end(), runs.begin());
  return runs;
}

CoarseRuns coarse_runs(std::span<const std::uint8_t> entries, int coarse_level) {
  assert(entries.size() >= 2);
  CoarseRuns out;
  out.starts_inside = entries.front() > coarse_level;
  out.ends_inside = entries.back() > coarse_level;
  std::uint32_t run = 0;
  for (const std::uint8_t entry : entries.subspan(1, entries.size() - 2)) {
    if (entry > coarse_level) {
      ++run;
    } else {
      out.runs.push_back(run);
      run = 0;
    }
  }
  out.runs.push_back(run);
  return out;
}

std::vector<VirtualTriangle> find_virtual_triangles(const std::vector<Triangle>& triangles,
                                                    const std::array<std::uint32_t, 4>& n_side) {
  const std::uint32_t n_ring = 4 + n_side[0] + n_side[1] + n_side[2] + n_side[3];
  constexpr std::uint32_t kNone = 0xffffffff;
  std::vector<std::uint32_t> owner(n_ring, kNone);  // of ring edge m, m+1
  for (std::uint32_t t = 0; t < triangles.size(); ++t) {
    for (int e = 0; e < 3; ++e) {
      const std::uint32_t a = triangles[t][static_cast<std::size_t>(e)];
      const std::uint32_t b = triangles[t][static_cast<std::size_t>((e + 1) % 3)];
      if (a < n_ring && b == (a + 1) % n_ring) owner[a] = t;
    }
  }
  std::vector<VirtualTriangle> vts;
  const auto is_corner_pair = [&](std::uint32_t m) {  // ring edges m and m+1 around a corner belong to one triangle
    const std::uint32_t next = (m + 1) % n_ring;
    return owner[m] != kNone && owner[m] == owner[next];
  };
  const bool starts_with_corner = is_corner_pair(n_ring - 1);
  if (starts_with_corner) vts.push_back({owner[0], 2, 0, 0, {}});
  std::uint32_t m = 0;
  for (std::uint8_t border = 0; border < 4; ++border) {
    const std::uint32_t n_intervals = n_side[border] + 1;
    for (std::uint32_t k = 0; k < n_intervals; ++k, ++m) {
      if (owner[m] == kNone) continue;
      if (k == 0 && is_corner_pair((m + n_ring - 1) % n_ring)) continue;  // listed with the edge before
      const bool pair = k + 1 == n_intervals && is_corner_pair(m);
      if (pair && border == 3) continue;  // listed first
      if (pair) {
        vts.push_back({owner[m], 2, static_cast<std::uint8_t>(border + 1), 0, {}});
      } else {
        vts.push_back({owner[m], 1, border, k, {}});
      }
    }
  }
  return vts;
}

void fan(std::span<const std::uint32_t> border_chain, std::uint32_t apex, std::vector<Triangle>& out) {
  for (std::size_t i = 0; i + 1 < border_chain.size(); ++i) out.push_back({border_chain[i], border_chain[i + 1], apex});
}

void zig_zag(std::uint32_t corner, std::span<const std::uint32_t> after, std::span<const std::uint32_t> before,
             std::vector<Triangle>& out) {
  assert(!after.empty() && !before.empty());
  const auto& r = after;
  const auto& q = before;
  out.push_back({corner, r[0], q[0]});
  std::size_t i = 0, j = 0;
  while (i + 1 < r.size() || j + 1 < q.size()) {
    const bool r_has_more = i + 1 < r.size(), q_at_end = j + 1 >= q.size();
    if (q_at_end || (r_has_more && (i + 1) * q.size() <= (j + 1) * r.size())) {
      out.push_back({r[i], r[i + 1], q[j]});
      ++i;
    } else {
      out.push_back({r[i], q[j + 1], q[j]});
      ++j;
    }
  }
}

}  // namespace tind
