// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/pyramid_builder.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <chrono>
#include <cmath>
#include <map>
#include <span>
#include <string>
#include <utility>

#include "core/border_line.hpp"
#include "core/tessellation.hpp"
#include "core/triangulator.hpp"
#include "storage/builder/border_lines.hpp"
#include "storage/builder/ordered_pipeline.hpp"
#include "storage/builder/plan.hpp"
#include "storage/builder/tile_posts.hpp"
#include "storage/piece_blob.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

// Sources that disagree by more than this part of E_bottom are not paid for with vertices, only reported.
constexpr double kDisagreementShare = 1.0 / 8;
// Margins never take more than this part of a tolerance.
constexpr double kMostMargin = 1.0 / 2;

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

struct TileResult {
  Bytes value;
  TileStats stats;
  std::uint64_t n_interior = 0, n_inserted = 0, n_of_lines = 0, n_triangles = 0, n_outside = 0;
  std::uint64_t n_line_pieces = 0, n_left_out = 0;
  std::string error;
};

class PyramidBuilder {
 public:
  PyramidBuilder(const PyramidInput& input, TileStoreWriter& writer, Progress& progress, double progress_from)
      : input_(input),
        field_(input.field),
        table_(input.table),
        writer_(writer),
        progress_(progress),
        progress_from_(progress_from),
        plan_(field_, table_.bottom_level()),
        borders_(field_.lattice) {
    const double bottom_m = table_.levels.back().tolerance_m;
    // What rounding may add outside the greedy loop: a post's height is kept as a float, a vertex's in height units.
    const double unit = field_.lattice.height_unit_m();
    const double disagreement = field_.disagreement_m <= bottom_m * kDisagreementShare ? field_.disagreement_m : 0;
    const double margin = unit / 2 + disagreement;
    spec_.height_step_m = height_steps(field_, plan_, field_.pinned.empty() ? 0 : bottom_m / 2);
    for (int level = 0; level <= table_.bottom_level(); ++level) {
      const double tolerance = table_.levels[static_cast<std::size_t>(level)].tolerance_m;
      spec_.tolerance_m.push_back(tolerance - std::min(margin, tolerance * kMostMargin));
      spec_.seed_segments.push_back(seed_segments(level, tolerance, field_.lattice.ellipsoid.semi_major_m));
    }
  }

  Result<void> run(Manifest& manifest, std::vector<LevelBreakdown>& breakdown) {
    for (int level = 0; level <= table_.bottom_level(); ++level) {
      const auto start = std::chrono::steady_clock::now();
      LevelInfo info;
      LevelBreakdown parts;
      if (auto done = refine_lines(level); !done) return done;
      if (auto done = build_level(level, info, parts); !done) return done;
      parts.seconds = seconds_since(start);
      if (info.max_error_m > info.tolerance_m) {
        progress_.note(
            fmt::format("level {}: the error at a post is {:.3f} m, above E_L = {:.3f} m: the tolerance is finer than "
                        "the posts' heights allow; the file says so, too",
                        level, info.max_error_m, info.tolerance_m));
      }
      manifest.levels.push_back(std::move(info));
      breakdown.push_back(parts);
    }
    return {};
  }

 private:
  bool cancelled() const { return input_.cancel && input_.cancel->load(std::memory_order_relaxed); }

  static Error cancelled_error() { return {ErrorKind::kIo, "interrupted; nothing was written"}; }

  // The parent's stored body, copied because the writer's views do not outlive the next append.
  Bytes parent_value(const TileKey& parent) const {
    const auto value = writer_.find({PieceKind::kBody, parent.level, parent.x, parent.y});
    return value ? Bytes(value->begin(), value->end()) : Bytes();
  }

  // The parent's interior vertices in the lattice's coordinates relative to the parent's SW corner.
  static Result<std::vector<LocalVertex>> parent_interior(const Bytes& value) {
    auto record = unpack_value(value);
    if (!record) return tl::unexpected(record.error());
    auto body = decode_body(*record);
    if (!body) return tl::unexpected(body.error());
    return std::move(body->interior);
  }

