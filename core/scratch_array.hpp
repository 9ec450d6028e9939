// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <span>
#include <type_traits>
#include <vector>

#include "core/drainage/flow_run.hpp"

namespace tind {

/// Values in memory of a ScratchAllocator, or on the heap where that gives none. Moving it moves no value.
template <class T>
class ScratchArray {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  ScratchArray() = default;
  /// `n` arbitrary values. What `scratch` gives must outlive this object.
  ScratchArray(std::size_t n, const ScratchAllocator& scratch) {
    void* const memory = scratch && n > 0 ? scratch(n * sizeof(T)) : nullptr;
    if (memory == nullptr) owned_.resize(n);
    values_ = memory == nullptr ? std::span<T>(owned_) : std::span<T>(static_cast<T*>(memory), n);
  }
  ScratchArray(ScratchArray&&) noexcept = default;
  ScratchArray& operator=(ScratchArray&&) noexcept = default;

  std::size_t size() const { return values_.size(); }
  std::span<T> values() { return values_; }
  std::span<const T> values() const { return values_; }
  T& operator[](std::size_t k) { return values_[k]; }
  const T& operator[](std::size_t k) const { return values_[k]; }
  /// Only the first `n` values count from now on.
  void keep_first(std::size_t n) { values_ = values_.first(n); }

 private:
  std::span<T> values_;
  std::vector<T> owned_;
};

}  // namespace tind
