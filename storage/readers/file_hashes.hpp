// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <deque>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "core/result.hpp"

namespace tind {

/// SHA-256 of whole files, made by threads of its own while the caller does something else. The caller is one thread.
class FileHashes {
 public:
  /// `most_threads`: at least 1.
  explicit FileHashes(int most_threads) : most_threads_(most_threads) {}
  FileHashes(const FileHashes&) = delete;
  FileHashes& operator=(const FileHashes&) = delete;
  /// Gives up what is not done, within a moment.
  ~FileHashes();

  /// Begins with a file, by any name that GDAL reads. Returns its number, from 0 on.
  std::size_t add(const std::string& name);
  /// Waits for a file: 64 lower-case hexadecimal digits. kIo: it cannot be read.
  Result<std::string> wait_for(std::size_t file);

 private:
  struct File {
    std::string name;
    std::optional<Result<std::string>> hash;
  };

  void work();
  Result<std::string> hash_of(const std::string& name) const;

  const int most_threads_;
  std::atomic<bool> given_up_{false};
  std::mutex mutex_;  // of what follows
  std::condition_variable done_;
  std::deque<File> files_;  // which stay where they are
  std::size_t next_ = 0;    // that nobody has begun
  int n_working_ = 0;
  std::vector<std::jthread> threads_;  // the caller's alone
};

}  // namespace tind
