// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/height_field.hpp"
#include "core/result.hpp"
#include "storage/readers/gdal_raster.hpp"
#include "storage/readers/scratch_map.hpp"

namespace tind {

/// The cells of projected sources at their own places, sorted into blocks of the lattice: what a warped post was made
/// from. A cell counts where the four warped posts around it are source posts. 24 bytes a cell in an unlinked scratch
/// file.
class NativeCells {
 public:
  /// Reads all sources twice. kIo: a read failed, or no disk space.
  static Result<NativeCells> load(const RasterMosaic& mosaic, const HeightField& field, const std::string& scratch_dir);

  /// Valid as long as this object.
  const PointBlocks& blocks() const { return blocks_; }
  std::uint64_t size() const { return first_.back(); }
  /// Cells with a height that do not count: they lie beside voids or on the rim of the data.
  std::uint64_t n_left_out = 0;

 private:
  ScratchMap map_;
  std::vector<std::uint64_t> first_;
  PointBlocks blocks_;
};

}  // namespace tind
