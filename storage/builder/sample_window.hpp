// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/height_field.hpp"
#include "core/post_blocks.hpp"
#include "core/result.hpp"
#include "core/tile_key.hpp"
#include "storage/readers/gdal_raster.hpp"

namespace tind {

/// What was met in the posts looked at.
struct PostSigns {
  std::uint64_t posts = 0;  ///< Of the mosaic's grid.
  std::uint64_t voids = 0;  ///< Of those, without a height.
  std::uint64_t implausible = 0;
  std::uint64_t overlapping = 0, disagreeing = 0;
  double largest_disagreement_m = 0;  ///< Between two sources.
  std::uint64_t zeros = 0, zeros_beside_voids = 0;
  bool whole_metres = true;  ///< Every height is a whole number of metres.
  double lowest_m = 0, highest_m = 0;
  double lowest_other_m = 0;  ///< Of the heights that are not 0.
  std::uint64_t heights = 0;  ///< posts - voids

  void add(const PostSigns& other);
};

/// Rows and columns of a mosaic's grid; columns may run past either end.
struct PostRange {
  std::int64_t row = 0, col = 0, n_rows = 0, n_cols = 0;
};

/// The posts of a range as the mosaic gives them.
struct PostSample {
  std::vector<float> heights_m;  ///< n_rows * n_cols, row-major, southernmost row first; NaN: void or outside.
  PostSigns signs;               ///< Of the posts inside the mosaic's grid.
  double roughness_m = 0;        ///< Mean |second difference| of neighbouring heights.
  double read_seconds = 0;       ///< Processor time of the calling thread in the readers.
};

/// Reads a range, sources that overlap averaged. Columns wrap where the mosaic does. kIo, kInvalidInput as
/// RasterMosaic::read_window.
Result<PostSample> read_posts(const RasterMosaic& mosaic, const PostRange& range);

/// The posts of the mosaic that lie around a tile, with two more on each side.
PostRange posts_around(const RasterMosaic& mosaic, const Lattice& lattice, const TileKey& tile);

/// A height field of a window: what a build makes of these posts if there were no others (voids filled, falloff).
class WindowField {
 public:
  /// Takes the sample of `range`.
  WindowField(const RasterMosaic& mosaic, const Lattice& lattice, const PostRange& range, PostSample sample,
              double base_height_m, int falloff_posts);
  WindowField(WindowField&&) noexcept = default;
  WindowField& operator=(WindowField&&) noexcept = default;

  const HeightField& field() const { return field_; }  ///< Valid as long as this object, moved or not.

 private:
  std::vector<float> heights_m_;
  std::vector<PostOrigin> origins_;
  std::vector<std::byte> block_memory_;
  std::unique_ptr<PostBlocks> blocks_;
  HeightField field_;
};

}  // namespace tind
