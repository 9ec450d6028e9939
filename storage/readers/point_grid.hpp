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
#include "storage/readers/point_source.hpp"

namespace tind {

struct PointGridOptions {
  double base_height_m = 0;
  int falloff_posts = 64;  ///< Distance over which the surface falls from the nearest values to the base height; >= 1.
  std::string scratch_dir = {};  ///< Where the unlinked scratch files live (same file system as the output).
  std::uint64_t memory_bytes = std::uint64_t{64} << 20;  ///< For sorting points; the result does not depend on it.
  int threads = 1;                                       ///< For interpolation; the result does not depend on it.
  CancelFlag cancel = nullptr;                           ///< Set: load() stops within a second or so.
};

struct PointGridCounts {
  std::uint64_t kept = 0;          ///< Points of the field: the posts that carry the promise.
  std::uint64_t duplicates = 0;    ///< Points that round to the lattice position of a lower one, left out.
  std::uint64_t interpolated = 0;  ///< Grid posts between points.
  std::uint64_t filled = 0;        ///< Grid posts inside interior voids, filled smoothly.
  std::uint64_t falloff = 0;       ///< Grid posts of the falloff.
};

/// The height field of a point source: the kept points, and a regular grid of posts interpolated from their Delaunay
/// triangulation, with filled voids and a rim of falloff. Owns both; they lie in unlinked scratch files that are mapped
/// into memory. docs/decisions/0008-points.md states the rules.
class PointGrid {
 public:
  /// Reads the source a second time. The same points and options give the same bytes, whatever the order of points and
  /// files, memory and threads. `progress(fraction)`, if not empty, is called from this thread. kInvalidInput: options
  /// out of range, points all around the globe, next to a pole, or scattered too thinly. kIo: a read failed, or no disk
  /// space. kInterrupted: options.cancel.
  static Result<PointGrid> load(const PointSource& source, const Lattice& lattice, const PointGridOptions& options,
                                const std::function<void(double)>& progress);
  PointGrid(PointGrid&&) noexcept;
  PointGrid& operator=(PointGrid&&) noexcept;
  ~PointGrid();

  const HeightField& field() const;  ///< Valid as long as this object.
  /// As PostArrays::turn_into_pages. Not while anybody looks at the field.
  Result<void> turn_into_pages(const std::string& scratch_dir, std::size_t held_bytes, int threads, CancelFlag cancel);
  const PointGridCounts& counts() const;
  const std::vector<std::string>& notes() const;  ///< Lines for the user: what was assumed or changed.

 private:
  struct Impl;
  explicit PointGrid(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace tind
