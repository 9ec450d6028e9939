// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "core/height_field.hpp"
#include "core/post_blocks.hpp"
#include "core/post_pages.hpp"
#include "core/result.hpp"
#include "storage/readers/cancel.hpp"
#include "storage/readers/scratch_map.hpp"
#include "storage/readers/void_fill.hpp"

namespace tind {

/// The posts of a grid that has no void but its rim, in memory, for who looks at them once and at few of them again:
/// two bytes a post in pages whose heights are quarters of a metre from -4096 to 12287.75 m, which those of most
/// sources are, four in others. Const access is thread safe.
class PackedPosts final : public PostPages {
 public:
  /// For a grid of so many posts, of which the first and last `margin` rows and columns are voids (>= 1). kIo: no
  /// memory. Precondition: is_room_for(n_rows, n_cols, margin).
  static Result<std::unique_ptr<PackedPosts>> create(std::int64_t n_rows, std::int64_t n_cols, std::int64_t margin);
  static bool is_room_for(std::int64_t n_rows, std::int64_t n_cols, std::int64_t margin) {
    return margin >= 1 && n_rows > 2 * (margin + 1) && n_cols > 2 * (margin + 1);
  }

  /// Rows of posts that are taken together: those of page row `i` which are not of the margin; maybe none.
  std::pair<std::int64_t, std::int64_t> rows_of(std::int64_t i) const;
  /// Takes rows_of(i), none of whose posts beyond the margin is a void: that of row r, from the margin's end on, at
  /// `first + r * stride`, r counted from the first of these rows. Thread safe for different `i`.
  void take(std::int64_t i, const float* first, std::int64_t stride);
  /// The margin and the posts beside it, whose `rim` they are: the caller gives the margin's posts their heights.
  PostGrid rim() const { return rim_; }
  /// Points the field, whose grid has this one's size, at these pages and at blocks of them that are made on demand.
  /// Valid as long as this object, whose posts do not change any more. When `cancel` is set it ends early and the field
  /// gets no blocks.
  void attach(HeightField& field, int threads, CancelFlag cancel);

  float height_m(std::int64_t r, std::int64_t c) const override;
  PostOrigin origin(std::int64_t r, std::int64_t c) const override;
  bool is_known_source(std::int64_t row, std::int64_t col, std::int64_t n_rows, std::int64_t n_cols) const override {
    return row >= margin_ && col >= margin_ && row + n_rows <= n_rows_ - margin_ && col + n_cols <= n_cols_ - margin_;
  }
  void copy(std::int64_t row, std::int64_t col, std::int64_t n_rows, std::int64_t n_cols, float* heights_m,
            PostOrigin* origins) const override;

 private:
  PackedPosts(std::int64_t n_rows, std::int64_t n_cols, std::int64_t margin);
  bool read(std::int64_t i, std::int64_t j, PostPage& page) const override;
  bool is_margin(std::int64_t r, std::int64_t c) const {
    return r < margin_ || r >= n_rows_ - margin_ || c < margin_ || c >= n_cols_ - margin_;
  }
  std::size_t page_of(std::int64_t r, std::int64_t c) const {
    return static_cast<std::size_t>(r / kSide * n_page_cols() + c / kSide);
  }
  /// Posts [begin, end) of a row, of one page; `origins` may be null.
  void copy_part(std::int64_t r, std::int64_t begin, std::int64_t end, float* heights_m, PostOrigin* origins) const;

  enum Kind : std::uint8_t { kNone, kQuarters, kFloats };

  std::int64_t n_rows_, n_cols_, margin_;
  ScratchMap quarters_map_, floats_map_, rim_map_, block_map_;
  std::uint16_t* quarters_ = nullptr;  // by page, all of its posts
  float* floats_ = nullptr;            // likewise; memory where it is used
  std::vector<std::uint8_t> kinds_;    // Kind, by page
  std::vector<PostSummary> known_;     // likewise, as far as known
  PostGrid rim_;
  PostBlocks blocks_;
};

}  // namespace tind
