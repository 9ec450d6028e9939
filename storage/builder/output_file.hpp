// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>
#include <utility>

#include "core/result.hpp"

namespace tind {

/// A file under a temporary name that is removed unless it gets its final one.
class TemporaryFile {
 public:
  explicit TemporaryFile(std::string path) : path_(std::move(path)) {}
  ~TemporaryFile();
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;

  const std::string& path() const { return path_; }
  /// Atomic; the target is replaced. kIo when the file system refuses.
  Result<void> rename_to(const std::string& target);

 private:
  std::string path_;
};

/// Refuses with kInvalidInput what no output can be written to: no name, no such folder, a folder, a file that exists
/// when not `force`.
Result<void> check_output(const std::string& output, bool force);

}  // namespace tind
