// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/tile_maker.hpp"

#include <algorithm>
#include <utility>

#include "core/tessellation.hpp"
#include "storage/builder/tile_posts.hpp"
#include "storage/piece_blob.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

// Sources that disagree by more than this part of E_bottom are not paid for with vertices, only reported.
constexpr double kDisagreementShare = 1.0 / 8;
// Margins never take more than this part of a tolerance.
constexpr double kMostMargin = 1.0 / 2;

}  // namespace

RefinementSpec refinement_spec(const PyramidInput& input, const TilePlan& plan) {
  const HeightField& field = input.field;
  const double bottom_m = input.table.levels.back().tolerance_m;
  // What rounding may add outside the greedy loop: a post's height is kept as a float, a vertex's in height units.
  const double unit = field.lattice.height_unit_m();
  const double disagreement = field.disagreement_m <= bottom_m * kDisagreementShare ? field.disagreement_m : 0;
  const double margin = unit / 2 + disagreement;
  RefinementSpec spec;
  spec.height_step_m = height_steps(field, plan, field.pinned.empty() ? 0 : bottom_m / 2, input.threads);
  for (int level = 0; level <= input.table.bottom_level(); ++level) {
    const double tolerance = input.table.levels[static_cast<std::size_t>(level)].tolerance_m;
    spec.tolerance_m.push_back(tolerance - std::min(margin, tolerance * kMostMargin));
    spec.seed_segments.push_back(seed_segments(level, tolerance, field.lattice.ellipsoid.semi_major_m));
  }
  return spec;
}

int TileMaker::n_cell_levels(int level) const {
  constexpr int kLeast = 2;
  const int below = bottom_level_ - level;
  return below < kLeast || !can_be_repeated(field_) ? 0 : std::min(kMostCellLevels, below);
}

std::vector<LineVertex> TileMaker::refine(const RootEdge& root, std::span<const LocalVertex> parent_interior) const {
  std::vector<std::int64_t> pins;
  if (root.level > 0) pins = pins_of(root, parent_interior);
  const bool vertical = root.vertical;
  const std::int64_t at = root.at;
  const auto crossings =
      input_.lines.crossings(vertical, at, root.start, root.start + field_.lattice.tile_side(root.level));
  return refine_root_edge(field_, spec_, root, pins, crossings, [&](int edge_level, std::int64_t start) {
    const std::int64_t side = field_.lattice.tile_side(edge_level);
    return plan_.is_edge_split(edge_level, vertical, at / side, start / side);
  });
}

