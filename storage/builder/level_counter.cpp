// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/level_counter.hpp"

#include <fmt/format.h>

namespace tind {
namespace {

LevelInfo info_of(const PyramidInput& input, const RefinementSpec& spec, int level) {
  const LevelSpec& of_table = input.table.levels[static_cast<std::size_t>(level)];
  LevelInfo info;
  info.level = level;
  info.tolerance_m = of_table.tolerance_m;
  info.spacing_m = of_table.spacing_m;
  info.height_step_m = spec.height_step_m[static_cast<std::size_t>(level)];
  return info;
}

}  // namespace

LevelCounter::LevelCounter(const PyramidInput& input, const RefinementSpec& spec, int level)
    : tally_(info_of(input, spec, level), input.field.lattice.ellipsoid.semi_major_m) {}

void LevelCounter::add_border_piece(const PieceKey& key, const BorderFigures& figures, std::size_t n_bytes) {
  parts_.outside += figures.n_outside;
  if (key.kind == PieceKind::kCorner) {
    ++parts_.corners;
    tally_.add_corner(n_bytes);
    return;
  }
  parts_.border += figures.n_inner;
  tally_.add_edge(figures.n_inner, n_bytes);
}

void LevelCounter::add_tile(const TileKey& key, const TileFigures& figures, std::size_t n_bytes) {
  const TileInputs& made_of = figures.made_of;
  tally_.add_body(key, figures.stats, figures.n_interior, figures.n_triangles, n_bytes);
  parts_.inserted += made_of.n_inserted;
  parts_.outside += made_of.n_outside;
  parts_.of_lines += made_of.n_of_lines;
  parts_.inherited += figures.n_interior - made_of.n_inserted - made_of.n_of_lines;
  parts_.line_pieces += made_of.n_line_pieces;
  parts_.left_out += made_of.n_left_out;
  parts_.built += figures.built ? 1 : 0;
  parts_.repeated += figures.repeated ? 1 : 0;
  parts_.copied += figures.copied ? 1 : 0;
}

void note_errors(const LevelInfo& level, Progress& progress) {
  if (level.max_error_m <= level.tolerance_m) return;
  progress.note(
      fmt::format("level {}: the error at a post is {:.3f} m, above E_L = {:.3f} m: the tolerance is finer than the "
                  "posts' heights allow; the file says so, too",
                  level.level, level.max_error_m, level.tolerance_m));
}

}  // namespace tind
