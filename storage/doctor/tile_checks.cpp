// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/doctor/tile_checks.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "core/assembler.hpp"
#include "core/format/quantized_mesh.hpp"
#include "storage/doctor/body_checks.hpp"
#include "storage/doctor/line_checks.hpp"
#include "storage/doctor/terrain_check.hpp"
#include "storage/doctor/value_check.hpp"
#include "storage/inputs_blob.hpp"
#include "storage/piece_blob.hpp"

namespace tind {
namespace {

constexpr std::size_t kBody = 8;

class TileCheck {
 public:
  TileCheck(const PieceSource& pieces, const TileKey& tile) : pieces_(pieces), tile_(tile), keys_(pieces_of(tile)) {}

  TileFindings run() {
    check_family();
    check_lines();
    auto parts = read_pieces();
    if (!parts) return std::move(out_);
    const TileBody& body = parts->body;
    const LevelInfo& level = pieces_.manifest.levels[tile_.level];
    if (body.n_gaps != pieces_.manifest.bottom_level - tile_.level) {
      fault(fmt::format("n_gaps: {}, but {} finer levels are below", body.n_gaps,
                        pieces_.manifest.bottom_level - tile_.level));
    }
    const auto node = assemble(pieces_.lattice(), tile_, std::move(*parts));
    if (!node) {
      // The message names the tile; a fault does, too.
      const std::string prefix = name_of(tile_) + ": ", &text = node.error().message;
      fault(text.starts_with(prefix) ? text.substr(prefix.size()) : text);
      return std::move(out_);
    }
    const std::size_t n_before = out_.faults.size();
    add(find_stats_fault(*node, level.tolerance_m));
    add(find_interior_fault(*node));
    add(find_triangle_fault(*node, pieces_.lattice().tile_side(tile_.level)));
    if (out_.faults.size() > n_before) return std::move(out_);  // the rest builds on right triangles
    add(find_virtual_triangle_fault(*node, ring_lines(), pieces_.is_shard()));
    check_terrain(*node, level.height_step_m);
    return std::move(out_);
  }

 private:
  void fault(std::string what) { out_.faults.push_back({name_of(tile_), std::move(what)}); }
  void add(std::string what) {
    if (!what.empty()) fault(std::move(what));
  }

  // All four children of a tile are stored, or none (docs/format.md 9); a shard's cut goes between siblings.
  void check_family() {
    if (tile_.level == 0) return;
    if (!pieces_.tiles.has(tile_.parent())) fault("its parent is not stored");
    if (pieces_.is_shard() && tile_.level <= pieces_.manifest.shard_cut_level) return;
    for (int c = 0; c < 4; ++c) {
      const TileKey sibling = tile_.parent().child(c);
      if (!pieces_.tiles.has(sibling)) fault(fmt::format("its sibling, {}, is not stored", name_of(sibling)));
    }
  }

  // Each edge is checked once: south and west sides here, the others where no tile is beyond them.
  void check_lines() {
    const std::uint32_t n_x = TileKey::count_x(tile_.level);
    const bool has_east = pieces_.tiles.has({tile_.level, (tile_.x + 1) % n_x, tile_.y});
    const bool has_north =
        tile_.y + 1 < TileKey::count_y(tile_.level) && pieces_.tiles.has({tile_.level, tile_.x, tile_.y + 1});
    for (const std::size_t k : {1u, 3u, 5u, 7u}) {
      if ((k == 3 && has_east) || (k == 5 && has_north)) continue;
      for (Fault& found : check_edge(pieces_, keys_[k])) out_.faults.push_back(std::move(found));
    }
  }

  // The nine pieces; nullopt: one is missing, or does not decode. Of broken pieces only the body is named here: others
  // are shared, and were named when the file was read through.
  std::optional<TilePieces> read_pieces() {
    TilePieces parts;
    bool is_whole = true;
    for (std::size_t k = 0; k < kBody; ++k) {
      if (!pieces_.has(keys_[k])) {
        fault(fmt::format("{} is missing", name_of(keys_[k])));
        is_whole = false;
      } else if (k % 2 == 0) {
        const auto corner = pieces_.corner(keys_[k]);
        is_whole &= corner.has_value();
        if (corner) parts.corners[k / 2] = *corner;
      } else {
        auto edge = pieces_.edge(keys_[k]);
        is_whole &= edge.has_value();
        if (edge) parts.edges[k / 2] = std::move(*edge);
      }
    }
    const auto value = pieces_.snapshot.find(keys_[kBody]);
    if (!value) {
      fault("its body is missing");
      return std::nullopt;
    }
    const auto record = unpack_strictly(*value);
    auto body = record ? decode_body(*record) : tl::unexpected(record.error());
    if (!body) {
      fault("body: " + body.error().message);
      return std::nullopt;
    }
    check_inputs(*body);
    out_.counts = {body->stats, body->interior.size(), body->triangles.size(), value->size()};
    parts.body = std::move(*body);
    return is_whole ? std::optional(std::move(parts)) : std::nullopt;
  }

