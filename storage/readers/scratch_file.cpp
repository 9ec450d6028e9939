// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/scratch_file.hpp"

#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <fmt/format.h>
#include <stdlib.h>
#include <unistd.h>

namespace tind {

Result<ScratchFile> ScratchFile::create(const std::string& folder) {
  const std::string where = folder.empty() ? "." : folder;
  std::string name = where + "/.tind-scratch-XXXXXX";
  const int fd = mkostemp(name.data(), O_CLOEXEC);
  if (fd < 0) return fail(ErrorKind::kIo, fmt::format("{}: cannot make a scratch file: {}", where, strerror(errno)));
  ::unlink(name.c_str());
  return ScratchFile(fd);
}

ScratchFile::~ScratchFile() {
  if (fd_ >= 0) ::close(fd_);
}

bool ScratchFile::write(std::uint64_t offset, const void* from, std::uint64_t n_bytes) {
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

bool ScratchFile::read(std::uint64_t offset, void* to, std::uint64_t n_bytes) const {
  auto* bytes = static_cast<char*>(to);
  while (n_bytes > 0) {
    const ssize_t n = ::pread(fd_, bytes, n_bytes, static_cast<off_t>(offset));
    if (n < 0 && errno == EINTR) continue;
    if (n == 0) errno = ENODATA;
    if (n <= 0) return false;
    bytes += n;
    offset += static_cast<std::uint64_t>(n);
    n_bytes -= static_cast<std::uint64_t>(n);
  }
  return true;
}

void ScratchFile::free_space(std::uint64_t offset, std::uint64_t n_bytes) {
  ::fallocate(fd_, FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE, static_cast<off_t>(offset), static_cast<off_t>(n_bytes));
}

}  // namespace tind
