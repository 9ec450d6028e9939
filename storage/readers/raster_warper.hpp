// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "core/result.hpp"
#include "storage/readers/pixel_transform.hpp"

namespace tind {

/// Heights of one raster at any places of the globe, by one stated rule (docs/decisions/0005-warped-posts.md). Reads
/// the raster in square blocks and keeps the most recent kMostBlocks of them. One thread at a time.
class RasterWarper {
 public:
  /// `file` must outlive this object.
  RasterWarper(RasterFile& file, PixelTransform transform, Resampling resampling);
  RasterWarper(RasterWarper&&) noexcept;
  RasterWarper& operator=(RasterWarper&&) noexcept;
  ~RasterWarper();

  /// Heights in metres at `places` (longitude, latitude in degrees; replaced by columns and rows), NaN for voids;
  /// out: places.size() values. `n_implausible` counts each cell once. kIo: the file cannot be read.
  Result<void> sample(std::span<Place> places, float* heights_m, std::uint64_t& n_implausible);
  /// Blocks kept, each up to kBlockSide^2 heights.
  std::size_t n_blocks() const;
  /// Forgets the blocks.
  void clear();

  const PixelTransform& transform() const;

  static constexpr std::int64_t kBlockSide = 256;  ///< Cells.
  static constexpr std::size_t kMostBlocks = 512;  ///< 128 MB of heights.

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace tind
