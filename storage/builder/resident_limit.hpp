// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <optional>
#include <thread>

#include "storage/readers/resident_maps.hpp"

namespace tind {

/// Memory of this process that is resident now, in bytes, its share of mapped files included (what the system calls
/// RSS, and whose peak it calls VmHWM); nullopt where /proc does not say.
std::optional<std::uint64_t> resident_bytes();

/// While it lives, a thread keeps the resident memory of this process near a limit by dropping the pages of the maps
/// that are named by a ResidentMap (every ScratchMap is). They come back when they are needed, from the page cache as a
/// rule. Memory that is no such map cannot be dropped: where that alone is beyond the limit, maps get some room
/// (kLeastRoom) on top of it.
class ResidentLimit {
 public:
  /// What maps may take at least before they are dropped again.
  static constexpr std::uint64_t kLeastRoom = std::uint64_t{32} << 20;

  /// Of threads that read memory at full speed.
  static constexpr std::uint64_t kFullSpeed = std::uint64_t{32} << 20;

  /// `most_bytes_per_ms`: how fast pages come in at most, that is, how soon the limit may be reached. The slower, the
  /// fewer looks at the memory, which take a processor some 30 microseconds each, up to a thousand a second.
  explicit ResidentLimit(std::uint64_t limit_bytes, std::uint64_t most_bytes_per_ms = kFullSpeed);
  ResidentLimit(const ResidentLimit&) = delete;
  ResidentLimit& operator=(const ResidentLimit&) = delete;
  /// Ends the thread.
  ~ResidentLimit();

  /// Drops maps at once if the limit is reached: for threads that are about to bring in many pages. Looks no sooner
  /// than the room that was left at the last look can be full, so it may be called as often as one likes. Thread safe.
  void enforce();

  /// How often maps were dropped so far.
  std::uint64_t n_releases() const;

 private:
  void run();
  std::uint64_t room_after_release();

  const std::uint64_t limit_bytes_, most_bytes_per_ms_;
  std::mutex release_mutex_;
  std::uint64_t threshold_;                       // where maps are dropped next
  std::uint64_t least_other_bytes_ = UINT64_MAX;  // file pages that were left after a release, at least
  std::atomic<std::int64_t> next_look_ns_{0};     // of steady_clock, for those who call enforce()
  mutable std::mutex mutex_;
  std::condition_variable wake_;
  bool ended_ = false;
  std::uint64_t n_releases_ = 0;
  std::thread thread_;
};

}  // namespace tind
