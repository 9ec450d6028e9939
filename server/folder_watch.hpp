// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

namespace tind {

/// Tells that something changed in directories, by inotify. What changed has to be looked up: events say no more than
/// that it is time to look. One thread.
class FolderWatch {
 public:
  /// nullptr where inotify cannot be had.
  static std::unique_ptr<FolderWatch> make();
  ~FolderWatch();
  FolderWatch(const FolderWatch&) = delete;
  FolderWatch& operator=(const FolderWatch&) = delete;

  /// Watches these directories and no others. False when one of them cannot be watched: not there, or too many.
  bool set(const std::vector<std::string>& directories);
  /// Readable when something happened.
  int fd() const { return fd_; }
  /// Reads the events away. False: there were none.
  bool drain();

 private:
  explicit FolderWatch(int fd) : fd_(fd) {}
  int fd_;
  std::map<std::string, int> watches_;  // by directory
};

}  // namespace tind
