// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>

#include "core/format/bytes.hpp"
#include "core/result.hpp"

namespace tind {

/// What a body was made of, and how (docs/format.md 5): the record of PieceKind::kInputs.
struct TileInputs {
  using Digest = std::array<std::uint8_t, 16>;
  /// Of everything that shapes the body: posts, borders with envelopes, the parent's vertices, break lines, tolerances.
  /// Equal digests: equal bodies.
  Digest digest{};
  std::uint64_t n_inserted = 0;     ///< Interior vertices that greedy insertion added.
  std::uint64_t n_of_lines = 0;     ///< Interior vertices that only break lines brought in.
  std::uint64_t n_outside = 0;      ///< Interior vertices beyond the data.
  std::uint64_t n_line_pieces = 0;  ///< Pieces of break lines that the tile held to.
  std::uint64_t n_left_out = 0;     ///< Of those, pieces that crossed another.
  friend bool operator==(const TileInputs&, const TileInputs&) = default;
};

/// The record as it is stored (never compressed). decode_inputs is safe for untrusted bytes; kCorrupt.
Bytes encode_inputs(const TileInputs& inputs);
Result<TileInputs> decode_inputs(ByteView record);

}  // namespace tind