  Result<void> refine_lines(int level) {
    const std::vector<RootEdge> roots = plan_.root_edges(level, field_.lattice);
    struct In {
      RootEdge root;
      Bytes parent;
    };
    const auto prepare = [&](std::size_t i) {
      In in{roots[i], {}};
      if (level > 0) in.parent = parent_value(parent_of(roots[i]));
      return in;
    };
    const auto work = [&](In&& in) {
      std::vector<std::int64_t> pins;
      if (level > 0) pins = pins_of(in.root, in.parent);
      const bool vertical = in.root.vertical;
      const std::int64_t at = in.root.at;
      const auto crossings =
          input_.lines.crossings(vertical, at, in.root.start, in.root.start + field_.lattice.tile_side(in.root.level));
      return refine_root_edge(field_, spec_, in.root, pins, crossings, [&](int edge_level, std::int64_t start) {
        const std::int64_t side = field_.lattice.tile_side(edge_level);
        return plan_.is_edge_split(edge_level, vertical, at / side, start / side);
      });
    };
    const auto consume = [&](std::size_t i, std::vector<LineVertex>&& vertices) {
      borders_.add(roots[i], std::move(vertices));
      return !cancelled();
    };
    if (!run_ordered<In, std::vector<LineVertex>>(roots.size(), input_.threads, prepare, work, consume)) {
      return tl::unexpected(cancelled_error());
    }
    return {};
  }

  // The tile one level up whose middle line the stretch lies on.
  TileKey parent_of(const RootEdge& root) const {
    const std::int64_t side = field_.lattice.tile_side(root.level - 1);
    const std::int64_t x = root.vertical ? root.at : root.start, y = root.vertical ? root.start : root.at;
    return {static_cast<std::uint8_t>(root.level - 1), static_cast<std::uint32_t>(x / side),
            static_cast<std::uint32_t>(y / side)};
  }

  // Where the parent tile has vertices on the stretch (DESIGN: at l0 also pin the parent's vertices that lie on l).
  std::vector<std::int64_t> pins_of(const RootEdge& root, const Bytes& value) const {
    std::vector<std::int64_t> pins;
    const auto interior = parent_interior(value);
    assert(interior.has_value() && "the writer's own body");
    const TileKey parent = parent_of(root);
    const std::int64_t side = field_.lattice.tile_side(parent.level), west = side * parent.x, south = side * parent.y;
    const std::int64_t end = root.start + side / 2;
    for (const LocalVertex& v : *interior) {
      const std::int64_t x = west + v.x, y = south + v.y;
      const std::int64_t across = root.vertical ? x : y, along = root.vertical ? y : x;
      if (across == root.at && along > root.start && along < end) pins.push_back(along);
    }
    std::sort(pins.begin(), pins.end());
    return pins;
  }

  TileTask make_task(const TileKey& key, const std::vector<LocalVertex>& inherited) const {
    const std::int64_t side = field_.lattice.tile_side(key.level);
    const std::int64_t west = side * key.x, south = side * key.y;
    TileTask task;
    task.key = key;
    task.tolerance_m = spec_.tolerance_m[key.level];
    task.height_step_m = spec_.height_step_m[key.level];
    for (int b = 0; b < 4; ++b) set_border(field_.lattice, borders_.border(key, b), b, task);
    // The parent's vertices inside this quarter; those on the middle lines are on the border.
    const std::int64_t dx = key.x % 2 ? side : 0, dy = key.y % 2 ? side : 0;
    for (const LocalVertex& v : inherited) {
      const LocalVertex local{v.x - dx, v.y - dy, v.z};
      if (local.x > 0 && local.y > 0 && local.x < side && local.y < side) task.initial.push_back(local);
    }
    for (const LineSegment& s : input_.lines.segments(key)) {
      task.constraints.push_back(
          {LocalVertex{s.a.x - west, s.a.y - south, s.a.z}, LocalVertex{s.b.x - west, s.b.y - south, s.b.z}});
    }
    const int segments = spec_.seed_segments[key.level];
    const std::int64_t step = side / segments;
    for (int j = 1; j < segments; ++j) {
      for (int i = 1; i < segments; ++i) {
        task.initial.push_back({i * step, j * step, field_.lattice_height(west + i * step, south + j * step)});
      }
    }
    return task;
  }

  // Runs of the border edges of a virtual triangle against all finer levels.
  void add_runs(const TileKey& key, TileBody& body) const {
    std::array<std::vector<std::vector<std::uint32_t>>, 4> runs;  // border, interval in ring direction
    for (int b = 0; b < 4; ++b) {
      const std::span<const LineVertex> part = borders_.border(key, b);
      auto& intervals = runs[static_cast<std::size_t>(b)];
      std::vector<std::uint8_t> inside;
      for (const LineVertex& v : part.subspan(1)) {
        if (v.entry > key.level) {
          inside.push_back(v.entry);
        } else {
          intervals.push_back(encode_runs(inside, key.level, body.n_gaps));
          inside.clear();
        }
      }
      if (b >= 2) std::reverse(intervals.begin(), intervals.end());
    }
    for (VirtualTriangle& vt : body.virtual_triangles) {
      if (vt.n_edges == 2) {
        const auto& before = runs[(vt.border + 3u) % 4].back();
        vt.runs.insert(vt.runs.end(), before.begin(), before.end());
      }
      const auto& own = runs[vt.border][vt.interval];
      vt.runs.insert(vt.runs.end(), own.begin(), own.end());
    }
  }

