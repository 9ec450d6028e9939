// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/sample_region.hpp"

#include <time.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <span>
#include <utility>

#include "core/border_line.hpp"
#include "core/tessellation.hpp"
#include "core/triangulator.hpp"
#include "storage/builder/border_lines.hpp"
#include "storage/builder/tile_posts.hpp"
#include "storage/piece_blob.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

// A stored pair takes its key, LMDB's header of a node and its slot.
constexpr double kPairBytes = 26;
// Pages are filled in key order and so nearly full; large values end in a page of their own.
constexpr double kPageBytes = 4096, kLargeValueBytes = 2030;

// Of a tile without data: a small body, and its part of corners and edges.
constexpr double kFillerTileBytes = 160;

double stored_bytes(std::size_t value) {
  const double bytes = static_cast<double>(value);
  return kPairBytes + (bytes > kLargeValueBytes ? std::ceil((bytes + 16) / kPageBytes) * kPageBytes : bytes);
}

class RegionBuilder {
 public:
  RegionBuilder(const HeightField& field, const LevelTable& table, const LinePyramid& lines, const TileKey& top)
      : field_(field), lines_(lines), top_(top) {
    const double unit = field.lattice.height_unit_m();
    for (int level = 0; level <= table.bottom_level(); ++level) {
      const double tolerance = table.levels[static_cast<std::size_t>(level)].tolerance_m;
      spec_.tolerance_m.push_back(tolerance - std::min(unit / 2, tolerance / 2));
      spec_.seed_segments.push_back(seed_segments(level, tolerance, field.lattice.ellipsoid.semi_major_m));
      spec_.height_step_m.push_back(unit);
    }
  }

  void build(int turn, RegionSample& sample) {
    sample.levels.resize(static_cast<std::size_t>(spec_.bottom_level() - top_.level) + 1);
    struct Built {
      TileKey key;
      double stands_for;  // tiles of the level
      std::vector<LocalVertex> interior;
    };
    std::vector<Built> parents;
    const std::vector<LocalVertex> inherited = parent_of_top();
    stretches_.clear();
    for (std::size_t k = 0; k < sample.levels.size(); ++k) {
      LevelCost& total = sample.levels[k];
      std::vector<Built> tiles;
      const auto build = [&](const TileKey& key, double stands_for, const std::vector<LocalVertex>& from,
                             double before) {
        LevelCost cost;
        tiles.push_back({key, stands_for, {}});
        build_tile(key, from, tiles.back().interior, cost);
        total.tiles += stands_for;
        total.vertices += stands_for * cost.vertices;
        total.bytes += stands_for * cost.bytes;
        total.seconds += stands_for * (thread_seconds() - before);
      };
      if (k == 0) {
        const double before = thread_seconds();
        add_ring(top_);
        build(top_, 1, inherited, before);
      }
      for (const Built& parent : parents) {
        if (!is_split(parent.key)) continue;
        const double before_lines = thread_seconds();
        add_middle_lines(parent.key, parent.interior);
        total.seconds += parent.stands_for * (thread_seconds() - before_lines);
        // Children without data are cheap and known; of the others two at opposite corners, if there are more.
        std::vector<int> with_data;
        for (int child = 0; child < 4; ++child) {
          if (coverage_of(field_, parent.key.child(child)) != TileCoverage::kFiller) with_data.push_back(child);
        }
        total.tiles += parent.stands_for * static_cast<double>(4 - with_data.size());
        total.bytes += parent.stands_for * static_cast<double>(4 - with_data.size()) * kFillerTileBytes;
        const double share = with_data.size() > 2 ? static_cast<double>(with_data.size()) / 2 : 1;
        if (with_data.size() == 4) {
          const int diagonal = ++turn % 2;
          with_data = {diagonal, 3 - diagonal};
        } else if (with_data.size() == 3) {
          with_data.erase(with_data.begin() + ++turn % 3);
        }
        for (const int child : with_data) {
          build(parent.key.child(child), parent.stands_for * share, parent.interior, thread_seconds());
        }
      }
      parents = std::move(tiles);
    }
  }

 private:
  // Whether the data or its falloff touch the tile.
  bool is_split(const TileKey& key) const {
    bool touched = false;
    for_posts_around(field_, key, [&](std::int64_t r, std::int64_t c) {
      touched = touched || field_.origin_at(r, c) != PostOrigin::kBase;
    });
    return touched;
  }

  // Refined as if everything were split down to the bottom level.
  void add_edge(const RootEdge& root, std::vector<std::int64_t> pins) {
    std::sort(pins.begin(), pins.end());
    const auto crossings =
        lines_.crossings(root.vertical, root.at, root.start, root.start + field_.lattice.tile_side(root.level));
    stretches_.push_back({root, refine_root_edge(field_, spec_, root, pins, crossings, [this](int level, std::int64_t) {
                            return level < spec_.bottom_level();
                          })});
  }

  // Border b (ring order) of a tile, in stored direction, all levels.
  std::span<const LineVertex> border(const TileKey& key, int b) const {
    const std::int64_t side = field_.lattice.tile_side(key.level), west = side * key.x, south = side * key.y;
    const bool vertical = b % 2 == 1;
    const std::int64_t at = b == 0   ? south
                            : b == 1 ? (west + side) % field_.lattice.width()
                            : b == 2 ? south + side
                                     : west;
    const std::int64_t start = vertical ? south : west;
    // Few stretches, and the latest are the finest.
    const auto found = std::find_if(stretches_.rbegin(), stretches_.rend(), [&](const Stretch& s) {
      return s.root.vertical == vertical && s.root.at == at && s.root.start <= start &&
             start + side <= s.root.start + field_.lattice.tile_side(s.root.level);
    });
    assert(found != stretches_.rend() && "lines are refined before their tiles");
    return line_between(found->vertices, start, start + side);
  }

