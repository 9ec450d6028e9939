// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/support/test_tile.hpp"

#include <algorithm>
#include <cmath>

#include "core/tessellation.hpp"

namespace tind::test {
namespace {

LocalVertex on_border(int b, std::int64_t t, std::int32_t z, std::int64_t side) {
  switch (b) {
    case 0:
      return {t, 0, z};
    case 1:
      return {side, t, z};
    case 2:
      return {t, side, z};
    default:
      return {0, t, z};
  }
}

// Border b of the ring at `level`, without the last corner.
std::vector<LocalVertex> ring_part(const TestTile& tile, int b, int level, std::int64_t side) {
  std::vector<LocalVertex> part;
  const auto& line = tile.lines[static_cast<std::size_t>(b)];
  for (const LineVertex& v : line) {
    if (v.entry <= level) part.push_back(on_border(b, v.t - line.front().t, v.z, side));
  }
  if (b >= 2) std::reverse(part.begin(), part.end());
  part.pop_back();
  return part;
}

}  // namespace

RefinementSpec spec_from(int level, double tolerance_m, int n_levels, const Lattice& lattice) {
  RefinementSpec spec;
  for (int l = 0; l < level + n_levels; ++l) {
    spec.tolerance_m.push_back(std::ldexp(tolerance_m, level - l) - lattice.height_unit_m() / 2);
    spec.seed_segments.push_back(1);
    spec.height_step_m.push_back(lattice.height_unit_m());
  }
  return spec;
}

TestTile make_task(const HeightField& field, const RefinementSpec& spec, const TileKey& key) {
  const std::int64_t side = field.lattice.tile_side(key.level), west = side * key.x, south = side * key.y;
  TestTile tile;
  tile.key = key;
  tile.task.key = key;
  tile.task.tolerance_m = spec.tolerance_m[key.level];
  tile.task.height_step_m = spec.height_step_m[key.level];
  for (int b = 0; b < 4; ++b) {
    const auto at = static_cast<std::size_t>(b);
    RootEdge root{b % 2 == 1, key.level, 0, 0};
    root.at = b == 0 ? south : b == 1 ? (west + side) % field.lattice.width() : b == 2 ? south + side : west;
    root.start = b % 2 == 0 ? west : south;
    tile.lines[at] = refine_root_edge(field, spec, root, {}, {}, [](int, std::int64_t) { return true; });
    tile.task.borders[at] = ring_part(tile, b, key.level, side);
    tile.task.envelopes[at] = envelope_of(tile.lines[at], key.level, field.lattice);
    for (EnvelopeKnot& knot : tile.task.envelopes[at]) knot.t -= static_cast<double>(root.start);
  }
  return tile;
}

TestTile build_tile(const HeightField& field, const RefinementSpec& spec, const TileKey& key) {
  TestTile tile = make_task(field, spec, key);
  tile.surface = triangulate(field, tile.task);
  return tile;
}

Mesh mesh_of(const TestTile& tile) {
  Mesh mesh;
  for (const auto& border : tile.task.borders) mesh.vertices.insert(mesh.vertices.end(), border.begin(), border.end());
  mesh.vertices.insert(mesh.vertices.end(), tile.surface.interior.begin(), tile.surface.interior.end());
  mesh.triangles = tile.surface.triangles;
  return mesh;
}

Mesh tessellate(const TestTile& tile, const std::array<int, 4>& levels) {
  Mesh mesh = mesh_of(tile);
  const std::int64_t side = mesh.vertices[tile.task.borders[0].size()].x;  // C1 is the SE corner
  // Per border: chains between the vertices of the tile's own level, as indices into mesh.vertices.
  std::array<std::vector<std::vector<std::uint32_t>>, 4> chains;
  std::array<std::uint32_t, 4> n_side{};
  std::uint32_t n_ring = 0;
  for (const auto& border : tile.task.borders) n_ring += static_cast<std::uint32_t>(border.size());
  std::uint32_t own = 0;
  for (int b = 0; b < 4; ++b) {
    const auto& border = tile.task.borders[static_cast<std::size_t>(b)];
    n_side[static_cast<std::size_t>(b)] = static_cast<std::uint32_t>(border.size() - 1);
    std::size_t coarse = 0;
    for (const LocalVertex& v : ring_part(tile, b, levels[static_cast<std::size_t>(b)], side)) {
      auto& list = chains[static_cast<std::size_t>(b)];
      if (coarse < border.size() && v == border[coarse]) {
        const std::uint32_t index = own++;
        if (coarse++ > 0) list.back().push_back(index);
        list.push_back({index});
      } else {
        list.back().push_back(static_cast<std::uint32_t>(mesh.vertices.size()));
        mesh.vertices.push_back(v);
      }
    }
    chains[static_cast<std::size_t>(b)].back().push_back(own % n_ring);
  }
  std::vector<bool> is_virtual(mesh.triangles.size(), false);
  std::vector<Triangle> added;
  for (const VirtualTriangle& vt : find_virtual_triangles(mesh.triangles, n_side)) {
    is_virtual[vt.triangle] = true;
    const std::vector<std::uint32_t>& chain = chains[vt.border][vt.interval];
    if (vt.n_edges == 1) {
      for (const std::uint32_t index : mesh.triangles[vt.triangle]) {
        if (index != chain.front() && index != chain.back()) fan(chain, index, added);
      }
      continue;
    }
    const std::vector<std::uint32_t>& chain_before = chains[(vt.border + 3u) % 4].back();
    const std::vector<std::uint32_t> after(chain.begin() + 1, chain.end());
    const std::vector<std::uint32_t> before(chain_before.rbegin() + 1, chain_before.rend());
    zig_zag(chain.front(), after, before, added);
  }
  std::vector<Triangle> kept;
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    if (!is_virtual[t]) kept.push_back(mesh.triangles[t]);
  }
  kept.insert(kept.end(), added.begin(), added.end());
  mesh.triangles = std::move(kept);
  return mesh;
}

