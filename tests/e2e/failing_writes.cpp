// SPDX-License-Identifier: GPL-3.0-or-later
// Loaded before a program (LD_PRELOAD): from the TIND_FAIL_AFTER-th write or sync of a file on, all of them fail with
// EIO, as on a broken disk.
#include <dlfcn.h>
#include <sys/uio.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdlib>

namespace {

bool broken() {
  static const long limit = [] {
    const char* text = std::getenv("TIND_FAIL_AFTER");
    return text ? std::strtol(text, nullptr, 10) : 0;
  }();
  static std::atomic<long> n{0};
  if (limit <= 0 || ++n < limit) return false;
  errno = EIO;
  return true;
}

template <class F>
F next(const char* name) {
  return reinterpret_cast<F>(dlsym(RTLD_NEXT, name));
}

}  // namespace

extern "C" {

ssize_t pwrite(int fd, const void* data, size_t n, off_t at) {
  static const auto real = next<ssize_t (*)(int, const void*, size_t, off_t)>("pwrite");
  return broken() ? -1 : real(fd, data, n, at);
}
ssize_t pwrite64(int fd, const void* data, size_t n, off64_t at) {
  static const auto real = next<ssize_t (*)(int, const void*, size_t, off64_t)>("pwrite64");
  return broken() ? -1 : real(fd, data, n, at);
}
ssize_t writev(int fd, const iovec* parts, int n) {
  static const auto real = next<ssize_t (*)(int, const iovec*, int)>("writev");
  return broken() ? -1 : real(fd, parts, n);
}
ssize_t pwritev(int fd, const iovec* parts, int n, off_t at) {
  static const auto real = next<ssize_t (*)(int, const iovec*, int, off_t)>("pwritev");
  return broken() ? -1 : real(fd, parts, n, at);
}
int fdatasync(int fd) {
  static const auto real = next<int (*)(int)>("fdatasync");
  return broken() ? -1 : real(fd);
}
int fsync(int fd) {
  static const auto real = next<int (*)(int)>("fsync");
  return broken() ? -1 : real(fd);
}

}  // extern "C"
