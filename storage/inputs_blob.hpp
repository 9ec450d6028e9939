// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "core/format/bytes.hpp"
#include "core/result.hpp"
#include "core/virtual_node.hpp"
#include "storage/piece_blob.hpp"

namespace tind {

/// What a body was made of, and how (docs/format.md 5): the record of PieceKind::kInputs.
struct TileInputs {
  using Digest = std::array<std::uint8_t, 16>;
  /// Of everything that shapes the body but the posts: borders with envelopes, the parent's vertices, break lines,
  /// tolerances. Equal frames and equal posts: equal bodies.
  Digest frame{};
  Digest posts{};                   ///< Of the posts; all zero: none is near.
  std::uint64_t n_inserted = 0;     ///< Interior vertices that greedy insertion added.
  std::uint64_t n_of_lines = 0;     ///< Interior vertices that only break lines brought in.
  std::uint64_t n_outside = 0;      ///< Interior vertices beyond the data.
  std::uint64_t n_line_pieces = 0;  ///< Pieces of break lines that the tile held to.
  std::uint64_t n_left_out = 0;     ///< Of those, pieces that crossed another.
  /// What the body has, so that it need not be unpacked to be counted; builders before 0.6.0 left it out.
  std::optional<BodySummary> body;
  /// What tells that other posts make the same mesh (docs/decisions/0013): the errors of 2^n x 2^n cells, and a digest
  /// of VertexPosts and of the grid. n = 0: nothing of it is known, and `cells` is empty.
  std::uint8_t n_cell_levels = 0;
  std::uint64_t vertex_posts = 0;
  std::vector<CellErrors> cells;
  friend bool operator==(const TileInputs&, const TileInputs&) = default;
};

/// The record as it is stored (never compressed). decode_inputs is safe for untrusted bytes; kCorrupt. Records of
/// builders before 0.5.0 have no digests that are of use: they come out all zero.
Bytes encode_inputs(const TileInputs& inputs);
Result<TileInputs> decode_inputs(ByteView record);
/// The same without cells and vertex_posts, which are not looked at: there may be many. What decode_inputs takes this
/// does, too; the check tells of damage anywhere.
Result<TileInputs> decode_inputs_head(ByteView record);

}  // namespace tind
