// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/resident_limit.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <string_view>

#include <fcntl.h>
#include <unistd.h>

namespace tind {
namespace {

/// Pages come in no faster than this, threads reading memory at full speed: how soon the limit may be reached.
constexpr std::uint64_t kMostBytesPerMs = std::uint64_t{32} << 20;
constexpr std::uint64_t kLeastPauseMs = 1, kMostPauseMs = 20;

}  // namespace

std::optional<std::uint64_t> resident_bytes() {
  const int fd = ::open("/proc/self/statm", O_RDONLY | O_CLOEXEC);
  if (fd < 0) return std::nullopt;
  std::array<char, 256> text{};
  const ssize_t n = ::read(fd, text.data(), text.size());
  ::close(fd);
  if (n <= 0) return std::nullopt;
  // Pages: size, resident, shared, ...
  const std::string_view line(text.data(), static_cast<std::size_t>(n));
  const std::size_t space = line.find(' ');
  std::uint64_t pages = 0;
  if (space == std::string_view::npos) return std::nullopt;
  const auto [end, error] = std::from_chars(line.data() + space + 1, line.data() + line.size(), pages);
  if (error != std::errc()) return std::nullopt;
  return pages * static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
}

ResidentLimit::ResidentLimit(std::uint64_t limit_bytes) : limit_bytes_(limit_bytes), thread_([this] { run(); }) {}

ResidentLimit::~ResidentLimit() {
  {
    const std::scoped_lock lock(mutex_);
    ended_ = true;
  }
  wake_.notify_one();
  thread_.join();
}

std::uint64_t ResidentLimit::n_releases() const {
  const std::scoped_lock lock(mutex_);
  return n_releases_;
}

void ResidentLimit::run() {
  std::uint64_t threshold = limit_bytes_;
  std::unique_lock lock(mutex_);
  while (!ended_) {
    lock.unlock();
    const std::uint64_t resident = resident_bytes().value_or(0);
    const bool release = resident >= threshold;
    std::uint64_t now = resident;
    if (release) {
      release_resident_maps();
      now = resident_bytes().value_or(0);
      threshold = std::max(limit_bytes_, now + kLeastRoom);
    }
    const std::uint64_t room = threshold > now ? threshold - now : 0;
    const std::chrono::milliseconds pause(std::clamp(room / kMostBytesPerMs, kLeastPauseMs, kMostPauseMs));
    lock.lock();
    n_releases_ += release ? 1 : 0;
    wake_.wait_for(lock, pause, [this] { return ended_; });
  }
}

}  // namespace tind
