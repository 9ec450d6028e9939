// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <string>
#include <utility>

#include "core/result.hpp"

namespace tind {

/// An unlinked file for what does not stay in memory: it goes with the object, or with the process. Reads and writes
/// bring no pages into this process's memory. Const access and access to different bytes are thread safe.
class ScratchFile {
 public:
  /// `folder`: where the file lives while it has a name; empty: the current one. kIo: no such folder, no permission.
  static Result<ScratchFile> create(const std::string& folder);
  ScratchFile() = default;
  ScratchFile(ScratchFile&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  ScratchFile& operator=(ScratchFile&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }
  ~ScratchFile();

  int descriptor() const { return fd_; }
  /// Whole or not at all. False: the system refused (EIO, ENOSPC; ENODATA where the file ends before), errno says why.
  bool write(std::uint64_t offset, const void* from, std::uint64_t n_bytes);
  bool read(std::uint64_t offset, void* to, std::uint64_t n_bytes) const;
  /// Gives the disk space of these bytes back, which read as zeros from then on, where the file system can; rounded
  /// inwards to its blocks.
  void free_space(std::uint64_t offset, std::uint64_t n_bytes);

 private:
  explicit ScratchFile(int fd) : fd_(fd) {}

  int fd_ = -1;
};

}  // namespace tind
