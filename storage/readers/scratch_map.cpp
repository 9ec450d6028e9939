// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/scratch_map.hpp"

#include <cassert>
#include <cerrno>
#include <cstring>
#include <limits>

#include <fcntl.h>
#include <fmt/format.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>

namespace tind {

Result<ScratchMap> ScratchMap::create(const std::string& folder, std::uint64_t n_bytes) {
  const std::string where = folder.empty() ? "." : folder;
  const auto refuse = [&](int error) {
    const char* hint = error == ENOSPC || error == EFBIG || error == EDQUOT
                           ? "; free some space there, or write the output to another disk"
                           : "";
    return fail(ErrorKind::kIo, fmt::format("{}: cannot make a scratch file of {} MB for the posts: {}{}", where,
                                            (n_bytes >> 20) + 1, std::strerror(error), hint));
  };
  if (n_bytes > static_cast<std::uint64_t>(std::numeric_limits<off_t>::max())) return refuse(EFBIG);
  std::string name = where + "/.tind-scratch-XXXXXX";
  const int fd = mkstemp(name.data());
  if (fd < 0) return refuse(errno);
  ::unlink(name.c_str());
  if (const int error = posix_fallocate(fd, 0, static_cast<off_t>(n_bytes)); error != 0) {
    ::close(fd);
    return refuse(error);
  }
  void* address = ::mmap(nullptr, n_bytes, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  const int error = errno;
  if (address == MAP_FAILED) {
    ::close(fd);
    return refuse(error);
  }
  return ScratchMap(address, n_bytes, fd);
}

ScratchMap::~ScratchMap() {
  resident_ = ResidentMap();
  if (address_ != nullptr) ::munmap(address_, n_bytes_);
  if (fd_ >= 0) ::close(fd_);
}

bool ScratchMap::write(std::uint64_t offset, const void* from, std::uint64_t n_bytes) {
  assert(offset <= n_bytes_ && n_bytes <= n_bytes_ - offset);
  const auto* bytes = static_cast<const char*>(from);
  while (n_bytes > 0) {
    const ssize_t n = ::pwrite(fd_, bytes, n_bytes, static_cast<off_t>(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return false;
    bytes += n;
    offset += static_cast<std::uint64_t>(n);
    n_bytes -= static_cast<std::uint64_t>(n);
  }
  return true;
}

}  // namespace tind