PostCheck check_posts(const HeightField& field, const TileKey& key, const Mesh& mesh) {
  struct Point {
    long double x, y;
    double height_m;
    bool is_base, is_own_source;
    double worst = -1;
  };
  const auto side = static_cast<double>(field.lattice.tile_side(key.level));
  const double west = side * key.x, south = side * key.y, width = static_cast<double>(field.lattice.width());
  std::vector<Point> points;
  for (std::int64_t r = 0; r < field.n_rows; ++r) {
    for (std::int64_t c = 0; c < field.n_cols; ++c) {
      for (const double turn : {-width, 0.0, width}) {
        const double x = field.post_x(c) + turn - west, y = field.post_y(r) - south;
        if (x < 0 || y < 0 || x > side || y > side) continue;
        const bool own = x < side && y < side && field.origin_at(r, c) == PostOrigin::kSource;
        points.push_back({x, y, field.height_at(r, c), false, own});
      }
    }
  }
  for (int j = 0; j <= 256; ++j) {
    for (int i = 0; i <= 256; ++i) {
      const double x = i * side / 256, y = j * side / 256;
      if (!field.covers(x + west, y + south)) points.push_back({x, y, field.base_height_m, true, false});
    }
  }
  std::sort(points.begin(), points.end(),
            [](const Point& a, const Point& b) { return std::pair(a.y, a.x) < std::pair(b.y, b.x); });
  for (const Triangle& t : mesh.triangles) {
    const LocalVertex &a = mesh.vertices[t[0]], &b = mesh.vertices[t[1]], &c = mesh.vertices[t[2]];
    const auto [low, high] = std::minmax({a.y, b.y, c.y});
    const auto [left, right] = std::minmax({a.x, b.x, c.x});
    const auto weight = [](const LocalVertex& p, const LocalVertex& q, const Point& o) {
      const long double px = static_cast<long double>(p.x), py = static_cast<long double>(p.y);
      return (static_cast<long double>(q.x) - px) * (o.y - py) - (static_cast<long double>(q.y) - py) * (o.x - px);
    };
    // Row by row, in each from the triangle's west to its east.
    const auto from = [&](long double x, long double y, auto begin) {
      return std::lower_bound(begin, points.end(), std::pair(y, x),
                              [](const Point& o, const auto& at) { return std::pair(o.y, o.x) < at; });
    };
    const auto x_first = static_cast<long double>(left), x_last = static_cast<long double>(right);
    auto p = from(x_first, static_cast<long double>(low), points.begin());
    while (p != points.end() && p->y <= static_cast<long double>(high)) {
      if (p->x < x_first || p->x > x_last) {
        const auto next = from(x_first, p->y, p);
        p = next != p ? next : from(x_first, std::nextafter(p->y, 1e18L), p);
        continue;
      }
      const long double wa = weight(b, c, *p), wb = weight(c, a, *p), wc = weight(a, b, *p), all = wa + wb + wc;
      const auto at = p++;
      if (std::min({wa, wb, wc}) < -1e-12L * all) continue;
      const long double z = (wa * static_cast<long double>(a.z) + wb * static_cast<long double>(b.z) +
                             wc * static_cast<long double>(c.z)) /
                            all * static_cast<long double>(field.lattice.height_unit_m());
      at->worst = std::max(at->worst, static_cast<double>(std::abs(z - static_cast<long double>(at->height_m))));
    }
  }
  PostCheck check;
  double squares = 0;
  for (const Point& p : points) {
    if (p.worst < 0) ++check.n_missed;
    double& worst = p.is_base ? check.worst_base_m : check.worst_m;
    worst = std::max(worst, p.worst);
    if (!p.is_base) ++check.n_posts;
    if (!p.is_own_source) continue;
    ++check.n_own_source;
    check.own_worst_m = std::max(check.own_worst_m, p.worst);
    squares += p.worst * p.worst;
  }
  if (check.n_own_source > 0) check.own_rmse_m = std::sqrt(squares / static_cast<double>(check.n_own_source));
  return check;
}

Int128 doubled_area(const Mesh& mesh) {
  Int128 sum = 0;
  for (const Triangle& t : mesh.triangles) {
    const LocalVertex &a = mesh.vertices[t[0]], &b = mesh.vertices[t[1]], &c = mesh.vertices[t[2]];
    const Int128 area = Int128{b.x - a.x} * (c.y - a.y) - Int128{b.y - a.y} * (c.x - a.x);
    if (area <= 0) return -1;
    sum += area;
  }
  return sum;
}

}  // namespace tind::test