  void add_ring(const TileKey& key) {
    const std::int64_t side = field_.lattice.tile_side(key.level), west = side * key.x, south = side * key.y;
    add_edge({true, key.level, west, south}, {});
    add_edge({true, key.level, (west + side) % field_.lattice.width(), south}, {});
    add_edge({false, key.level, south, west}, {});
    add_edge({false, key.level, south + side, west}, {});
  }

  void add_middle_lines(const TileKey& parent, const std::vector<LocalVertex>& interior) {
    const std::int64_t side = field_.lattice.tile_side(parent.level) / 2;
    const std::int64_t west = 2 * side * parent.x, south = 2 * side * parent.y;
    for (const std::int64_t half : {std::int64_t{0}, side}) {
      std::vector<std::int64_t> on_meridian, on_parallel;
      for (const LocalVertex& v : interior) {
        if (v.x == side && v.y > half && v.y < half + side) on_meridian.push_back(south + v.y);
        if (v.y == side && v.x > half && v.x < half + side) on_parallel.push_back(west + v.x);
      }
      add_edge({true, parent.level + 1, west + side, south + half}, std::move(on_meridian));
      add_edge({false, parent.level + 1, south + side, west + half}, std::move(on_parallel));
    }
  }

  TileTask make_task(const TileKey& key, int level) const {
    TileTask task;
    task.key = key;
    task.tolerance_m = spec_.tolerance_m[static_cast<std::size_t>(level)];
    task.height_step_m = spec_.height_step_m[static_cast<std::size_t>(level)];
    for (int b = 0; b < 4; ++b) set_border(field_.lattice, border(key, b), b, task);
    return task;
  }

  // The vertices that the region's top inherits: those that its place has at twice the tolerance.
  std::vector<LocalVertex> parent_of_top() {
    if (top_.level == 0) return {};
    add_ring(top_);
    return triangulate(field_, make_task(top_, top_.level - 1)).interior;
  }

  void build_tile(const TileKey& key, const std::vector<LocalVertex>& inherited, std::vector<LocalVertex>& interior,
                  LevelCost& out) const {
    const std::int64_t side = field_.lattice.tile_side(key.level), west = side * key.x, south = side * key.y;
    TileTask task = make_task(key, key.level);
    const bool is_top = key == top_;
    const std::int64_t dx = !is_top && key.x % 2 ? side : 0, dy = !is_top && key.y % 2 ? side : 0;
    for (const LocalVertex& v : inherited) {
      const LocalVertex local{v.x - dx, v.y - dy, v.z};
      if (local.x > 0 && local.y > 0 && local.x < side && local.y < side) task.initial.push_back(local);
    }
    for (const LineSegment& s : lines_.segments(key)) {
      task.constraints.push_back(
          {LocalVertex{s.a.x - west, s.a.y - south, s.a.z}, LocalVertex{s.b.x - west, s.b.y - south, s.b.z}});
    }
    const int segments = spec_.seed_segments[key.level];
    for (int j = 1; j < segments; ++j) {
      for (int i = 1; i < segments; ++i) {
        const std::int64_t x = side / segments * i, y = side / segments * j;
        task.initial.push_back({x, y, field_.lattice_height(west + x, south + y)});
      }
    }
    TileSurface surface = triangulate(field_, task);
    TileBody body;
    body.stats = surface.stats;
    double on_border = 0;
    for (std::size_t b = 0; b < 4; ++b) {
      body.n_side[b] = static_cast<std::uint32_t>(task.borders[b].size() - 1);
      on_border += body.n_side[b];
      const auto part = border(key, static_cast<int>(b));
      out.bytes += stored_bytes(pack_value(encode_edge(edge_of_level(part, key.level))).size()) / 2;
    }
    body.interior = surface.interior;
    body.triangles = std::move(surface.triangles);
    body.n_gaps = static_cast<std::uint8_t>(spec_.bottom_level() - key.level);
    body.virtual_triangles = find_virtual_triangles(body.triangles, body.n_side);
    for (VirtualTriangle& vt : body.virtual_triangles) {
      vt.runs.assign(static_cast<std::size_t>(vt.n_edges) * body.n_gaps, 1);  // how many is told by the edges
    }
    out.bytes += stored_bytes(pack_body(body).size()) + stored_bytes(4);
    out.vertices += 1 + on_border / 2 + static_cast<double>(body.interior.size());
    interior = std::move(body.interior);
  }

  const HeightField& field_;
  const LinePyramid& lines_;
  const TileKey top_;
  RefinementSpec spec_;
  struct Stretch {
    RootEdge root;
    std::vector<LineVertex> vertices;
  };
  std::vector<Stretch> stretches_;
};

}  // namespace

double thread_seconds() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

RegionSample build_region(const HeightField& field, const LevelTable& table, const LinePyramid& lines,
                          const TileKey& top, int turn) {
  RegionSample sample;
  RegionBuilder(field, table, lines, top).build(turn, sample);
  return sample;
}

}  // namespace tind
