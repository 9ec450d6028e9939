// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <cstdint>

#include "core/held_pages.hpp"

namespace tind {

enum class PostOrigin : std::uint8_t;

/// A square of a field's posts, row-major from the south-west. Its last rows and columns mean nothing where the grid
/// ends before them.
struct PostPage {
  static constexpr std::int64_t kSide = 64;
  float heights_m[kSide * kSide];
  PostOrigin origins[kSide * kSide];
};

/// The posts of a grid that is not in memory as a whole. Page (i, j) begins with post (i * kSide, j * kSide).
class PostPages : public HeldPages<PostPage> {
 public:
  static constexpr std::int64_t kSide = PostPage::kSide;

  /// For a grid of so many posts (>= 1).
  PostPages(std::int64_t n_rows, std::int64_t n_cols, std::size_t n_held)
      : HeldPages((n_rows + kSide - 1) / kSide, (n_cols + kSide - 1) / kSide, n_held) {}

  virtual float height_m(std::int64_t r, std::int64_t c) const { return of_post(r, c).heights_m[index(r, c)]; }
  virtual PostOrigin origin(std::int64_t r, std::int64_t c) const { return of_post(r, c).origins[index(r, c)]; }
  /// The page of a post, and its place in it.
  const PostPage& of_post(std::int64_t r, std::int64_t c) const { return page(r >> kSideBits, c >> kSideBits); }
  static std::size_t index(std::int64_t r, std::int64_t c) {
    return static_cast<std::size_t>((r & (kSide - 1)) << kSideBits | (c & (kSide - 1)));
  }
  /// Whether all of these posts are known to be of origin kSource without a look at them.
  virtual bool is_known_source(std::int64_t row, std::int64_t col, std::int64_t n_rows, std::int64_t n_cols) const;
  /// Copies posts [row, row + n_rows) x [col, col + n_cols), which lie in the grid, to row-major arrays of that size.
  /// `origins` may be null.
  virtual void copy(std::int64_t row, std::int64_t col, std::int64_t n_rows, std::int64_t n_cols, float* heights_m,
                    PostOrigin* origins) const;

 private:
  static constexpr int kSideBits = 6;
  static_assert(kSide == 1 << kSideBits);
};

}  // namespace tind
