// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/build.hpp"

#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <map>
#include <numbers>
#include <set>
#include <thread>
#include <tuple>
#include <unordered_map>

#include "core/format/quantized_mesh.hpp"
#include "core/tessellation.hpp"
#include "core/triangulator.hpp"
#include "storage/builder/ordered_pipeline.hpp"
#include "storage/builder/plan.hpp"
#include "storage/piece_blob.hpp"
#include "storage/tile_store.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

constexpr const char* kGenerator = "tind-build 0.1.0";
// Sources that disagree by more than this part of E_bottom are not paid for with vertices, only reported.
constexpr double kDisagreementShare = 1.0 / 8;
// Margins never take more than this part of a tolerance.
constexpr double kMostMargin = 1.0 / 2;
// Share of the whole work that reading takes, for the progress line.
constexpr double kReadShare = 0.08;

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

// Refined border lines, found by the side of any tile.
class LineStore {
 public:
  explicit LineStore(const Lattice& lattice) : lattice_(lattice) {}

  void add(const RootEdge& root, std::vector<LineVertex> vertices) {
    const std::int64_t side = lattice_.tile_side(root.level);
    lines_.emplace(Key{root.vertical, root.level, root.at / side, root.start / side}, std::move(vertices));
  }

  // All vertices of any level on the side of a stored tile. `line` and `along` in tile sides of `level`.
  std::span<const LineVertex> side(bool vertical, int level, std::int64_t line, std::int64_t along) const {
    if (vertical) line %= TileKey::count_x(level);  // longitude +180 is -180
    const std::int64_t length = lattice_.tile_side(level);
    int root_level = level;
    while (root_level > 0 && line % 2 == 0) {
      line /= 2;
      --root_level;
    }
    const auto& vertices = lines_.at(Key{vertical, root_level, line, along >> (level - root_level)});
    return line_between(vertices, along * length, (along + 1) * length);
  }

  // Border b (ring order) of a tile, in stored direction.
  std::span<const LineVertex> border(const TileKey& t, int b) const {
    switch (b) {
      case 0:
        return side(false, t.level, t.y, t.x);
      case 1:
        return side(true, t.level, std::int64_t{t.x} + 1, t.y);
      case 2:
        return side(false, t.level, std::int64_t{t.y} + 1, t.x);
      default:
        return side(true, t.level, t.x, t.y);
    }
  }

 private:
  using Key = std::tuple<bool, int, std::int64_t, std::int64_t>;
  struct KeyHash {
    std::size_t operator()(const Key& k) const noexcept {
      const auto [vertical, level, line, along] = k;
      std::uint64_t h = morton_code(static_cast<std::uint32_t>(line), static_cast<std::uint32_t>(along));
      h ^= (static_cast<std::uint64_t>(level) * 2 + (vertical ? 1 : 0)) << 57;
      return std::hash<std::uint64_t>{}(h * 0x9E3779B97F4A7C15ull);
    }
  };
  const Lattice& lattice_;
  std::unordered_map<Key, std::vector<LineVertex>, KeyHash> lines_;
};

// How much of a tile comes from the source, judged by the posts of all cells that the tile meets.
TileCoverage coverage_of(const HeightField& field, const TileKey& key) {
  const double side = static_cast<double>(field.lattice.tile_side(key.level));
  const double west = side * key.x, south = side * key.y;
  auto r_first = static_cast<std::int64_t>(std::floor((south - field.y0) / field.dy));
  auto r_last = static_cast<std::int64_t>(std::ceil((south + side - field.y0) / field.dy));
  if (field.continues_south) r_first = std::max<std::int64_t>(r_first, 0);
  if (field.continues_north) r_last = std::min(r_last, field.n_rows - 1);
  const bool rows_inside = r_first >= 0 && r_last < field.n_rows;
  bool any = false, all = false;
  const double width = static_cast<double>(field.lattice.width());
  for (const double turn : {-width, 0.0, width}) {
    if (field.wraps && turn != 0.0) continue;
    const auto c_first = static_cast<std::int64_t>(std::floor((west - field.x0 - turn) / field.dx));
    const auto c_last = static_cast<std::int64_t>(std::ceil((west + side - field.x0 - turn) / field.dx));
    bool complete = rows_inside && (field.wraps || (c_first >= 0 && c_last < field.n_cols));
    for (std::int64_t r = std::max<std::int64_t>(r_first, 0); r <= std::min(r_last, field.n_rows - 1); ++r) {
      const std::int64_t c_low = field.wraps ? c_first : std::max<std::int64_t>(c_first, 0);
      const std::int64_t c_high = field.wraps ? c_last : std::min(c_last, field.n_cols - 1);
      for (std::int64_t c = c_low; c <= c_high; ++c) {
        const std::int64_t column = field.wraps ? ((c % field.n_cols) + field.n_cols) % field.n_cols : c;
        const bool is_source = field.origin_at(r, column) == PostOrigin::kSource;
        any = any || is_source;
        complete = complete && is_source;
        if (any && !complete) return TileCoverage::kPartial;
      }
    }
    all = all || complete;
  }
  return all ? TileCoverage::kReal : any ? TileCoverage::kPartial : TileCoverage::kFiller;
}