  TileResult build_tile(const TileKey& key, const Bytes& parent) const {
    TileResult result;
    std::vector<LocalVertex> inherited;
    if (key.level > 0) {
      auto interior = parent_interior(parent);
      if (!interior) {
        result.error = interior.error().message;
        return result;
      }
      inherited = std::move(*interior);
    }
    const TileTask task = make_task(key, inherited);
    TileSurface surface = triangulate(field_, task);
    TileBody body;
    body.stats = surface.stats;
    body.stats.coverage = coverage_of(field_, key);
    for (std::size_t b = 0; b < 4; ++b) body.n_side[b] = static_cast<std::uint32_t>(task.borders[b].size() - 1);
    body.interior = std::move(surface.interior);
    body.triangles = std::move(surface.triangles);
    body.n_gaps = static_cast<std::uint8_t>(table_.bottom_level() - key.level);
    body.virtual_triangles = find_virtual_triangles(body.triangles, body.n_side);
    add_runs(key, body);
    result.stats = body.stats;
    result.n_interior = body.interior.size();
    const std::int64_t side = field_.lattice.tile_side(key.level);
    for (const LocalVertex& v : body.interior)
      result.n_outside += is_outside(field_, side * key.x + v.x, side * key.y + v.y);
    result.n_inserted = surface.n_inserted;
    result.n_of_lines = surface.n_of_lines;
    result.n_line_pieces = task.constraints.size();
    result.n_left_out = surface.n_left_out;
    result.n_triangles = body.triangles.size();
    result.value = pack_body(body);
    return result;
  }

  // Corner and edge values, made where they are written: they are slices of the lines.
  Bytes border_value(const PieceKey& key, LevelInfo& info, LevelBreakdown& parts) const {
    const std::int64_t side = field_.lattice.tile_side(key.level);
    if (key.kind == PieceKind::kCorner) {
      ++parts.corners;
      parts.outside += is_outside(field_, side * key.i, side * key.j);
      return pack_value(encode_corner({field_.lattice_height(side * key.i, side * key.j)}));
    }
    const bool vertical = key.kind == PieceKind::kEdgeV;
    const auto part =
        vertical ? borders_.side(true, key.level, key.i, key.j) : borders_.side(false, key.level, key.j, key.i);
    const EdgeChain edge = edge_of_level(part, key.level);
    parts.border += edge.inner.size();
    for (const EdgeVertex& v : edge.inner) {
      parts.outside += is_outside(field_, side * key.i + (vertical ? 0 : v.t), side * key.j + (vertical ? v.t : 0));
    }
    info.n_seed_vertices += static_cast<std::uint64_t>(spec_.seed_segments[key.level] - 1);
    return pack_value(encode_edge(edge));
  }

