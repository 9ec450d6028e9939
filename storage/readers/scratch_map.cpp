// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/scratch_map.hpp"

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
  ::close(fd);
  if (address == MAP_FAILED) return refuse(error);
  return ScratchMap(address, n_bytes);
}

ScratchMap::~ScratchMap() {
  resident_ = ResidentMap();
  if (address_ != nullptr) ::munmap(address_, n_bytes_);
}

}  // namespace tind
