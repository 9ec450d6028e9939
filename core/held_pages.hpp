// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <atomic>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

namespace tind {

/// A grid of pages that is not in memory as a whole: what is held at a time is bounded, however large the grid and
/// wherever it is looked at. Each thread holds pages of its own, so const access is thread safe. `Page`: bytes.
template <class Page>
class HeldPages {
 public:
  /// A grid of so many pages (>= 1). A thread holds `n_held` at most, at least one.
  HeldPages(std::int64_t n_page_rows, std::int64_t n_page_cols, std::size_t n_held)
      : n_page_rows_(n_page_rows), n_page_cols_(n_page_cols) {
    static std::atomic<std::uint64_t> n_made{0};
    serial_ = ++n_made;
    // A square of places, or two beside each other: page (i, j) has the one of row i, column j modulo its sides.
    const auto bits = std::countr_zero(std::bit_floor(std::max<std::size_t>(n_held, 1)));
    mask_ = (std::size_t{1} << bits) - 1;
    col_bits_ = (bits + 1) / 2;
    col_mask_ = (std::size_t{1} << col_bits_) - 1;
  }
  HeldPages(const HeldPages&) = delete;
  HeldPages& operator=(const HeldPages&) = delete;
  virtual ~HeldPages() = default;

  std::int64_t n_page_rows() const { return n_page_rows_; }
  std::int64_t n_page_cols() const { return n_page_cols_; }

  /// Valid until this thread asks for another page.
  const Page& page(std::int64_t i, std::int64_t j) const {
    Held& held = held_by_this_thread();
    const auto at = (static_cast<std::size_t>(i) << col_bits_ | (static_cast<std::size_t>(j) & col_mask_)) & mask_;
    const std::int64_t wanted = i * n_page_cols_ + j;
    if (held.owner != serial_ || held.numbers[at] != wanted) fetch(held, at, i, j);
    return held.pages[at];
  }

  /// Whether a page could not be read: zeros were given in its place, and what was made of them is void.
  bool failed() const { return failed_.load(std::memory_order_relaxed); }

 protected:
  /// Reads a page; any thread, several at a time. False: it cannot be read.
  virtual bool read(std::int64_t i, std::int64_t j, Page& page) const = 0;

 private:
  struct Held {
    std::uint64_t owner = 0;
    std::unique_ptr<Page[]> pages;
    std::vector<std::int64_t> numbers;  // of the pages; -1: none
  };

  static Held& held_by_this_thread() {
    thread_local Held held;
    return held;
  }

  void fetch(Held& held, std::size_t at, std::int64_t i, std::int64_t j) const {
    if (held.owner != serial_) {
      if (held.numbers.size() != mask_ + 1) held.pages = std::make_unique_for_overwrite<Page[]>(mask_ + 1);
      held.numbers.assign(mask_ + 1, -1);
      held.owner = serial_;
    }
    held.numbers[at] = i * n_page_cols_ + j;
    if (!read(i, j, held.pages[at])) {
      held.pages[at] = Page{};
      failed_.store(true, std::memory_order_relaxed);
    }
  }

  std::int64_t n_page_rows_, n_page_cols_;
  int col_bits_ = 0;
  std::size_t col_mask_ = 0, mask_ = 0;
  std::uint64_t serial_ = 0;  // no two objects of a process have the same
  mutable std::atomic<bool> failed_ = false;
};

}  // namespace tind
