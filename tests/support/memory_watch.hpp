// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>

namespace tind::test {

/// Replaces operator new for the program that links it. Largest single request since reset, in bytes. One thread.
std::size_t largest_request();
void reset_largest_request();

/// Bytes that operator new has given and that were not deleted: now, and at most since reset. One thread.
std::size_t held_bytes();
std::size_t most_held_bytes();
void reset_most_held_bytes();

/// Memory that the above does not count, for scratch allocators. Freed with the object.
class UncountedMemory {
 public:
  UncountedMemory() = default;
  UncountedMemory(const UncountedMemory&) = delete;
  ~UncountedMemory();
  void* take(std::size_t n_bytes);
  std::size_t n_bytes() const { return n_bytes_; }

 private:
  struct Block {
    Block* next;
  };
  Block* first_ = nullptr;
  std::size_t n_bytes_ = 0;
};

}  // namespace tind::test
