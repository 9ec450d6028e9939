// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/pyramid_builder.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <utility>

#include "core/border_line.hpp"
#include "core/tessellation.hpp"
#include "core/triangulator.hpp"
#include "storage/builder/border_lines.hpp"
#include "storage/builder/duration.hpp"
#include "storage/builder/level_times.hpp"
#include "storage/builder/ordered_pipeline.hpp"
#include "storage/builder/plan.hpp"
#include "storage/builder/shard.hpp"
#include "storage/builder/tile_digest.hpp"
#include "storage/builder/tile_posts.hpp"
#include "storage/inputs_blob.hpp"
#include "storage/level_tally.hpp"
#include "storage/piece_blob.hpp"
#include "storage/readers/resident_maps.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

// Sources that disagree by more than this part of E_bottom are not paid for with vertices, only reported.
constexpr double kDisagreementShare = 1.0 / 8;
// Margins never take more than this part of a tolerance.
constexpr double kMostMargin = 1.0 / 2;

// A built or taken-over tile, ready to be written.
struct TileResult {
  Bytes value;   // the stored body
  Bytes inputs;  // the stored TileInputs
  TileInputs made_of;
  TileStats stats;
  std::uint64_t n_interior = 0, n_triangles = 0;
  bool built = false, repeated = false;
};

// What is there of a tile already: views into a store.
struct StoredTile {
  ByteView body, inputs;
  /// Of the earlier pyramid, where the tile's posts have changed: the descendants that have all of those.
  std::vector<TileKey> changed;
};

// The interior vertices of a stored body, decoded by whoever needs them first.
class ParentBody {
 public:
  explicit ParentBody(Bytes value) : value_(std::move(value)) {}
  const Result<std::vector<LocalVertex>>& interior() const {
    std::call_once(once_, [this] {
      interior_ = decode_interior(value_);
      value_ = {};
    });
    return interior_;
  }

 private:
  mutable Bytes value_;
  mutable std::once_flag once_;
  mutable Result<std::vector<LocalVertex>> interior_;
};
using ParentPointer = std::shared_ptr<const ParentBody>;

class PyramidBuilder {
 public:
  PyramidBuilder(const PyramidInput& input, TileStoreWriter& writer, Progress& progress)
      : input_(input),
        field_(input.field),
        table_(input.table),
        writer_(writer),
        progress_(progress),
        plan_(field_, table_.bottom_level()),
        shard_(plan_, input.shard_index, input.shard_count),
        borders_(field_.lattice),
        posts_(field_, table_.bottom_level(), input.threads, input.cancel),
        times_(table_.bottom_level() + 1) {
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
    outcome_.shard_cut_level = shard_.cut_level();
  }

  Result<PyramidOutcome> run() {
    for (int level = 0; level <= table_.bottom_level(); ++level) {
      const auto start = std::chrono::steady_clock::now();
      LevelBreakdown parts;
      if (auto done = refine_lines(level); !done) return tl::unexpected(done.error());
      auto info = build_level(level, start, parts);
      if (!info) return tl::unexpected(info.error());
      parts.seconds = seconds_since(start);
      times_.finish_level(parts.seconds);
      if (info->max_error_m > info->tolerance_m) {
        progress_.note(
            fmt::format("level {}: the error at a post is {:.3f} m, above E_L = {:.3f} m: the tolerance is finer than "
                        "the posts' heights allow; the file says so, too",
                        level, info->max_error_m, info->tolerance_m));
      }
      outcome_.levels.push_back(std::move(*info));
      outcome_.breakdown.push_back(parts);
    }
    return std::move(outcome_);
  }

 private:
  bool cancelled() const { return input_.cancel && input_.cancel->load(std::memory_order_relaxed); }

  // What was made of posts that could not be read must not be stored.
  Result<void> lost_posts() const {
    const bool lost =
        (field_.pages != nullptr && field_.pages->failed()) || (field_.blocks != nullptr && field_.blocks->failed());
    if (!lost) return {};
    return fail(ErrorKind::kIo, "the scratch file of the posts cannot be read");
  }

  static Error interrupted() { return {ErrorKind::kInterrupted, "interrupted"}; }

