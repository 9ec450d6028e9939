// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/resident_limit.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>

#include <fcntl.h>
#include <unistd.h>

namespace tind {
namespace {

constexpr std::uint64_t kLeastPauseMs = 1, kMostPauseMs = 20;

struct Resident {
  std::uint64_t all = 0, of_files = 0;  // bytes
};

std::optional<Resident> read_resident() {
  static const int fd = ::open("/proc/self/statm", O_RDONLY | O_CLOEXEC);  // to open it takes longer than to read it
  if (fd < 0) return std::nullopt;
  std::array<char, 256> text{};
  const ssize_t n = ::pread(fd, text.data(), text.size(), 0);
  if (n <= 0) return std::nullopt;
  // Pages: size, resident, shared, ...
  std::array<std::uint64_t, 3> pages{};
  const char *at = text.data(), *const line_end = text.data() + n;
  for (std::uint64_t& value : pages) {
    while (at != line_end && *at == ' ') ++at;
    const auto [end, error] = std::from_chars(at, line_end, value);
    if (error != std::errc()) return std::nullopt;
    at = end;
  }
  const auto page = static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
  return Resident{pages[1] * page, pages[2] * page};
}

}  // namespace

std::optional<std::uint64_t> resident_bytes() {
  const auto resident = read_resident();
  return resident ? std::optional(resident->all) : std::nullopt;
}

ResidentLimit::ResidentLimit(std::uint64_t limit_bytes, std::uint64_t most_bytes_per_ms)
    : limit_bytes_(limit_bytes),
      most_bytes_per_ms_(std::max<std::uint64_t>(most_bytes_per_ms, 1)),
      threshold_(limit_bytes),
      thread_([this] { run(); }) {}

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

void ResidentLimit::enforce() {
  const auto now_ns = [] { return std::chrono::steady_clock::now().time_since_epoch() / std::chrono::nanoseconds(1); };
  if (now_ns() < next_look_ns_.load(std::memory_order_relaxed)) return;
  const std::uint64_t room = room_after_release();
  // A fault brings in sixteen pages and more, on every thread: faster than anybody reads them.
  constexpr std::uint64_t kMostBytesPerNs = 128;
  constexpr std::uint64_t kMostNs = kMostPauseMs * 1000000;
  next_look_ns_ = now_ns() + static_cast<std::int64_t>(std::min(room / kMostBytesPerNs, kMostNs));
}

// Drops maps where the limit is reached; returns how much may come in before it is again.
std::uint64_t ResidentLimit::room_after_release() {
  const std::scoped_lock lock(release_mutex_);
  Resident now = read_resident().value_or(Resident{});
  if (now.all >= threshold_) {
    release_resident_maps();
    now = read_resident().value_or(Resident{});
    // What came into maps meanwhile must not raise the threshold, memory that cannot be dropped must.
    least_other_bytes_ = std::min(least_other_bytes_, now.of_files);
    threshold_ = std::max(limit_bytes_, now.all - now.of_files + least_other_bytes_ + kLeastRoom);
    const std::scoped_lock count_lock(mutex_);
    ++n_releases_;
  }
  return threshold_ > now.all ? threshold_ - now.all : 0;
}

void ResidentLimit::run() {
  std::unique_lock lock(mutex_);
  while (!ended_) {
    lock.unlock();
    const std::uint64_t room = room_after_release();
    const std::chrono::milliseconds pause(std::clamp(room / most_bytes_per_ms_, kLeastPauseMs, kMostPauseMs));
    lock.lock();
    wake_.wait_for(lock, pause, [this] { return ended_; });
  }
}

}  // namespace tind
