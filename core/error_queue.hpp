// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

namespace tind {

/// The faces of a mesh that have a post beyond the tolerance, worst first by classes: errors in one class differ by
/// less than 7 %, and of one class the face that came last is the first to go. So refinement stays near the place where
/// it is, whose posts and faces are in the processor's cache; a heap in exact order hops about the tile. Entries are
/// never taken back: who pops one checks by its stamp that it still holds. Storage is kept from tile to tile. Not
/// thread safe.
class ErrorQueue {
 public:
  struct Entry {
    std::int32_t face = 0;
    std::uint32_t stamp = 0;  ///< As it was pushed: which scan of the face it comes from.
  };

  /// Forgets all entries. Preconditions: `tolerance_m` > 0, no error that follows is smaller.
  void reset(float tolerance_m) {
    for (auto& entries : classes_) entries.clear();
    first_ = class_of(tolerance_m);
    top_ = 0;
  }

  void push(std::int32_t face, float error_m, std::uint32_t stamp) {
    const std::size_t at = class_of(error_m) - first_;
    if (at >= classes_.size()) classes_.resize(at + 1);
    classes_[at].push_back({face, stamp});
    top_ = std::max(top_, at);
  }

  std::optional<Entry> pop() {
    while (top_ > 0 && classes_[top_].empty()) --top_;
    if (classes_.empty() || classes_[top_].empty()) return std::nullopt;
    const Entry entry = classes_[top_].back();
    classes_[top_].pop_back();
    return entry;
  }

 private:
  // Floats above 0 are in the order of their bits: the exponent and the upper bits of the fraction, 16 classes from one
  // power of two to the next, 4,096 in all.
  static std::size_t class_of(float error_m) { return std::bit_cast<std::uint32_t>(error_m) >> 19; }

  std::vector<std::vector<Entry>> classes_;
  std::size_t first_ = 0, top_ = 0;
};

}  // namespace tind
