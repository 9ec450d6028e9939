// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/folder_watch.hpp"

#include <sys/inotify.h>
#include <unistd.h>

#include <algorithm>
#include <array>

namespace tind {
namespace {

// Not IN_MODIFY: a builder writes for hours; that it has closed the file is what counts.
constexpr std::uint32_t kEvents =
    IN_CREATE | IN_MOVED_TO | IN_MOVED_FROM | IN_DELETE | IN_CLOSE_WRITE | IN_DELETE_SELF | IN_MOVE_SELF | IN_ONLYDIR;
constexpr std::size_t kEventBytes = 16384;

}  // namespace

std::unique_ptr<FolderWatch> FolderWatch::make() {
  const int fd = ::inotify_init1(IN_NONBLOCK | IN_CLOEXEC);
  return fd < 0 ? nullptr : std::unique_ptr<FolderWatch>(new FolderWatch(fd));
}

FolderWatch::~FolderWatch() { ::close(fd_); }

bool FolderWatch::set(const std::vector<std::string>& directories) {
  bool all = true;
  std::map<std::string, int> watches;
  for (const std::string& directory : directories) {
    // Again each time: a directory that was replaced under its name is another one. The same one keeps its number.
    const int watch = ::inotify_add_watch(fd_, directory.c_str(), kEvents);
    if (watch < 0) {
      all = false;
    } else {
      watches[directory] = watch;
    }
  }
  for (const auto& [directory, watch] : watches_) {
    const bool kept =
        std::any_of(watches.begin(), watches.end(), [wanted = watch](const auto& w) { return w.second == wanted; });
    if (!kept) ::inotify_rm_watch(fd_, watch);
  }
  watches_ = std::move(watches);
  return all;
}

bool FolderWatch::drain() {
  std::array<char, kEventBytes> buffer;
  bool any = false;
  while (::read(fd_, buffer.data(), buffer.size()) > 0) any = true;
  return any;
}

}  // namespace tind
