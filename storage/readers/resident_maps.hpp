// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <utility>

namespace tind {

/// Drops the pages of a shared map of a file from this process's memory: what was written stays in the file (in the
/// page cache, which the system takes back when it needs memory), and the next access maps a page again. Other threads
/// may read and write the map meanwhile. `address`: of a map made with MAP_SHARED over a file, NEVER of private or
/// anonymous memory, whose contents this would erase; page-aligned. Null is ignored.
void release_map(void* address, std::size_t n_bytes);

/// The same for all pages that hold some of the bytes.
void release_pages_around(const void* address, std::size_t n_bytes);

/// Names a map to release_resident_maps() while this object lives. Any number of them; thread safe.
class ResidentMap {
 public:
  ResidentMap() = default;
  /// As release_map().
  ResidentMap(void* address, std::size_t n_bytes);
  ResidentMap(ResidentMap&& other) noexcept : address_(std::exchange(other.address_, nullptr)) {}
  ResidentMap& operator=(ResidentMap&& other) noexcept {
    std::swap(address_, other.address_);
    return *this;
  }
  /// Waits for a release that is under way: the map may be removed afterwards.
  ~ResidentMap();

 private:
  void* address_ = nullptr;
};

/// Releases all maps that are named now.
void release_resident_maps();

}  // namespace tind
