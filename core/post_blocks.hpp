// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "core/held_pages.hpp"

namespace tind {

struct HeightField;
enum class PostOrigin : std::uint8_t;

/// A plane over the posts of a block: height in metres at column c, row r of the block, both counted from its
/// south-western post.
struct PostPlane {
  double origin_m = 0;   ///< At the south-western post.
  double per_col_m = 0;  ///< Metres per post eastwards.
  double per_row_m = 0;  ///< Metres per post northwards.

  double at(double col, double row) const { return origin_m + per_col_m * col + per_row_m * row; }
};

/// What a scan needs of a block of posts. DESIGN 6: the error of a whole block against a triangle is bounded by the
/// distance of two planes at the block's corners and this range.
struct PostBlock {
  float origin_m = 0, per_col_m = 0, per_row_m = 0;  ///< The block's plane: least squares, rounded.
  /// low_m <= h - plane <= high_m at every post, however a double evaluation of the plane associates.
  float low_m = 0, high_m = 0;
  std::uint8_t origins = 0;  ///< Bit 1 << PostOrigin for each origin that a post of the block has.
  std::array<std::uint8_t, 3> unused{};

  PostPlane plane() const {
    return {static_cast<double>(origin_m), static_cast<double>(per_col_m), static_cast<double>(per_row_m)};
  }
  bool has(PostOrigin origin) const { return (origins >> static_cast<int>(origin) & 1) != 0; }
  bool is_all(PostOrigin origin) const { return origins == 1 << static_cast<int>(origin); }
};

/// Sums over all posts of a block, whatever their origin; r = h - plane, with columns and rows counted from the
/// block's centre.
struct PostBlockSums {
  double residual2_m2 = 0;                   ///< Sum of r^2.
  float residual_m = 0;                      ///< Sum of r: near zero, but the plane is rounded.
  float residual_cols_m = 0;                 ///< Sum of r * column.
  float residual_rows_m = 0;                 ///< Sum of r * row.
  float min_height_m = 0, max_height_m = 0;  ///< Exact.
  std::uint32_t n_source = 0;                ///< Posts of origin kSource.
};

/// What the posts of a block are, without a plane. Exact.
struct PostSummary {
  float min_height_m = 0, max_height_m = 0;
  std::uint32_t n_source = 0;  ///< Posts of origin kSource.
  std::uint8_t origins = 0;    ///< As PostBlock's.

  bool has(PostOrigin origin) const { return (origins >> static_cast<int>(origin) & 1) != 0; }
  bool is_all(PostOrigin origin) const { return origins == 1 << static_cast<int>(origin); }
};

/// The blocks of a square of posts, levels 0 to kLevels - 1, each row-major from the south-west. Those beyond the
/// grid's end mean nothing.
struct PostBlockPage {
  static constexpr int kLevels = 4;
  static constexpr std::size_t kBlocks = 64 + 16 + 4 + 1;
  std::array<PostBlock, kBlocks> blocks;
  std::array<PostBlockSums, kBlocks> sums;

  /// Place of block (i, j) of a level in its page, and the page's row or column.
  static std::size_t index(int level, std::int64_t i, std::int64_t j) {
    constexpr std::array<std::size_t, kLevels> kFirst = {0, 64, 80, 84};
    const std::int64_t side = std::int64_t{1} << (kLevels - 1 - level);
    return kFirst[static_cast<std::size_t>(level)] + static_cast<std::size_t>(i % side * side + j % side);
  }
  static std::int64_t page_of(int level, std::int64_t i) { return i >> (kLevels - 1 - level); }
};
using PostBlockPages = HeldPages<PostBlockPage>;

/// A pyramid of blocks over the grid of a HeightField. Level 0: kSide x kSide posts a block, fewer in the last row and
/// column; each coarser one 2 x 2 blocks, up to one block or blocks of kMaxSide posts. 56 bytes a block, 1.2 bytes a
/// post in all. A value with pointers into memory it does not own, and a copy of nothing: it describes the field as it
/// was when it was built. Const access is thread safe.
class PostBlocks {
 public:
  static constexpr std::int64_t kSide = 8;
  static constexpr std::int64_t kMaxSide = 32768;