// Where the parent tile has vertices on the stretch (DESIGN: at l0 also pin the parent's vertices that lie on l).
std::vector<std::int64_t> TileMaker::pins_of(const RootEdge& root, std::span<const LocalVertex> interior) const {
  std::vector<std::int64_t> pins;
  const TileKey parent = parent_of(field_.lattice, root);
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

TileTask TileMaker::make_task(const TileKey& key, std::span<const LocalVertex> inherited) const {
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
void TileMaker::add_runs(const TileKey& key, TileBody& body) const {
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

Result<MadeTile> TileMaker::take_over(const StoredTile& stored) {
  auto figures = figures_of(stored);
  if (!figures) return tl::unexpected(figures.error());
  return MadeTile{
      {stored.body.begin(), stored.body.end()}, {stored.inputs.begin(), stored.inputs.end()}, std::move(*figures)};
}

Result<TileFigures> TileMaker::figures_of(const StoredTile& stored) {
  auto inputs = decode_inputs_head(stored.inputs);
  if (!inputs) return tl::unexpected(inputs.error());
  BodySummary body;
  if (inputs->body) {
    body = *inputs->body;
  } else if (const auto summary = decode_body_summary(stored.body); summary) {
    body = *summary;
  } else {
    return tl::unexpected(summary.error());
  }
  return TileFigures{std::move(*inputs), body.stats, body.n_interior, body.n_triangles};
}

// Threads that share a tile: all, where it has so much of the grid that the others would wait for it.
int TileMaker::threads_of(const TileKey& key) const {
  const double side = static_cast<double>(field_.lattice.tile_side(key.level));
  const double posts = std::min(side / field_.dx + 1, static_cast<double>(field_.n_cols)) *
                       std::min(side / field_.dy + 1, static_cast<double>(field_.n_rows));
  const double all = static_cast<double>(field_.n_cols) * static_cast<double>(field_.n_rows);
  return posts * 2 * input_.threads > all ? input_.threads : 1;
}

// The tile out of few posts, where the earlier one was made in the same frame.
std::optional<TileSurface> TileMaker::repeat(const TileTask& task, const StoredTile& earlier) const {
  if (!input_.is_grid_as_it_was || task.n_cell_levels == 0 || earlier.changed.empty()) return {};
  const auto inputs = decode_inputs(earlier.inputs);
  if (!inputs || inputs->n_cell_levels != task.n_cell_levels) return {};
  const auto record = unpack_value(earlier.body);
  if (!record) return {};
  const auto body = decode_body(*record);
  if (!body) return {};
  const EarlierTile tile{body->interior, body->triangles, inputs->cells, earlier.changed,
                         [&](const VertexPosts& now) { return vertex_posts_digest(now) == inputs->vertex_posts; }};
  return repeat_triangulation(field_, task, tile, threads_of(task.key));
}

Result<MadeTile> TileMaker::make(const TileKey& key, std::span<const LocalVertex> inherited,
                                 const std::optional<StoredTile>& earlier) const {
  const TileTask task = make_task(key, inherited);
  std::array<std::span<const LineVertex>, 4> borders;
  for (int b = 0; b < 4; ++b) borders[static_cast<std::size_t>(b)] = borders_.border(key, b);
  MadeTile result;
  TileInputs& made_of = result.figures.made_of;
  made_of.frame = frame_digest(field_, task, borders, bottom_level_ - key.level);
  made_of.posts = posts_.of(key);
  std::optional<TileSurface> repeated;
  if (earlier) {
    const auto head = decode_inputs_head(earlier->inputs);
    if (head && head->frame == made_of.frame) {
      if (head->posts == made_of.posts) return take_over(*earlier);
      repeated = repeat(task, *earlier);
    }
  }
  result.figures.repeated = repeated.has_value();
  TileSurface surface = repeated ? std::move(*repeated) : triangulate(field_, task, threads_of(key));
  TileBody body;
  body.stats = surface.stats;
  body.stats.coverage = coverage_of(field_, key);
  for (std::size_t b = 0; b < 4; ++b) body.n_side[b] = static_cast<std::uint32_t>(task.borders[b].size() - 1);
  body.interior = std::move(surface.interior);
  body.triangles = std::move(surface.triangles);
  body.n_gaps = static_cast<std::uint8_t>(bottom_level_ - key.level);
  body.virtual_triangles = find_virtual_triangles(body.triangles, body.n_side);
  add_runs(key, body);
  result.figures.stats = body.stats;
  result.figures.n_interior = body.interior.size();
  result.figures.n_triangles = body.triangles.size();
  result.figures.built = true;
  if (body.stats.coverage != TileCoverage::kReal) {
    const std::int64_t side = field_.lattice.tile_side(key.level);
    for (const LocalVertex& v : body.interior) {
      made_of.n_outside += is_outside(field_, side * key.x + v.x, side * key.y + v.y);
    }
  }
  made_of.body = BodySummary{body.stats, body.interior.size(), body.triangles.size()};
  made_of.n_inserted = surface.n_inserted;
  made_of.n_of_lines = surface.n_of_lines;
  made_of.n_line_pieces = task.constraints.size();
  made_of.n_left_out = surface.n_left_out;
  if (task.n_cell_levels > 0) {
    made_of.n_cell_levels = static_cast<std::uint8_t>(task.n_cell_levels);
    made_of.vertex_posts = vertex_posts_digest(surface.vertex_posts);
    made_of.cells = std::move(surface.cells);
  }
  result.value = pack_body(body);
  result.inputs = encode_inputs(made_of);
  return result;
}

BorderFigures TileMaker::figures_of_corner(const PieceKey& key) const {
  const std::int64_t side = field_.lattice.tile_side(key.level);
  return {0, is_outside(field_, side * key.i, side * key.j) ? 1u : 0u};
}

BorderFigures TileMaker::figures_of_edge(const PieceKey& key, const EdgeChain& edge) const {
  const std::int64_t side = field_.lattice.tile_side(key.level);
  const bool vertical = key.kind == PieceKind::kEdgeV;
  BorderFigures figures{edge.inner.size(), 0};
  for (const EdgeVertex& v : edge.inner) {
    figures.n_outside += is_outside(field_, side * key.i + (vertical ? 0 : v.t), side * key.j + (vertical ? v.t : 0));
  }
  return figures;
}

TileMaker::BorderPiece TileMaker::make_border_piece(const PieceKey& key) const {
  const std::int64_t side = field_.lattice.tile_side(key.level);
  if (key.kind == PieceKind::kCorner) {
    return {pack_value(encode_corner({field_.lattice_height(side * key.i, side * key.j)})), figures_of_corner(key)};
  }
  const auto part = key.kind == PieceKind::kEdgeV ? borders_.side(true, key.level, key.i, key.j)
                                                  : borders_.side(false, key.level, key.j, key.i);
  const EdgeChain edge = edge_of_level(part, key.level);
  return {pack_value(encode_edge(edge)), figures_of_edge(key, edge)};
}

Result<BorderFigures> TileMaker::figures_of(const PieceKey& key, ByteView value) const {
  if (key.kind == PieceKind::kCorner) return figures_of_corner(key);
  const auto record = unpack_value(value);
  if (!record) return tl::unexpected(record.error());
  const auto edge = decode_edge(*record);
  if (!edge) return tl::unexpected(edge.error());
  return figures_of_edge(key, *edge);
}

}  // namespace tind
