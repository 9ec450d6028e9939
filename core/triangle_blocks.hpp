// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/post_blocks.hpp"

namespace tind {

/// A block of posts as a window of the grid sees it: its posts are columns [col, col + n_cols) and rows
/// [row, row + n_rows) of the window, some of which may lie beyond the window's ends.
struct BlockInWindow {
  int level = 0;
  std::int64_t i = 0, j = 0;  ///< PostBlocks address.
  PostBlocks::Extent posts;

  bool is_within(std::int64_t n_rows, std::int64_t n_cols) const {
    return posts.row >= 0 && posts.col >= 0 && posts.row + posts.n_rows <= n_rows && posts.col + posts.n_cols <= n_cols;
  }
};

/// The blocks of posts that meet a triangle, from coarse ones down. Keeps references to the blocks.
class TriangleBlocks {
 public:
  /// Corners (u[i], v[i]), counter-clockwise: column and row in the window, whose post (0, 0) is post (field_row,
  /// field_col) of the grid. Blocks that miss the triangle by less than `slack` posts count as met.
  TriangleBlocks(const PostBlocks& blocks, std::int64_t field_row, std::int64_t field_col, const double (&u)[3],
                 const double (&v)[3], double slack)
      : blocks_(blocks), field_row_(field_row), field_col_(field_col), slack_(slack) {
    west_ = std::min({u[0], u[1], u[2]}) - slack;
    east_ = std::max({u[0], u[1], u[2]}) + slack;
    south_ = std::min({v[0], v[1], v[2]}) - slack;
    north_ = std::max({v[0], v[1], v[2]}) + slack;
    for (int k = 0; k < 3; ++k) {
      const int next = k == 2 ? 0 : k + 1;
      edges_[k] = {v[k] - v[next], u[next] - u[k], 0};
      edges_[k].rest = -(edges_[k].per_col * u[k] + edges_[k].per_row * v[k]);
    }
  }

  /// From now on blocks that miss these posts of the window count as not met, too.
  void clip(const PostBlocks::Extent& e) {
    west_ = std::max(west_, static_cast<double>(e.col));
    east_ = std::min(east_, static_cast<double>(e.col + e.n_cols - 1));
    south_ = std::max(south_, static_cast<double>(e.row));
    north_ = std::min(north_, static_cast<double>(e.row + e.n_rows - 1));
  }

  /// Calls visit(block) for a few blocks that cover the triangle together.
  template <class Visit>
  void for_coarsest(Visit visit) const {
    for_coarsest(blocks_.n_levels() - 1, visit);
  }

  /// Calls visit(block) for blocks of level 0 that have between them all posts of the triangle but those of blocks of
  /// which bound(PostBlock, its extent in the window) says less than `worst`, which `visit` may raise; the most
  /// promising ones come first.
  template <class Bound, class Visit>
  void for_promising(const double& worst, Bound bound, Visit visit) const {
    struct Promise {
      double bound_m;
      BlockInWindow block;
    };
    const auto promise_of = [&](const BlockInWindow& b) {
      return Promise{bound(blocks_.block(b.level, b.i, b.j), b.posts), b};
    };
    const auto descend = [&](const Promise& from, const auto& self) -> void {
      if (from.bound_m < worst) return;
      if (from.block.level == 0) {
        visit(from.block);
        return;
      }
      std::array<Promise, 4> children;
      std::size_t n = 0;
      for_children(from.block, [&](const BlockInWindow& b) { children[n++] = promise_of(b); });
      std::array<std::uint8_t, 4> order{};  // insertion sort: there are four
      for (std::size_t k = 0; k < n; ++k) {
        std::size_t place = k;
        for (; place > 0 && children[order[place - 1]].bound_m < children[k].bound_m; --place) {
          order[place] = order[place - 1];
        }
        order[place] = static_cast<std::uint8_t>(k);
      }
      for (std::size_t k = 0; k < n; ++k) self(children[order[k]], self);
    };
    std::vector<Promise> coarsest;
    const auto add = [&](const BlockInWindow& b) { coarsest.push_back(promise_of(b)); };
    for_coarsest(blocks_.most_level_at_once(), add);
    std::stable_sort(coarsest.begin(), coarsest.end(),
                     [](const Promise& a, const Promise& b) { return a.bound_m > b.bound_m; });
    for (const Promise& p : coarsest) descend(p, descend);
  }

  /// Calls visit(block) for the blocks that a coarser one consists of, one level down. Precondition: block.level > 0.
  template <class Visit>
  void for_children(const BlockInWindow& block, Visit visit) const {
    const int level = block.level - 1;
    for (std::int64_t i = 2 * block.i; i < std::min(2 * block.i + 2, blocks_.n_block_rows(level)); ++i) {
      for (std::int64_t j = 2 * block.j; j < std::min(2 * block.j + 2, blocks_.n_block_cols(level)); ++j) {
        visit_if_met(level, i, j, visit);
      }
    }
  }

 private:
  struct Edge {
    double per_col, per_row, rest;  // >= 0 on the triangle's side
  };

  // Of levels up to most_level.
  template <class Visit>
  void for_coarsest(int most_level, Visit& visit) const {
    int level = 0;
    while (level < most_level &&
           static_cast<double>(PostBlocks::side(level)) * 2 < std::max(east_ - west_, north_ - south_)) {
      ++level;
    }
    const double side = static_cast<double>(PostBlocks::side(level));
    const auto index = [side](double at, std::int64_t origin, std::int64_t n) {
      return static_cast<std::int64_t>(
          std::clamp((at + static_cast<double>(origin)) / side, 0.0, static_cast<double>(n - 1)));
    };
    const std::int64_t n_rows = blocks_.n_block_rows(level), n_cols = blocks_.n_block_cols(level);
    for (std::int64_t i = index(south_, field_row_, n_rows); i <= index(north_, field_row_, n_rows); ++i) {
      for (std::int64_t j = index(west_, field_col_, n_cols); j <= index(east_, field_col_, n_cols); ++j) {
        visit_if_met(level, i, j, visit);
      }
    }
  }

  template <class Visit>
  void visit_if_met(int level, std::int64_t i, std::int64_t j, Visit& visit) const {
    PostBlocks::Extent posts = blocks_.extent(level, i, j);
    posts.row -= field_row_;
    posts.col -= field_col_;
    const double c0 = static_cast<double>(posts.col), c1 = static_cast<double>(posts.col + posts.n_cols - 1);
    const double r0 = static_cast<double>(posts.row), r1 = static_cast<double>(posts.row + posts.n_rows - 1);
    if (c1 < west_ || c0 > east_ || r1 < south_ || r0 > north_) return;
    for (const Edge& e : edges_) {
      const double most = e.per_col * (e.per_col > 0 ? c1 : c0) + e.per_row * (e.per_row > 0 ? r1 : r0) + e.rest;
      if (most < -slack_ * (std::abs(e.per_col) + std::abs(e.per_row))) return;
    }
    visit(BlockInWindow{level, i, j, posts});
  }

  const PostBlocks& blocks_;
  std::int64_t field_row_, field_col_;
  double slack_, west_, east_, south_, north_;
  Edge edges_[3];
};

}  // namespace tind
