// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "core/height_field.hpp"
#include "core/result.hpp"
#include "storage/readers/cancel.hpp"
#include "storage/readers/gdal_raster.hpp"

namespace tind {

struct HeightGridOptions {
  double base_height_m = 0;
  int falloff_posts = 64;   ///< Distance over which the surface falls from the nearest values to the base height; >= 1.
  std::string scratch_dir;  ///< Where the unlinked scratch file of the grid lives (same file system as the output).
  int threads = 1;          ///< >= 1; the result does not depend on it.
  /// Posts of up to so many bytes, blocks included, are held in memory and get blocks on demand: for who looks at few
  /// of them.
  std::uint64_t in_memory_bytes = 0;
  /// Those may be pages at once: nobody reads arrays.
  bool may_be_pages = false;
  CancelFlag cancel = nullptr;  ///< Set: load() stops within a second.
};

struct HeightGridCounts {
  std::uint64_t source = 0;       ///< Posts that come from a source.
  std::uint64_t filled = 0;       ///< Posts inside interior voids, filled smoothly.
  std::uint64_t falloff = 0;      ///< Posts of the falloff.
  std::uint64_t overlapping = 0;  ///< Posts that more than one source has.
  std::uint64_t disagreeing = 0;  ///< Of those, posts where the sources differ.
  std::uint64_t implausible = 0;  ///< Source values beyond +-kMaxHeightM, taken as voids.
};

/// The extended grid of posts behind a HeightField: owns the memory map of an unlinked scratch file whose disk space
/// was reserved first (so a full disk is an error message, never a SIGBUS). Resident memory is the operating system's
/// page cache. docs/decisions/0002-height-field.md states the rules.
class HeightGrid {
 public:
  /// Reads the mosaic, merges overlaps, fills interior voids, adds the falloff. `progress(fraction)`, if not empty, is
  /// called from this thread. kInvalidInput: all posts are voids, or the options are out of range. kIo: a read failed
  /// (truncated file) or no disk space. kInterrupted: options.cancel.
  static Result<HeightGrid> load(const RasterMosaic& mosaic, const Lattice& lattice, const HeightGridOptions& options,
                                 const std::function<void(double)>& progress);
  HeightGrid(HeightGrid&&) noexcept;
  HeightGrid& operator=(HeightGrid&&) noexcept;
  ~HeightGrid();

  const HeightField& field() const;  ///< Valid as long as this object.
  /// As PostArrays::turn_into_pages. Not while anybody looks at the field.
  Result<void> turn_into_pages(const std::string& scratch_dir, std::size_t held_bytes, int threads, CancelFlag cancel);
  const HeightGridCounts& counts() const;
  const std::vector<std::string>& notes() const;  ///< Lines for the user: what was assumed or changed.

 private:
  struct Impl;
  explicit HeightGrid(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace tind
