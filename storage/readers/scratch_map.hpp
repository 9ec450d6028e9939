// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <string>
#include <utility>

#include "core/result.hpp"
#include "storage/readers/resident_maps.hpp"
#include "storage/readers/scratch_file.hpp"

namespace tind {

/// Room for more bytes than one wants on the heap, zero at first: the memory map of an unlinked file whose disk space
/// was reserved first, so that a full disk is an error message and never a SIGBUS, or memory. A file's pages may be
/// dropped from the process's memory at any time (storage/readers/resident_maps.hpp); what was written stays.
class ScratchMap {
 public:
  /// `folder`: where the file lives while it has a name; empty: the current one. `n_bytes` > 0. kIo: no such folder, no
  /// permission, no space.
  static Result<ScratchMap> create(const std::string& folder, std::uint64_t n_bytes);
  /// No file, so nothing can be dropped: pages cost a third, huge ones (of 2 MiB) less, which memory that is written
  /// all over should ask for. kIo: no memory.
  static Result<ScratchMap> in_memory(std::uint64_t n_bytes, bool huge_pages);
  ScratchMap() = default;
  ScratchMap(ScratchMap&& other) noexcept
      : address_(std::exchange(other.address_, nullptr)),
        n_bytes_(std::exchange(other.n_bytes_, 0)),
        file_(std::move(other.file_)),
        resident_(std::move(other.resident_)) {}
  ScratchMap& operator=(ScratchMap&& other) noexcept {
    std::swap(address_, other.address_);
    std::swap(n_bytes_, other.n_bytes_);
    std::swap(file_, other.file_);
    std::swap(resident_, other.resident_);
    return *this;
  }
  ~ScratchMap();
  void* data() const { return address_; }
  bool is_file() const { return file_.descriptor() >= 0; }
  /// The file behind the map, if it is one: the same bytes, for what is read or written once, in long stretches,
  /// without bringing pages into this process's memory.
  ScratchFile& file() { return file_; }

 private:
  ScratchMap(void* address, std::uint64_t n_bytes) : address_(address), n_bytes_(n_bytes) {}
  ScratchMap(void* address, std::uint64_t n_bytes, ScratchFile file)
      : address_(address), n_bytes_(n_bytes), file_(std::move(file)), resident_(address, n_bytes) {}

  void* address_ = nullptr;
  std::uint64_t n_bytes_ = 0;
  ScratchFile file_;
  ResidentMap resident_;
};

/// Where scratch maps are made: in memory, of huge pages, as long as `memory_bytes` are enough for all of them, else in
/// files of `folder`.
struct ScratchPlace {
  std::string folder;
  std::uint64_t memory_bytes = 0;

  /// As ScratchMap::create. One thread.
  Result<ScratchMap> make(std::uint64_t n_bytes);
};

}  // namespace tind