  void check_inputs(const TileBody& body) {
    const auto value = pieces_.snapshot.find({PieceKind::kInputs, tile_.level, tile_.x, tile_.y});
    if (!value) {
      if (pieces_.has_inputs) fault("its inputs record is missing, others have one");
      return;
    }
    const auto inputs = decode_inputs(*value);
    if (!inputs) return;  // was named when the file was read through
    const std::uint64_t n = body.interior.size();
    if (inputs->n_inserted > n || inputs->n_of_lines > n || inputs->n_outside > n ||
        inputs->n_inserted + inputs->n_of_lines > n || inputs->n_left_out > inputs->n_line_pieces) {
      fault(fmt::format(
          "inputs: inserted {}, of_lines {}, outside {}, line_pieces {}, left_out {} with {} interior "
          "vertices",
          inputs->n_inserted, inputs->n_of_lines, inputs->n_outside, inputs->n_line_pieces, inputs->n_left_out, n));
    }
    if (const BodySummary own{body.stats, n, body.triangles.size()}; inputs->body && *inputs->body != own) {
      const BodySummary& said = *inputs->body;
      fault(
          fmt::format("inputs: the body's summary: {} posts, maximum error {} m, rmse {} m, {} interior vertices, {} "
                      "triangles; it has {}, {} m, {} m, {}, {}, or its coverage or heights differ",
                      said.stats.n_posts, said.stats.max_error_m, said.stats.rmse_m, said.n_interior, said.n_triangles,
                      own.stats.n_posts, own.stats.max_error_m, own.stats.rmse_m, own.n_interior, own.n_triangles));
    }
    if (!inputs->cells.empty()) check_cells(*inputs, body.stats);
  }

  // The body's errors are those of its cells: irregular posts are in none, but then there are no cells.
  void check_cells(const TileInputs& inputs, const TileStats& stats) {
    CellErrors all;
    for (const CellErrors& cell : inputs.cells) {
      all.n_posts += cell.n_posts;
      all.sum_m2 += cell.sum_m2;
      all.largest_m = std::max(all.largest_m, cell.largest_m);
    }
    const float largest_m = all.largest_m == 0 ? 0 : std::nextafter(all.largest_m, std::numeric_limits<float>::max());
    const double rmse_m = std::sqrt(all.sum_m2 / static_cast<double>(std::max<std::uint64_t>(all.n_posts, 1)));
    if (all.n_posts != stats.n_posts || largest_m != stats.max_error_m ||
        !(std::abs(rmse_m - static_cast<double>(stats.rmse_m)) <= 1e-6 * rmse_m)) {
      fault(fmt::format("inputs: cells: {} posts, maximum error {} m, rmse {} m; its body has {}, {} m, {} m",
                        all.n_posts, largest_m, rmse_m, stats.n_posts, stats.max_error_m, stats.rmse_m));
    }
    if (tile_.level + inputs.n_cell_levels > pieces_.manifest.bottom_level) {
      fault(fmt::format("inputs: cells: {} levels down, below the bottom level", inputs.n_cell_levels));
    }
  }

  std::array<std::optional<std::vector<LinePoint>>, 4> ring_lines() const {
    std::array<std::optional<std::vector<LinePoint>>, 4> lines;
    const std::int64_t side = pieces_.lattice().tile_side(tile_.level);
    for (std::size_t b = 0; b < 4; ++b) {
      lines[b] = finest_line(pieces_, keys_[2 * b + 1]);
      if (b < 2 || !lines[b]) continue;
      std::reverse(lines[b]->begin(), lines[b]->end());
      for (LinePoint& point : *lines[b]) point.t = side - point.t;
    }
    return lines;
  }

  void check_terrain(const VirtualNode& node, double border_step_m) {
    QuantizedMeshOptions options;
    options.border_step_m = border_step_m;
    const auto terrain = encode_quantized_mesh(pieces_.lattice(), node, options);
    const std::string what = terrain ? find_terrain_fault(*terrain, node.triangles.size()) : terrain.error().message;
    if (!what.empty()) fault("as a terrain tile: " + what);
  }

  const PieceSource& pieces_;
  TileKey tile_;
  std::array<PieceKey, 9> keys_;
  TileFindings out_;
};

}  // namespace

TileFindings check_tile(const PieceSource& pieces, const TileKey& tile) { return TileCheck(pieces, tile).run(); }

}  // namespace tind
