// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "core/border_line.hpp"
#include "core/triangulator.hpp"
#include "storage/inputs_blob.hpp"

namespace tind {

/// Digests of the posts under tiles, with one more post all around, as coverage and bilinear samples see them. A tile's
/// is made of its children's, those of the finest level of the posts themselves, which are so read once for all levels.
/// A grid that grew elsewhere gives the same digests. Immutable; const access is thread safe.
class PostDigests {
 public:
  /// Reads all posts on `threads` >= 1 threads. When `cancel` (may be null) is set it ends early and is of no use.
  PostDigests(const HeightField& field, int finest_level, int threads, const std::atomic<bool>* cancel);

  /// Of a tile of level 0..finest_level; all zero where no post is near.
  TileInputs::Digest of(const TileKey& key) const;

 private:
  struct Entry {
    std::uint64_t code = 0;  // Morton code of the tile
    TileInputs::Digest digest{};
  };
  std::vector<std::vector<Entry>> levels_;  // ascending codes; tiles that are not there have no post near
};

/// Digest of everything that shapes a tile's body but the grid's posts: its borders with all finer vertices (so
/// envelopes and runs), the vertices to start from, break lines and their heights, irregular posts, tolerances, and the
/// version of the builder. `n_gaps`: finer levels. Pure; thread safe.
TileInputs::Digest frame_digest(const HeightField& field, const TileTask& task,
                                const std::array<std::span<const LineVertex>, 4>& borders, int n_gaps);

/// Digest of a tile's VertexPosts. Nothing in it depends on the grid beyond the tile. Pure; thread safe.
std::uint64_t vertex_posts_digest(const VertexPosts& posts);

}  // namespace tind
