// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "core/drainage/compare.hpp"
#include "core/drainage/drainage.hpp"
#include "core/drainage/flow_grid.hpp"
#include "core/result.hpp"
#include "storage/readers/scratch_map.hpp"
#include "storage/report/source_grid.hpp"

namespace tind {

/// The streams of a source's posts, and how well those of other surfaces over the same posts match them. Every surface
/// is filled, drained and accumulated like the source's posts, with their sea, lakes, voids and basins (no stream is
/// looked for there). 18 bytes a post of the grid in an unlinked scratch file. One thread.
class StreamQuality {
 public:
  /// Streams of the source at the thresholds of `levels` (DrainageOptions: cells, growth, bottom_level). kIo: no
  /// scratch.
  static Result<StreamQuality> make(const SourceGrid& source, const DrainageOptions& options,
                                    const std::vector<int>& levels, double buffer_cells,
                                    const std::string& scratch_dir);

  /// Area from which on there is a stream at `level`, in cells.
  double threshold_cells(int level) const;
  /// The surface to look at next: a float per post of the source's grid; posts that are source, interpolated or filled
  /// are to be set.
  float* surface_m() { return surface_m_; }
  /// Matches the streams of surface_m() with the source's at the threshold of `level` (one of `levels`).
  StreamMatch match(int level);

 private:
  StreamQuality(const SourceGrid& source, const DrainageOptions& options, double buffer_cells, ScratchMap map);
  void drain();
  std::vector<StreamPost> streams(int level) const;

  const SourceGrid& source_;
  DrainageOptions options_;
  double buffer_cells_;
  ScratchMap map_;
  FlowGrid grid_;
  std::uint64_t* cells_ = nullptr;  ///< Accumulation; before that steps in flats, or labels.
  float* surface_m_ = nullptr;
  float* filled_m_ = nullptr;
  std::uint8_t* marks_ = nullptr;
  std::uint8_t* directions_ = nullptr;
  std::map<int, std::vector<StreamPost>> reference_;
};

}  // namespace tind