// Smallest power of two s with at most 32767 steps between a tile's lowest and highest height, both rounded outwards.
double height_step_m(double low, double high) {
  double step = kSmallestBorderStepM;
  while (std::ceil(high / step) - std::floor(low / step) > kQuantizedSteps) step *= 2;
  return step;
}

// Whether a lattice point lies beyond the data: its nearest post is falloff or base.
bool is_outside(const HeightField& field, std::int64_t x, std::int64_t y) {
  const std::int64_t r = std::llround((static_cast<double>(y) - field.y0) / field.dy);
  if (r < 0 || r >= field.n_rows) return true;
  for (const double turn : {-1.0, 0.0, 1.0}) {
    const double shifted = static_cast<double>(x) + turn * static_cast<double>(field.lattice.width());
    const std::int64_t c = std::llround((shifted - field.x0) / field.dx);
    if (c < 0 || c >= field.n_cols) continue;
    const PostOrigin origin = field.origin_at(r, c);
    if (origin == PostOrigin::kSource || origin == PostOrigin::kFilled) return false;
  }
  return true;
}

struct TileResult {
  Bytes value;
  TileStats stats;
  std::uint64_t n_interior = 0, n_inserted = 0, n_triangles = 0, n_outside = 0;
  std::string error;
};

class PyramidBuilder {
 public:
  PyramidBuilder(const BuildOptions& options, const HeightField& field, const LevelTable& table, int threads,
                 TileStoreWriter& writer, Progress& progress)
      : options_(options),
        field_(field),
        table_(table),
        threads_(threads),
        writer_(writer),
        progress_(progress),
        plan_(field, table.bottom_level()),
        lines_(field.lattice) {
    const double bottom_m = table.levels.back().tolerance_m;
    // What rounding may add outside the greedy loop: a post's height is kept as a float, a vertex's in height units.
    const double unit = field.lattice.height_unit_m();
    const double disagreement = field.disagreement_m <= bottom_m * kDisagreementShare ? field.disagreement_m : 0;
    const double margin = unit / 2 + disagreement;
    spec_.height_step_m = height_steps();
    for (int level = 0; level <= table.bottom_level(); ++level) {
      const double tolerance = table.levels[static_cast<std::size_t>(level)].tolerance_m;
      spec_.tolerance_m.push_back(tolerance - std::min(margin, tolerance * kMostMargin));
      spec_.seed_segments.push_back(seed_segments(level, tolerance, field.lattice.ellipsoid.semi_major_m));
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
  // The levels' height steps, from the posts in and around each tile.
  std::vector<double> height_steps() const {
    struct Range {
      double low, high;
    };
    std::vector<double> steps(static_cast<std::size_t>(table_.bottom_level()) + 1, kSmallestBorderStepM);
    std::unordered_map<TileKey, Range> finer;
    for (int level = table_.bottom_level(); level >= 0; --level) {
      std::unordered_map<TileKey, Range> ranges;
      const double unit = field_.lattice.height_unit_m();
      for (const TileKey& tile : plan_.tiles(level)) {
        Range range{field_.base_height_m, field_.base_height_m};
        const auto include = [&range](double low, double high) {
          range = {std::min(range.low, low), std::max(range.high, high)};
        };
        if (level == table_.bottom_level()) {
          for_posts_around(
              tile, [&](std::int64_t r, std::int64_t c) { include(field_.height_at(r, c), field_.height_at(r, c)); });
        } else if (plan_.is_split(tile)) {
          for (int child = 0; child < 4; ++child)
            include(finer.at(tile.child(child)).low, finer.at(tile.child(child)).high);
        }
        double& step = steps[static_cast<std::size_t>(level)];
        step = std::max(step, height_step_m(range.low - unit, range.high + unit));
        ranges.emplace(tile, range);
      }
      finer = std::move(ranges);
    }
    return steps;
  }

  // Calls visit(row, column) for the posts of all cells that meet the tile.
  template <class Visit>
  void for_posts_around(const TileKey& tile, Visit visit) const {
    const double side = static_cast<double>(field_.lattice.tile_side(tile.level));
    const double width = static_cast<double>(field_.lattice.width());
    const auto r_first = static_cast<std::int64_t>(std::floor((side * tile.y - field_.y0) / field_.dy));
    const auto r_last = static_cast<std::int64_t>(std::ceil((side * (tile.y + 1.0) - field_.y0) / field_.dy));
    for (const double turn : {-width, 0.0, width}) {
      const auto c_first = static_cast<std::int64_t>(std::floor((side * tile.x - field_.x0 - turn) / field_.dx));
      const auto c_last = static_cast<std::int64_t>(std::ceil((side * (tile.x + 1.0) - field_.x0 - turn) / field_.dx));
      for (std::int64_t r = std::max<std::int64_t>(r_first, 0); r <= std::min(r_last, field_.n_rows - 1); ++r) {
        for (std::int64_t c = std::max<std::int64_t>(c_first, 0); c <= std::min(c_last, field_.n_cols - 1); ++c) {
          visit(r, c);
        }
      }
    }
  }

  bool cancelled() const { return options_.cancel && options_.cancel->load(std::memory_order_relaxed); }

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
      return refine_root_edge(field_, spec_, in.root, pins, [&](int edge_level, std::int64_t start) {
        const std::int64_t side = field_.lattice.tile_side(edge_level);
        return plan_.is_edge_split(edge_level, vertical, at / side, start / side);
      });
    };
    const auto consume = [&](std::size_t i, std::vector<LineVertex>&& vertices) {
      lines_.add(roots[i], std::move(vertices));
      return !cancelled();
    };
    if (!run_ordered<In, std::vector<LineVertex>>(roots.size(), threads_, prepare, work, consume)) {
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
    for (int b = 0; b < 4; ++b) {
      const std::span<const LineVertex> part = lines_.border(key, b);
      const std::int64_t origin = part.front().t;
      auto& border = task.borders[static_cast<std::size_t>(b)];
      for (const LineVertex& v : part) {
        if (v.entry > key.level) continue;
        const std::int64_t t = v.t - origin;
        border.push_back(b == 0   ? LocalVertex{t, 0, v.z}
                         : b == 1 ? LocalVertex{side, t, v.z}
                         : b == 2 ? LocalVertex{t, side, v.z}
                                  : LocalVertex{0, t, v.z});
      }
      if (b >= 2) std::reverse(border.begin(), border.end());
      border.pop_back();  // the next corner belongs to the next border
      auto& envelope = task.envelopes[static_cast<std::size_t>(b)];
      envelope = envelope_of(part, key.level, field_.lattice);
      for (EnvelopeKnot& knot : envelope) knot.t -= static_cast<double>(origin);
    }
    // The parent's vertices inside this quarter; those on the middle lines are on the border.
    const std::int64_t dx = key.x % 2 ? side : 0, dy = key.y % 2 ? side : 0;
    for (const LocalVertex& v : inherited) {
      const LocalVertex local{v.x - dx, v.y - dy, v.z};
      if (local.x > 0 && local.y > 0 && local.x < side && local.y < side) task.initial.push_back(local);
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
      const std::span<const LineVertex> part = lines_.border(key, b);
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
    result.n_triangles = body.triangles.size();
    result.value = pack_value(encode_body(body));
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
        vertical ? lines_.side(true, key.level, key.i, key.j) : lines_.side(false, key.level, key.j, key.i);
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
      parts.inherited += tile.n_interior - tile.n_inserted;
      info.n_triangles += tile.n_triangles;
      info.n_posts += tile.stats.n_posts;
      info.max_error_m = std::max(info.max_error_m, static_cast<double>(tile.stats.max_error_m));
      squares += static_cast<double>(tile.stats.rmse_m) * tile.stats.rmse_m * static_cast<double>(tile.stats.n_posts);
      const double done = static_cast<double>(i + 1) / static_cast<double>(tiles.size());
      progress_.update(kReadShare + (1 - kReadShare) * work_share(level, done),
                       fmt::format("level {} of {}", level, table_.bottom_level()));
      return !cancelled();
    };
    if (!run_ordered<In, TileResult>(tiles.size(), threads_, prepare, work, consume)) {
      if (error.empty()) return tl::unexpected(cancelled_error());
      return fail(ErrorKind::kIo, error);
    }
    for (; next_piece < pieces.size(); ++next_piece) {
      if (!append(pieces[next_piece], border_value(pieces[next_piece], info, parts)))
        return fail(ErrorKind::kIo, error);
    }
    info.rmse_m = info.n_posts ? std::sqrt(squares / static_cast<double>(info.n_posts)) : 0;
    info.n_border_vertices = parts.corners + parts.border;
    info.n_vertices = info.n_border_vertices + parts.inherited + parts.inserted;
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

  const BuildOptions& options_;
  const HeightField& field_;
  const LevelTable& table_;
  const int threads_;
  TileStoreWriter& writer_;
  Progress& progress_;
  const TilePlan plan_;
  RefinementSpec spec_;
  LineStore lines_;
};

// A file under a temporary name that is removed unless it gets its final one.
class TemporaryFile {
 public:
  explicit TemporaryFile(std::string path) : path_(std::move(path)) {}
  ~TemporaryFile() {
    if (!path_.empty()) ::unlink(path_.c_str());
  }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;

  const std::string& path() const { return path_; }
  Result<void> rename_to(const std::string& target) {
    if (std::rename(path_.c_str(), target.c_str()) != 0) {
      return fail(ErrorKind::kIo, target + ": cannot be put in place: " + std::strerror(errno));
    }
    path_.clear();
    return {};
  }

 private:
  std::string path_;
};

Result<void> check_output(const BuildOptions& options) {
  namespace fs = std::filesystem;
  std::error_code code;
  const fs::path output(options.output);
  if (options.output.empty()) return fail(ErrorKind::kInvalidInput, "no output named: give -o NAME.tind");
  const fs::path folder = output.has_parent_path() ? output.parent_path() : fs::path(".");
  if (!fs::is_directory(folder, code)) {
    return fail(ErrorKind::kInvalidInput, folder.string() + ": no such folder; make it first");
  }
  if (fs::is_directory(output, code)) {
    return fail(ErrorKind::kInvalidInput,
                options.output + ": is a folder; name a file, for example " + (output / "terrain.tind").string());
  }
  if (!options.force && fs::exists(output, code)) {
    return fail(ErrorKind::kInvalidInput, options.output + ": exists; give --force to replace it");
  }
  return {};
}

std::string options_to_json(const BuildOptions& options) {
  nlohmann::json j = {{"base_height_m", options.base_height_m},
                      {"falloff_posts", options.falloff_posts},
                      {"metres_per_degree", options.mid_latitude_metres ? "mid-latitude" : "equator"}};
  if (options.levels.max_level) j["max_level"] = *options.levels.max_level;
  if (options.levels.tolerance_m) j["tolerance_m"] = *options.levels.tolerance_m;
  if (options.levels.finest_m) j["finest_m"] = *options.levels.finest_m;
  if (options.raster.nodata) j["nodata"] = *options.raster.nodata;
  if (options.raster.metres_per_unit) j["metres_per_unit"] = *options.raster.metres_per_unit;
  return j.dump();
}

}  // namespace

Result<BuildReport> build_pyramid(const BuildOptions& options, Progress& progress) {
  const auto start = std::chrono::steady_clock::now();
  if (auto checked = check_output(options); !checked) return tl::unexpected(checked.error());
  progress.update(0, "reading");
  auto mosaic = RasterMosaic::open(options.inputs, options.raster);
  if (!mosaic) return tl::unexpected(mosaic.error());
  for (const std::string& note : mosaic->notes) progress.note(note);

  Lattice lattice;
  const double north_deg = mosaic->south_deg + mosaic->lat_spacing_deg * static_cast<double>(mosaic->n_rows - 1);
  const double east_deg = mosaic->west_deg + mosaic->lon_spacing_deg * static_cast<double>(mosaic->n_cols - 1);
  LevelOptions level_options = options.levels;
  level_options.metres_per_degree = lattice.ellipsoid.semi_major_m * std::numbers::pi / 180;
  if (options.mid_latitude_metres) {
    level_options.metres_per_degree *= std::cos((mosaic->south_deg + north_deg) / 2 * std::numbers::pi / 180);
  }
  const auto table = make_level_table(mosaic->lon_spacing_deg, mosaic->lat_spacing_deg, level_options);
  if (!table) return tl::unexpected(table.error());
  lattice.level = table->lattice_level;
  lattice.height_exponent = table->height_exponent;

  // The output's name is taken before the long work begins, so that an unwritable folder is known at once.
  TemporaryFile temporary(fmt::format("{}-{}.tmp", options.output, ::getpid()));
  auto writer = TileStoreWriter::create(temporary.path());
  if (!writer) return tl::unexpected(writer.error());

  HeightGridOptions grid_options;
  grid_options.base_height_m = options.base_height_m;
  grid_options.falloff_posts = options.falloff_posts;
  const auto folder = std::filesystem::path(options.output).parent_path();
  grid_options.scratch_dir = folder.empty() ? "." : folder.string();
  const auto grid = HeightGrid::load(*mosaic, lattice, grid_options,
                                     [&](double fraction) { progress.update(kReadShare * fraction, "reading"); });
  if (!grid) return tl::unexpected(grid.error());
  for (const std::string& note : grid->notes()) progress.note(note);

  BuildReport report;
  report.read_seconds = seconds_since(start);
  report.counts = grid->counts();
  report.threads =
      options.threads > 0 ? options.threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  Manifest& m = report.manifest;
  m.generator = kGenerator;
  m.attribution = options.attribution;
  m.vertical_datum = mosaic->vertical_datum;
  m.mode = options.levels.mode == LevelMode::kStandard ? "standard" : "non-standard";
  m.lattice = lattice;
  m.bottom_level = table->bottom_level();
  m.base_height_m = options.base_height_m;
  m.falloff_posts = options.falloff_posts;
  m.disagreement_m = grid->field().disagreement_m;
  m.bounds_deg = {mosaic->west_deg, mosaic->south_deg, east_deg, north_deg};
  m.spacing_deg = {mosaic->lon_spacing_deg, mosaic->lat_spacing_deg};
  for (const RasterSource& s : mosaic->sources) m.sources.push_back({s.name, s.sha256, s.n_cols, s.n_rows});
  m.n_source_posts = report.counts.source;
  m.n_filled_posts = report.counts.filled;
  m.n_falloff_posts = report.counts.falloff;
  m.options_json = options_to_json(options);

  PyramidBuilder builder(options, grid->field(), *table, report.threads, *writer, progress);
  if (auto built = builder.run(m, report.breakdown); !built) return tl::unexpected(built.error());
  m.content_hash = writer->content_hash();
  const std::string manifest = encode_manifest(m);
  if (auto done = writer->finish(pack_value(Bytes(manifest.begin(), manifest.end()))); !done) {
    return tl::unexpected(done.error());
  }
  std::error_code code;
  report.file_bytes = std::filesystem::file_size(temporary.path(), code);
  if (auto renamed = temporary.rename_to(options.output); !renamed) return tl::unexpected(renamed.error());
  report.seconds = seconds_since(start);
  progress.update(1, "done");
  progress.finish();
  return report;
}

}  // namespace tind