  // The stored body of a tile of the level above. Copied, because the writer's views do not outlive the next append;
  // neighbours in the list have the same parent, which is copied and decoded once. One thread.
  ParentPointer parent_body(const TileKey& parent) {
    if (!last_parent_ || last_parent_key_ != parent) {
      const auto value = writer_.find({PieceKind::kBody, parent.level, parent.x, parent.y});
      last_parent_ = std::make_shared<const ParentBody>(value ? Bytes(value->begin(), value->end()) : Bytes());
      last_parent_key_ = parent;
    }
    return last_parent_;
  }

  Result<void> refine_lines(int level) {
    std::vector<RootEdge> roots = plan_.root_edges(level, field_.lattice);
    if (level > shard_.cut_level()) {
      // Such a line runs inside a tile of the cut level: it is seen by that tile's shard alone.
      std::erase_if(roots, [this](const RootEdge& root) { return !shard_.has(parent_of(root)); });
    }
    // All bodies of the level above are read here, and nothing is appended that would give their pages back.
    const ByteView stored = writer_.map();
    const ResidentMap resident(const_cast<std::uint8_t*>(stored.data()), stored.size());
    struct In {
      RootEdge root;
      ParentPointer parent;
    };
    const auto prepare = [&](std::size_t i) {
      return In{roots[i], level > 0 ? parent_body(parent_of(roots[i])) : nullptr};
    };
    using Line = Result<std::vector<LineVertex>>;
    const auto work = [&](In&& in) -> Line {
      std::vector<std::int64_t> pins;
      if (in.parent) {
        const auto& interior = in.parent->interior();
        if (!interior) return tl::unexpected(interior.error());
        pins = pins_of(in.root, *interior);
      }
      const bool vertical = in.root.vertical;
      const std::int64_t at = in.root.at;
      const auto crossings =
          input_.lines.crossings(vertical, at, in.root.start, in.root.start + field_.lattice.tile_side(in.root.level));
      return refine_root_edge(field_, spec_, in.root, pins, crossings, [&](int edge_level, std::int64_t start) {
        const std::int64_t side = field_.lattice.tile_side(edge_level);
        return plan_.is_edge_split(edge_level, vertical, at / side, start / side);
      });
    };
    std::optional<Error> error;
    const auto consume = [&](std::size_t i, Line&& line) {
      if (!line) {
        error = line.error();
        return false;
      }
      if (const auto lost = lost_posts(); !lost) {
        error = lost.error();
        return false;
      }
      borders_.add(roots[i], std::move(*line));
      return !cancelled();
    };
    if (!run_ordered<In, Line>(roots.size(), input_.threads, prepare, work, consume)) {
      return tl::unexpected(error.value_or(interrupted()));
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
  std::vector<std::int64_t> pins_of(const RootEdge& root, const std::vector<LocalVertex>& interior) const {
    std::vector<std::int64_t> pins;
    const TileKey parent = parent_of(root);
    const std::int64_t side = field_.lattice.tile_side(parent.level), west = side * parent.x, south = side * parent.y;
    const std::int64_t end = root.start + side / 2;
    for (const LocalVertex& v : interior) {
      const std::int64_t x = west + v.x, y = south + v.y;
      const std::int64_t across = root.vertical ? x : y, along = root.vertical ? y : x;
      if (across == root.at && along > root.start && along < end) pins.push_back(along);
    }
    std::sort(pins.begin(), pins.end());
    return pins;
  }

  // Where a tile's mesh can be told to be the earlier one; of few levels more it is built as fast.
  int n_cell_levels(int level) const {
    constexpr int kLeast = 2;
    const int below = table_.bottom_level() - level;
    return below < kLeast || !can_be_repeated(field_) ? 0 : std::min(kMostCellLevels, below);
  }

  TileTask make_task(const TileKey& key, const std::vector<LocalVertex>& inherited) const {
    const std::int64_t side = field_.lattice.tile_side(key.level);
    const std::int64_t west = side * key.x, south = side * key.y;
    TileTask task;
    task.key = key;
    task.tolerance_m = spec_.tolerance_m[key.level];
    task.height_step_m = spec_.height_step_m[key.level];
    task.n_cell_levels = n_cell_levels(key.level);
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

  // A tile from what is stored of it, whose body was checked elsewhere.
  static Result<TileResult> take_over(const StoredTile& stored) {
    TileResult result;
    auto inputs = decode_inputs(stored.inputs);
    if (!inputs) return tl::unexpected(inputs.error());
    const auto summary = decode_body_summary(stored.body);
    if (!summary) return tl::unexpected(summary.error());
    result.made_of = *inputs;
    result.stats = summary->stats;
    result.n_interior = summary->n_interior;
    result.n_triangles = summary->n_triangles;
    result.value.assign(stored.body.begin(), stored.body.end());
    result.inputs.assign(stored.inputs.begin(), stored.inputs.end());
    return result;
  }

  // Threads that share a tile: all, where it has so much of the grid that the others would wait for it.
  int threads_of(const TileKey& key) const {
    const double side = static_cast<double>(field_.lattice.tile_side(key.level));
    const double posts = std::min(side / field_.dx + 1, static_cast<double>(field_.n_cols)) *
                         std::min(side / field_.dy + 1, static_cast<double>(field_.n_rows));
    const double all = static_cast<double>(field_.n_cols) * static_cast<double>(field_.n_rows);
    return posts * 2 * input_.threads > all ? input_.threads : 1;
  }

  // The tile out of few posts, where the earlier one was made in the same frame.
  std::optional<TileSurface> repeat(const TileTask& task, const TileInputs& inputs, const StoredTile& earlier) const {
    if (task.n_cell_levels == 0 || inputs.n_cell_levels != task.n_cell_levels || earlier.changed.empty()) return {};
    const auto record = unpack_value(earlier.body);
    if (!record) return {};
    const auto body = decode_body(*record);
    if (!body) return {};
    const EarlierTile tile{body->interior, body->triangles, inputs.cells, earlier.changed, [&](const VertexPosts& now) {
                             return vertex_posts_digest(field_, now) == inputs.vertex_posts;
                           }};
    return repeat_triangulation(field_, task, tile, threads_of(task.key));
  }

  // `earlier`: of the same tile in the earlier pyramid, if there is one.
  Result<TileResult> build_tile(const TileKey& key, const ParentBody* parent,
                                const std::optional<StoredTile>& earlier) const {
    static const std::vector<LocalVertex> kNone;
    if (parent && !parent->interior()) return tl::unexpected(parent->interior().error());
    const TileTask task = make_task(key, parent ? *parent->interior() : kNone);
    std::array<std::span<const LineVertex>, 4> borders;
    for (int b = 0; b < 4; ++b) borders[static_cast<std::size_t>(b)] = borders_.border(key, b);
    TileResult result;
    result.made_of.frame = frame_digest(field_, task, borders, table_.bottom_level() - key.level);
    result.made_of.posts = posts_.of(key);
    std::optional<TileSurface> repeated;
    if (earlier) {
      const auto inputs = decode_inputs(earlier->inputs);
      if (inputs && inputs->frame == result.made_of.frame) {
        if (inputs->posts == result.made_of.posts) return take_over(*earlier);
        repeated = repeat(task, *inputs, *earlier);
      }
    }
    result.repeated = repeated.has_value();
    TileSurface surface = repeated ? std::move(*repeated) : triangulate(field_, task, threads_of(key));
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
    result.n_triangles = body.triangles.size();
    result.built = true;
    if (body.stats.coverage != TileCoverage::kReal) {
      const std::int64_t side = field_.lattice.tile_side(key.level);
      for (const LocalVertex& v : body.interior) {
        result.made_of.n_outside += is_outside(field_, side * key.x + v.x, side * key.y + v.y);
      }
    }
    result.made_of.n_inserted = surface.n_inserted;
    result.made_of.n_of_lines = surface.n_of_lines;
    result.made_of.n_line_pieces = task.constraints.size();
    result.made_of.n_left_out = surface.n_left_out;
    if (task.n_cell_levels > 0) {
      result.made_of.n_cell_levels = static_cast<std::uint8_t>(task.n_cell_levels);
      result.made_of.vertex_posts = vertex_posts_digest(field_, surface.vertex_posts);
      result.made_of.cells = std::move(surface.cells);
    }
    result.value = pack_body(body);
    result.inputs = encode_inputs(result.made_of);
    return result;
  }

  // Appends a piece, and notes whether the earlier pyramid has it otherwise.
  Result<void> append(const PieceKey& key, ByteView value) {
    if (input_.earlier && key.kind != PieceKind::kInputs) {
      const auto before = input_.earlier->find(key);
      if (!before || !std::equal(before->begin(), before->end(), value.begin(), value.end())) {
        outcome_.changed.push_back(key);
      }
    }
    return writer_.append(key, value);
  }

  // Corner and edge values, made where they are written: they are slices of the lines.
  Result<void> append_border_piece(const PieceKey& key, LevelTally& tally, LevelBreakdown& parts) {
    const std::int64_t side = field_.lattice.tile_side(key.level);
    if (key.kind == PieceKind::kCorner) {
      const Bytes value = pack_value(encode_corner({field_.lattice_height(side * key.i, side * key.j)}));
      ++parts.corners;
      parts.outside += is_outside(field_, side * key.i, side * key.j);
      tally.add_corner(value.size());
      return append(key, value);
    }
    const bool vertical = key.kind == PieceKind::kEdgeV;
    const auto part =
        vertical ? borders_.side(true, key.level, key.i, key.j) : borders_.side(false, key.level, key.j, key.i);
    const EdgeChain edge = edge_of_level(part, key.level);
    const Bytes value = pack_value(encode_edge(edge));
    parts.border += edge.inner.size();
    for (const EdgeVertex& v : edge.inner) {
      parts.outside += is_outside(field_, side * key.i + (vertical ? 0 : v.t), side * key.j + (vertical ? v.t : 0));
    }
    tally.add_edge(edge.inner.size(), value.size());
    return append(key, value);
  }

  Result<void> append_tile(const TileKey& key, const TileResult& tile, LevelTally& tally, LevelBreakdown& parts) {
    tally.add_body(key, tile.stats, tile.n_interior, tile.n_triangles, tile.value.size());
    parts.inserted += tile.made_of.n_inserted;
    parts.outside += tile.made_of.n_outside;
    parts.of_lines += tile.made_of.n_of_lines;
    parts.inherited += tile.n_interior - tile.made_of.n_inserted - tile.made_of.n_of_lines;
    parts.line_pieces += tile.made_of.n_line_pieces;
    parts.left_out += tile.made_of.n_left_out;
    parts.built += tile.built ? 1 : 0;
    parts.repeated += tile.repeated ? 1 : 0;
    if (auto done = append({PieceKind::kBody, key.level, key.x, key.y}, tile.value); !done) return done;
    return append({PieceKind::kInputs, key.level, key.x, key.y}, tile.inputs);
  }

  // What the interrupted run stored of a tile, copied; else what the earlier pyramid has. One thread.
  struct Known {
    Bytes body, inputs;  // of the interrupted run
    std::optional<StoredTile> earlier;
  };
  Known known_of(const TileKey& key) const {
    const PieceKey body_key{PieceKind::kBody, key.level, key.x, key.y};
    const PieceKey inputs_key{PieceKind::kInputs, key.level, key.x, key.y};
    Known known;
    const auto inputs = writer_.find_earlier(inputs_key);
    const auto body = inputs ? writer_.find_earlier(body_key) : std::nullopt;
    if (body) {
      known.body.assign(body->begin(), body->end());
      known.inputs.assign(inputs->begin(), inputs->end());
    } else if (input_.earlier) {
      const auto earlier_body = input_.earlier->find(body_key), earlier_inputs = input_.earlier->find(inputs_key);
      if (earlier_body && earlier_inputs) {
        known.earlier = StoredTile{*earlier_body, *earlier_inputs, {}};
        if (n_cell_levels(key.level) > 0) known.earlier->changed = changed_below(key, *earlier_inputs);
      }
    }
    return known;
  }

  // The finest descendants that the earlier pyramid tells to have other posts; none where they are too many. One
  // thread.
  std::vector<TileKey> changed_below(const TileKey& key, ByteView inputs) const {
    constexpr std::size_t kMost = 256;
    std::vector<TileKey> changed;
    const auto descend = [&](const TileKey& tile, std::optional<ByteView> record, const auto& self) -> void {
      if (changed.size() > kMost) return;
      const auto made_of = record ? decode_inputs(*record) : fail(ErrorKind::kNotFound, "");
      if (made_of && made_of->posts == posts_.of(tile)) return;
      if (!made_of || tile.level == table_.bottom_level()) {
        changed.push_back(tile);
        return;
      }
      for (int c = 0; c < 4; ++c) {
        const TileKey child = tile.child(c);
        self(child, input_.earlier->find({PieceKind::kInputs, child.level, child.x, child.y}), self);
      }
    };
    descend(key, inputs, descend);
    if (changed.size() > kMost) changed.clear();
    return changed;
  }

  Result<LevelInfo> build_level(int level, std::chrono::steady_clock::time_point start, LevelBreakdown& parts) {
    const std::vector<TileKey> tiles = shard_.filter(plan_.tiles(level));
    const std::vector<PieceKey> pieces = border_pieces_of(tiles);
    LevelInfo info;
    info.level = level;
    info.tolerance_m = table_.levels[static_cast<std::size_t>(level)].tolerance_m;
    info.spacing_m = table_.levels[static_cast<std::size_t>(level)].spacing_m;
    info.height_step_m = spec_.height_step_m[static_cast<std::size_t>(level)];
    LevelTally tally(info, field_.lattice.ellipsoid.semi_major_m);

    std::optional<Error> error;
    const auto failed = [&error](Result<void>&& done) {
      if (!done) error = done.error();
      return !done;
    };
    std::size_t next_piece = 0;
    struct In {
      TileKey key;
      ParentPointer parent;
      Known known;
    };
    const auto prepare = [&](std::size_t i) {
      In in{tiles[i], nullptr, known_of(tiles[i])};
      if (in.known.body.empty() && level > 0) in.parent = parent_body(tiles[i].parent());
      return in;
    };
    const auto work = [&](In&& in) -> Result<TileResult> {
      if (!in.known.body.empty()) {
        // An earlier pyramid is checked as a whole; of an interrupted run there is no hash yet.
        const auto record = unpack_value(in.known.body);
        if (!record) return tl::unexpected(record.error());
        if (const auto body = decode_body(*record); !body) return tl::unexpected(body.error());
        return take_over({in.known.body, in.known.inputs, {}});
      }
      return build_tile(in.key, in.parent.get(), in.known.earlier);
    };
    const auto consume = [&](std::size_t i, Result<TileResult>&& tile) {
      if (!tile) {
        error = tile.error();
        return false;
      }
      if (failed(lost_posts())) return false;
      const PieceKey body{PieceKind::kBody, tiles[i].level, tiles[i].x, tiles[i].y};
      for (; next_piece < pieces.size() && pieces[next_piece] < body; ++next_piece) {
        if (failed(append_border_piece(pieces[next_piece], tally, parts))) return false;
      }
      if (failed(append_tile(tiles[i], *tile, tally, parts))) return false;
      const double done = static_cast<double>(i + 1) / static_cast<double>(tiles.size());
      progress_.update_left(fmt::format("level {} of {}", level, table_.bottom_level()),
                            times_.left(done, seconds_since(start)));
      return !cancelled();
    };
    if (!run_ordered<In, Result<TileResult>>(tiles.size(), input_.threads, prepare, work, consume)) {
      return tl::unexpected(error.value_or(interrupted()));
    }
    for (; next_piece < pieces.size(); ++next_piece) {
      if (failed(append_border_piece(pieces[next_piece], tally, parts))) return tl::unexpected(*error);
    }
    return tally.finish();
  }

  // Corners and edges of tiles of one level in storage order, each once.
  static std::vector<PieceKey> border_pieces_of(const std::vector<TileKey>& tiles) {
    std::vector<PieceKey> keys;
    for (const TileKey& tile : tiles) {
      for (const PieceKey& key : pieces_of(tile)) {
        if (key.kind != PieceKind::kBody) keys.push_back(key);
      }
    }
    std::sort(keys.begin(), keys.end());
    keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
    return keys;
  }

  const PyramidInput& input_;
  const HeightField& field_;
  const LevelTable& table_;
  TileStoreWriter& writer_;
  Progress& progress_;
  const TilePlan plan_;
  const ShardTiles shard_;
  RefinementSpec spec_;
  BorderLines borders_;
  const PostDigests posts_;
  TileKey last_parent_key_;
  ParentPointer last_parent_;
  LevelTimes times_;
  PyramidOutcome outcome_;
};

}  // namespace

Result<PyramidOutcome> build_levels(const PyramidInput& input, TileStoreWriter& writer, Progress& progress) {
  return PyramidBuilder(input, writer, progress).run();
}

}  // namespace tind
