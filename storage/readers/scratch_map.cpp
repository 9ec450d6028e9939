// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/scratch_map.hpp"

#include <cerrno>
#include <cstring>
#include <limits>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>

namespace tind {

Result<ScratchMap> ScratchMap::create(const std::string& folder, std::uint64_t n_bytes) {
  const auto refuse = [&](int error) {
    const char* hint = error == ENOSPC || error == EFBIG || error == EDQUOT
                           ? "; free some space there, or write the output to another disk"
                           : "";
    return fail(ErrorKind::kIo,
                fmt::format("{}: cannot make a scratch file of {} MB for the posts: {}{}",
                            folder.empty() ? "." : folder, (n_bytes >> 20) + 1, std::strerror(error), hint));
  };
  if (n_bytes > static_cast<std::uint64_t>(std::numeric_limits<off_t>::max())) return refuse(EFBIG);
  auto file = ScratchFile::create(folder);
  if (!file) return tl::unexpected(file.error());
  const int fd = file->descriptor();
  if (const int error = posix_fallocate(fd, 0, static_cast<off_t>(n_bytes)); error != 0) return refuse(error);
  void* address = ::mmap(nullptr, n_bytes, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  if (address == MAP_FAILED) return refuse(errno);
  return ScratchMap(address, n_bytes, std::move(*file));
}

Result<ScratchMap> ScratchMap::in_memory(std::uint64_t n_bytes, bool huge_pages) {
  void* address = ::mmap(nullptr, n_bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (address == MAP_FAILED) {
    return fail(ErrorKind::kIo, fmt::format("no memory for {} MB of posts: {}; give less with --memory",
                                            (n_bytes >> 20) + 1, std::strerror(errno)));
  }
  if (huge_pages) ::madvise(address, n_bytes, MADV_HUGEPAGE);  // or small ones, where there are none
  return ScratchMap(address, n_bytes);
}

ScratchMap::~ScratchMap() {
  resident_ = ResidentMap();
  if (address_ != nullptr) ::munmap(address_, n_bytes_);
}

Result<ScratchMap> ScratchPlace::make(std::uint64_t n_bytes) {
  if (n_bytes > memory_bytes) return ScratchMap::create(folder, n_bytes);
  memory_bytes -= n_bytes;
  return ScratchMap::in_memory(n_bytes, true);
}

}  // namespace tind
