// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/height_field.hpp"
#include "core/post_pages.hpp"
#include "core/result.hpp"
#include "storage/readers/cancel.hpp"
#include "storage/readers/scratch_map.hpp"
#include "storage/readers/void_fill.hpp"

namespace tind {

/// The posts behind a height field's grid, in scratch files or, few ones, in memory: heights, origins, and room for
/// their blocks. All zero (that is, voids) at first; arrays while they are made, pages once they are looked at here and
/// there.
class PostArrays {
 public:
  /// Arrays of up to `in_memory_bytes`, blocks included, are in memory, where blocks are made on demand. As
  /// ScratchMap::create and in_memory. Preconditions: n_rows, n_cols >= 1.
  static Result<PostArrays> create(const std::string& folder, std::int64_t n_rows, std::int64_t n_cols,
                                   std::uint64_t in_memory_bytes = 0);
  PostArrays() = default;
  /// Bytes of the arrays behind such a field, blocks included.
  static std::uint64_t n_bytes(const HeightField& field) {
    return n_post_bytes(field.n_rows, field.n_cols) + PostBlocks::n_bytes(field.n_rows, field.n_cols);
  }

  /// The grid of posts; `wraps` is the caller's to set.
  PostGrid grid() const;
  /// Points the field at the arrays. Precondition: it has the grid's size.
  void attach(HeightField& field) const;
  /// Sets the posts from index `at` on, which are voids so far, in as few writes as there can be: a few thousand posts
  /// at once cost a third of what they cost row by row. Long stretches of voids are left out. Thread safe for different
  /// posts. kIo: the scratch file cannot be written. Precondition: as many origins as heights; voids have height 0.
  Result<void> take(std::int64_t at, std::span<const float> heights_m, std::span<const PostOrigin> origins);
  /// Builds the blocks of the attached field's posts and points it at them; valid as long as this object, which must
  /// not move any more. When `cancel` is set it ends early and the field gets none.
  void build_blocks(HeightField& field, int threads, CancelFlag cancel);
  /// Moves the posts of the attached field and their blocks, which are built, into pages; the arrays are gone then. A
  /// thread holds up to `held_bytes` of pages. Valid as long as this object. kIo: no disk space (1.2 bytes a post more
  /// than before; all of it once more where the file system cannot free parts of a file). kInterrupted: neither arrays
  /// nor pages are left. Precondition: the arrays are in files.
  Result<void> turn_into_pages(HeightField& field, const std::string& folder, std::size_t held_bytes, int threads,
                               CancelFlag cancel);

 private:
  static std::uint64_t n_post_bytes(std::int64_t n_rows, std::int64_t n_cols) {
    return static_cast<std::uint64_t>(n_rows) * static_cast<std::uint64_t>(n_cols) *
           (sizeof(float) + sizeof(PostOrigin));
  }

  ScratchMap map_, block_map_;
  std::int64_t n_rows_ = 0, n_cols_ = 0;
  float* heights_m_ = nullptr;
  PostOrigin* origins_ = nullptr;
  std::span<std::byte> block_memory_;
  PostBlocks blocks_;
  std::unique_ptr<PostPages> pages_;
  std::unique_ptr<PostBlockPages> block_pages_;
};

}  // namespace tind
