// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/tessellate.hpp"

#include <fmt/format.h>

#include <algorithm>

namespace tind::client {
namespace {

using Chain = std::vector<std::uint32_t>;

/// Local indices along one border's intervals, with those of inserted vertices.
class Intervals {
 public:
  Intervals(const Tile& tile, const std::array<std::optional<SideInserts>, 4>& sides, std::vector<Vertex>& vertices)
      : tile_(tile) {
    const auto& corner = tile.vertices;
    for (int b = 0; b < 4; ++b) {
      const auto& side = sides[static_cast<std::size_t>(b)];
      if (!side || !side->any) continue;
      auto& starts = starts_[static_cast<std::size_t>(b)];
      for (const auto& inserted : side->inserted) {
        starts.push_back({static_cast<std::uint32_t>(vertices.size()), static_cast<std::uint32_t>(inserted.size())});
        for (const SideVertex& v : inserted) {
          const Vertex& at = corner[tile.corner_index(b)];
          vertices.push_back(b == 0 || b == 2 ? Vertex{v.t, at.y, v.z} : Vertex{at.x, v.t, v.z});
        }
      }
    }
  }
  bool is_changed(int b, std::uint32_t interval) const {
    const auto& starts = starts_[static_cast<std::size_t>(b)];
    return interval < starts.size() && starts[interval].n > 0;
  }
  /// The vertices of an interval in ring direction, both ends included.
  Chain chain(int b, std::uint32_t interval) const {
    Chain chain = {tile_.ring_index(b, interval)};
    const auto& starts = starts_[static_cast<std::size_t>(b)];
    if (interval < starts.size()) {
      for (std::uint32_t k = 0; k < starts[interval].n; ++k) chain.push_back(starts[interval].first + k);
    }
    chain.push_back(tile_.ring_index(b, interval + 1));
    return chain;
  }

 private:
  struct Inserted {
    std::uint32_t first = 0, n = 0;
  };
  const Tile& tile_;
  std::array<std::vector<Inserted>, 4> starts_;
};

/// Turns a triangle so that it starts with `first`; false when it does not hold it.
bool turn_to(Corners& corners, std::uint32_t first) {
  for (int k = 0; k < 3; ++k) {
    if (corners[0] == first) return true;
    std::rotate(corners.begin(), corners.begin() + 1, corners.end());
  }
  return false;
}

void emit_fan(const Chain& chain, std::uint32_t apex, std::vector<Corners>& out) {
  for (std::size_t k = 0; k + 1 < chain.size(); ++k) out.push_back({chain[k], chain[k + 1], apex});
}

/// docs/format.md 6: `q` backwards along the ring from the corner, `r` forwards, both without the corner.
void emit_zig_zag(std::uint32_t corner, const Chain& q, const Chain& r, std::vector<Corners>& out) {
  out.push_back({corner, r[0], q[0]});
  std::size_t i = 0, j = 0;
  while (i + 1 < r.size() || j + 1 < q.size()) {
    const bool q_at_end = j + 1 == q.size(), r_has_more = i + 1 < r.size();
    if (q_at_end || (r_has_more && (i + 1) * q.size() <= (j + 1) * r.size())) {
      out.push_back({r[i], r[i + 1], q[j]});
      ++i;
    } else {
      out.push_back({r[i], q[j + 1], q[j]});
      ++j;
    }
  }
}

}  // namespace

Outcome<SideInserts> decode_by_entry_levels(const Tile& tile, int b, std::vector<SideVertex> finer) {
  if (b >= 2) std::reverse(finer.begin(), finer.end());
  const auto coarse = ring_side(tile, b);
  const auto same = [](const SideVertex& u, const SideVertex& v) { return u.t == v.t && u.z == v.z; };
  const auto where = [&](const SideVertex& v) {
    return fmt::format("{} border of {}: finer vertex at step {} (height {}, entry level {})",
                       kBorderNames[static_cast<std::size_t>(b)], tile.id.text(), v.t, v.z, v.entry);
  };
  if (finer.empty() || !same(finer.front(), coarse.front())) {
    return refuse(fmt::format("{} border of {}: the finer line does not start at the corner",
                              kBorderNames[static_cast<std::size_t>(b)], tile.id.text()));
  }
  SideInserts side;
  side.inserted.resize(coarse.size() - 1);
  std::size_t interval = 0;
  for (std::size_t k = 1; k < finer.size(); ++k) {
    const SideVertex& v = finer[k];
    if (interval + 1 == coarse.size()) return refuse(where(v) + " comes after the last corner");
    if (v.entry > tile.id.level) {
      side.inserted[interval].push_back(v);
      side.any = true;
    } else if (same(v, coarse[interval + 1])) {
      ++interval;
    } else {
      return refuse(where(v) + fmt::format(" should be the coarse vertex at step {} (height {})",
                                           coarse[interval + 1].t, coarse[interval + 1].z));
    }
  }
  if (interval + 1 != coarse.size()) {
    return refuse(fmt::format("{} border of {}: the finer line lacks the coarse vertex at step {}",
                              kBorderNames[static_cast<std::size_t>(b)], tile.id.text(), coarse[interval + 1].t));
  }
  return side;
}

Outcome<TessellatedTile> tessellate(const Tile& tile, const std::array<std::optional<SideInserts>, 4>& sides) {
  TessellatedTile out;
  out.vertices = tile.vertices;
  const Intervals intervals(tile, sides, out.vertices);
  std::vector<bool> is_changed(tile.triangles.size(), false);
  std::vector<Corners> pieces;
  const auto misfit = [&](const VtRecord& vt) {
    return refuse(
        fmt::format("tile {}: the virtual triangle list does not fit triangle {}", tile.id.text(), vt.triangle));
  };
  for (const VtRecord& vt : tile.vts) {
    const int b = vt.border, before = (b + 3) % 4;
    Corners corners = tile.triangles[vt.triangle];
    if (vt.n_edges == 1) {
      if (!intervals.is_changed(b, vt.interval)) continue;
      const Chain chain = intervals.chain(b, vt.interval);
      if (!turn_to(corners, chain.front()) || corners[1] != chain.back()) return misfit(vt);
      emit_fan(chain, corners[2], pieces);
    } else {
      const std::uint32_t last = tile.n_side[static_cast<std::size_t>(before)];
      if (!intervals.is_changed(before, last) && !intervals.is_changed(b, 0)) continue;
      Chain q = intervals.chain(before, last), r = intervals.chain(b, 0);
      std::reverse(q.begin(), q.end());
      if (!turn_to(corners, r.front()) || corners[1] != r.back() || corners[2] != q.back()) return misfit(vt);
      q.erase(q.begin());
      r.erase(r.begin());
      emit_zig_zag(corners[0], q, r, pieces);
    }
    is_changed[vt.triangle] = true;
    ++out.changed_vts;
  }
  out.triangles.reserve(tile.triangles.size() + pieces.size());
  for (std::size_t k = 0; k < tile.triangles.size(); ++k) {
    if (!is_changed[k]) out.triangles.push_back(tile.triangles[k]);
  }
  out.first_changed = out.triangles.size();
  out.triangles.insert(out.triangles.end(), pieces.begin(), pieces.end());
  return out;
}

}  // namespace tind::client