  Result<void> build_level(int level, LevelInfo& info, LevelBreakdown& parts) {
    const std::vector<TileKey>& tiles = plan_.tiles(level);
    const std::vector<PieceKey> pieces = plan_.pieces(level);
    const LevelSpec& spec = table_.levels[static_cast<std::size_t>(level)];
    info.level = level;
    info.tolerance_m = spec.tolerance_m;
    info.spacing_m = spec.spacing_m;
    info.height_step_m = spec_.height_step_m[static_cast<std::size_t>(level)];
    info.n_tiles = tiles.size();
    const auto seeds_per_axis = static_cast<std::uint64_t>(spec_.seed_segments[static_cast<std::size_t>(level)] - 1);
    info.n_seed_vertices = tiles.size() * seeds_per_axis * seeds_per_axis;

    std::string error;
    double squares = 0;
    std::size_t next_piece = 0;
    std::vector<TileCoverage> coverage;
    coverage.reserve(tiles.size());
    const auto append = [&](const PieceKey& key, ByteView value) {
      info.bytes += value.size();
      if (auto done = writer_.append(key, value); !done) error = done.error().message;
      return error.empty();
    };
    struct In {
      TileKey key;
      Bytes parent;
    };
    const auto prepare = [&](std::size_t i) {
      return In{tiles[i], level > 0 ? parent_value(tiles[i].parent()) : Bytes()};
    };
    const auto work = [&](In&& in) { return build_tile(in.key, in.parent); };
    const auto consume = [&](std::size_t i, TileResult&& tile) {
      if (!tile.error.empty()) {
        error = tile.error;
        return false;
      }
      for (; pieces[next_piece].kind != PieceKind::kBody; ++next_piece) {
        if (!append(pieces[next_piece], border_value(pieces[next_piece], info, parts))) return false;
      }
      if (!append(pieces[next_piece++], tile.value)) return false;
      coverage.push_back(tile.stats.coverage);
      parts.inserted += tile.n_inserted;
      parts.outside += tile.n_outside;
      parts.inherited += tile.n_interior - tile.n_inserted - tile.n_of_lines;
      parts.of_lines += tile.n_of_lines;
      parts.line_pieces += tile.n_line_pieces;
      parts.left_out += tile.n_left_out;
      info.n_triangles += tile.n_triangles;
      info.n_posts += tile.stats.n_posts;
      info.max_error_m = std::max(info.max_error_m, static_cast<double>(tile.stats.max_error_m));
      squares += static_cast<double>(tile.stats.rmse_m) * tile.stats.rmse_m * static_cast<double>(tile.stats.n_posts);
      const double done = static_cast<double>(i + 1) / static_cast<double>(tiles.size());
      progress_.update(progress_from_ + (1 - progress_from_) * work_share(level, done),
                       fmt::format("level {} of {}", level, table_.bottom_level()));
      return !cancelled();
    };
    if (!run_ordered<In, TileResult>(tiles.size(), input_.threads, prepare, work, consume)) {
      if (error.empty()) return tl::unexpected(cancelled_error());
      return fail(ErrorKind::kIo, error);
    }
    for (; next_piece < pieces.size(); ++next_piece) {
      if (!append(pieces[next_piece], border_value(pieces[next_piece], info, parts)))
        return fail(ErrorKind::kIo, error);
    }
    info.rmse_m = info.n_posts ? std::sqrt(squares / static_cast<double>(info.n_posts)) : 0;
    info.n_border_vertices = parts.corners + parts.border;
    info.n_vertices = info.n_border_vertices + parts.inherited + parts.of_lines + parts.inserted;
    add_rows(tiles, coverage, info);
    return {};
  }

  static void add_rows(const std::vector<TileKey>& tiles, const std::vector<TileCoverage>& coverage, LevelInfo& info) {
    std::map<std::pair<std::uint32_t, std::uint32_t>, TileCoverage> by_row;
    for (std::size_t i = 0; i < tiles.size(); ++i) {
      by_row[{tiles[i].y, tiles[i].x}] = coverage[i];
      ++(coverage[i] == TileCoverage::kReal      ? info.n_real
         : coverage[i] == TileCoverage::kPartial ? info.n_partial
                                                 : info.n_filler);
    }
    for (const auto& [position, kind] : by_row) {
      const auto [y, x] = position;
      if (!info.rows.empty() && info.rows.back().y == y && info.rows.back().x_last + 1 == x &&
          info.rows.back().coverage == kind) {
        info.rows.back().x_last = x;
      } else {
        info.rows.push_back({y, x, x, kind});
      }
    }
  }

  // Share of all levels' work done. Every level looks at every post; each halving of E below a kilometre adds work.
  double work_share(int level, double done_of_level) const {
    const auto weight = [&](int l) {
      const double tolerance = table_.levels[static_cast<std::size_t>(l)].tolerance_m;
      return 1.0 + std::max(0.0, std::log2(1000 / tolerance));
    };
    double before = 0, all = 0;
    for (int l = 0; l <= table_.bottom_level(); ++l) {
      if (l < level) before += weight(l);
      all += weight(l);
    }
    return (before + done_of_level * weight(level)) / all;
  }

  const PyramidInput& input_;
  const HeightField& field_;
  const LevelTable& table_;
  TileStoreWriter& writer_;
  Progress& progress_;
  const double progress_from_;
  const TilePlan plan_;
  RefinementSpec spec_;
  BorderLines borders_;
};

}  // namespace

Result<void> build_levels(const PyramidInput& input, TileStoreWriter& writer, Progress& progress, double progress_from,
                          Manifest& manifest, std::vector<LevelBreakdown>& breakdown) {
  return PyramidBuilder(input, writer, progress, progress_from).run(manifest, breakdown);
}

}  // namespace tind