  /// Posts [row, row + n_rows) x [col, col + n_cols) of the field.
  struct Extent {
    std::int64_t row = 0, col = 0, n_rows = 0, n_cols = 0;
    std::int64_t n_posts() const { return n_rows * n_cols; }
  };

  /// Bytes of memory that the blocks of a grid take. Preconditions: n_rows, n_cols >= 1.
  static std::uint64_t n_bytes(std::int64_t n_rows, std::int64_t n_cols);
  /// Builds the blocks of field's grid into `memory`: n_bytes(...) of it, aligned to 8, kept by the caller. Uses
  /// `threads` >= 1 of them; the bytes do not depend on it. Precondition: all heights are finite. When `cancel` (may be
  /// null) is set it ends early, and the blocks are of no use.
  /// `done(begin, n_bytes)`, if not empty, is called on any thread for stretches of the field's arrays and of `memory`
  /// that will not be used for a while.
  static PostBlocks build(const HeightField& field, std::span<std::byte> memory, int threads,
                          const std::atomic<bool>* cancel = nullptr,
                          const std::function<void(const void*, std::size_t)>& done = {});

  /// The same blocks, each square of kLevels levels made when somebody first asks for one of its blocks, and a coarser
  /// block when it is asked for itself: for who looks at few of them. Only summaries of all squares are made at once.
  /// The field's arrays or pages and `memory` stay where they are and as they are, as long as there is a copy of the
  /// blocks. `known`, if not empty: of each square its summary, or one without origins, which is made.
  static PostBlocks on_demand(const HeightField& field, std::span<std::byte> memory, int threads,
                              const std::atomic<bool>* cancel = nullptr, std::span<const PostSummary> known = {});
  bool is_on_demand() const { return demand_ != nullptr; }
  /// The coarsest level of which a block is no more than what is made at once.
  int most_level_at_once() const { return is_on_demand() ? square_level() : n_levels() - 1; }

  /// Side of the grid of pages over so many posts.
  static std::int64_t n_pages(std::int64_t n_posts) {
    return (n_posts + side(PostBlockPage::kLevels - 1) - 1) / side(PostBlockPage::kLevels - 1);
  }
  /// Bytes of the levels that pages do not hold; may be 0.
  std::uint64_t n_coarse_bytes() const;
  /// The same blocks, those of the levels of a page from `pages` (not owned), the others moved to `memory`:
  /// n_coarse_bytes() of it, kept by the caller. The memory of the whole is not needed any more.
  PostBlocks in_pages(const PostBlockPages& pages, std::span<std::byte> memory) const;

  /// As HeldPages::failed.
  bool failed() const { return pages_ != nullptr && pages_->failed(); }
  int n_levels() const { return static_cast<int>(levels_.size()); }
  std::int64_t n_block_rows(int level) const { return at(level).n_rows; }
  std::int64_t n_block_cols(int level) const { return at(level).n_cols; }
  /// Posts along a side of a block of this level that is not cut short by the grid's end.
  static std::int64_t side(int level) { return kSide << level; }
  /// Block (i, j) of a level: row i from the south, column j from the west. Where there are pages it is valid until
  /// this thread asks for a block elsewhere; else a row lies together (on demand the others mean nothing yet).
  const PostBlock& block(int level, std::int64_t i, std::int64_t j) const {
    if (pages_ != nullptr && level < PostBlockPage::kLevels) {
      return page(level, i, j).blocks[PostBlockPage::index(level, i, j)];
    }
    if (demand_ != nullptr) make(level, i, j);
    return at(level).blocks[i * at(level).n_cols + j];
  }
  const PostBlockSums& sums(int level, std::int64_t i, std::int64_t j) const {
    if (pages_ != nullptr && level < PostBlockPage::kLevels) {
      return page(level, i, j).sums[PostBlockPage::index(level, i, j)];
    }
    if (demand_ != nullptr) make(level, i, j);
    return at(level).sums[i * at(level).n_cols + j];
  }
  /// Of a block that visit() comes by; makes none.
  PostSummary summary(int level, std::int64_t i, std::int64_t j) const;
  Extent extent(int level, std::int64_t i, std::int64_t j) const {
    const std::int64_t s = side(level);
    return {i * s, j * s, std::min(s, n_rows_ - i * s), std::min(s, n_cols_ - j * s)};
  }
  /// Sum over a block's posts of (h - p)^2 in square metres, in closed form: within 1e-9 of its value.
  double squared_distance_m2(int level, std::int64_t i, std::int64_t j, const PostPlane& p) const;

