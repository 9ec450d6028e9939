// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/drainage/flow.hpp"

namespace tind {

/// A stream network on a grid of posts, for comparison.
struct StreamPost {
  std::int64_t row = 0, col = 0;
  double length = 0;  ///< Of the piece of stream that the post stands for, in cells (1, or sqrt 2 along a diagonal).
};

/// How well an extracted network matches a reference (Heipke, Mayer, Wiedemann, Jamet 1997: evaluation of automatic
/// road extraction). Lengths in cells.
struct StreamMatch {
  double reference_length = 0;   ///< Scored.
  double extracted_length = 0;   ///< Scored.
  double reference_matched = 0;  ///< Of the reference, within the buffer of the extraction.
  double extracted_matched = 0;  ///< Of the extraction, within the buffer of the reference.
  double mean_distance = 0;      ///< Of the matched extraction from the nearest reference post, in cells.

  /// Share of the reference that was found; 1 where there is no reference.
  double completeness() const { return reference_length > 0 ? reference_matched / reference_length : 1; }
  /// Share of the extraction that is right; 1 where nothing was extracted.
  double correctness() const { return extracted_length > 0 ? extracted_matched / extracted_length : 1; }
  /// Matched extraction over extraction plus what it missed of the reference; 1 where there is neither.
  double quality() const {
    const double all = extracted_length + reference_length - reference_matched;
    return all > 0 ? extracted_matched / all : 1;
  }
};

/// The posts of `mask` (n_rows * n_cols) with the length of their step along `directions`; the last post before the
/// water leaves or the mask ends has none.
std::vector<StreamPost> stream_posts(std::int64_t n_rows, std::int64_t n_cols, const std::uint8_t* mask,
                                     const std::uint8_t* directions);
/// The posts of `flow` through which at least `min_cells` drain.
std::vector<StreamPost> stream_posts(const Flow& flow, double min_cells);

/// Matches both ways: a post matches when a post of the other network lies within `buffer_cells` (Euclidean, in cells).
/// `excluded` (n_rows * n_cols, or empty): posts not scored on either side; they still serve to match others.
/// Both networks lie on the same n_rows x n_cols grid.
StreamMatch compare_streams(std::int64_t n_rows, std::int64_t n_cols, std::span<const StreamPost> extracted,
                            std::span<const StreamPost> reference, double buffer_cells,
                            std::span<const std::uint8_t> excluded = {});

}  // namespace tind