  /// Walks over the posts of a window (clipped to the grid) from the coarsest blocks down. settle(level, i, j, inside)
  /// is called for each block that meets the window, `inside` iff it lies wholly in it; true: the block is done with.
  /// Level 0 blocks that are not give posts(row, col_begin, col_end) for each of their rows in the window. Blocks on
  /// demand are walked over by their squares alone, so that none is made.
  template <class Settle, class Posts>
  void visit(const Extent& window, Settle settle, Posts posts) const {
    const Extent w = clipped(window);
    if (w.n_rows <= 0 || w.n_cols <= 0) return;
    const int top = most_level_at_once();
    for (std::int64_t i = w.row / side(top); i <= (w.row + w.n_rows - 1) / side(top); ++i) {
      for (std::int64_t j = w.col / side(top); j <= (w.col + w.n_cols - 1) / side(top); ++j) {
        visit_block(top, i, j, w, settle, posts);
      }
    }
  }

 private:
  struct Level {
    std::int64_t n_rows = 0, n_cols = 0;
    PostBlock* blocks = nullptr;
    PostBlockSums* sums = nullptr;
  };

  const Level& at(int level) const { return levels_[static_cast<std::size_t>(level)]; }
  const PostBlockPage& page(int level, std::int64_t i, std::int64_t j) const {
    return pages_->page(PostBlockPage::page_of(level, i), PostBlockPage::page_of(level, j));
  }
  Extent clipped(const Extent& w) const {
    const std::int64_t row = std::max<std::int64_t>(w.row, 0), col = std::max<std::int64_t>(w.col, 0);
    return {row, col, std::min(w.row + w.n_rows, n_rows_) - row, std::min(w.col + w.n_cols, n_cols_) - col};
  }
  static PostBlocks lay_out(const HeightField& field, std::span<std::byte> memory);
  void fit_leaf(const HeightField& field, std::int64_t i, std::int64_t j) const;
  void merge_children(int level, std::int64_t i, std::int64_t j) const;
  // Of squares that are made at once.
  int square_level() const { return std::min(PostBlockPage::kLevels, n_levels()) - 1; }
  // Makes a block on demand that is not there yet.
  void make(int level, std::int64_t i, std::int64_t j) const;

  template <class Settle, class Posts>
  void visit_block(int level, std::int64_t i, std::int64_t j, const Extent& w, Settle& settle, Posts& posts) const {
    const Extent e = extent(level, i, j);
    const std::int64_t row_begin = std::max(e.row, w.row), row_end = std::min(e.row + e.n_rows, w.row + w.n_rows);
    const std::int64_t col_begin = std::max(e.col, w.col), col_end = std::min(e.col + e.n_cols, w.col + w.n_cols);
    if (row_begin >= row_end || col_begin >= col_end) return;
    const bool inside = row_end - row_begin == e.n_rows && col_end - col_begin == e.n_cols;
    if (settle(level, i, j, inside)) return;
    if (level == 0 || is_on_demand()) {
      for (std::int64_t r = row_begin; r < row_end; ++r) posts(r, col_begin, col_end);
      return;
    }
    const Level& finer = at(level - 1);
    for (std::int64_t ci = 2 * i; ci < std::min(2 * i + 2, finer.n_rows); ++ci) {
      for (std::int64_t cj = 2 * j; cj < std::min(2 * j + 2, finer.n_cols); ++cj) {
        visit_block(level - 1, ci, cj, w, settle, posts);
      }
    }
  }

  std::int64_t n_rows_ = 0, n_cols_ = 0;  // of posts
  std::vector<Level> levels_;
  const PostBlockPages* pages_ = nullptr;
  struct Demand;
  std::shared_ptr<Demand> demand_;  // null: all are made
};

}  // namespace tind
