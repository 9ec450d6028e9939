// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>

namespace tind {

/// Coarse time: a count of equal steps.
using Tick = std::int64_t;

/// A place in a TimerWheel; whoever wants to be woken derives from it.
class TimerEntry {
 public:
  TimerEntry() = default;
  TimerEntry(const TimerEntry&) = delete;
  TimerEntry& operator=(const TimerEntry&) = delete;

 private:
  friend class TimerWheel;
  TimerEntry* before_ = nullptr;
  TimerEntry* after_ = nullptr;
  Tick at_ = 0;
};

/// Wakes entries at their time. Setting, moving and taking out cost the same however many there are, and a tick costs
/// by those that are due (and by those that are due whole turns later: each is looked at once a turn). One thread.
/// Entries must be taken out before they end.
class TimerWheel {
 public:
  explicit TimerWheel(Tick now) : now_(now) {
    for (TimerEntry& head : slots_) head.before_ = head.after_ = &head;
  }

  /// Puts the entry in, or moves it. A time that has come already is the next tick's.
  void set(TimerEntry& entry, Tick at) {
    cancel(entry);
    entry.at_ = at > now_ ? at : now_ + 1;
    TimerEntry& head = slots_[static_cast<std::size_t>(entry.at_) % kSlots];
    entry.before_ = head.before_;
    entry.after_ = &head;
    head.before_->after_ = &entry;
    head.before_ = &entry;
  }
  /// Takes the entry out, if it is in.
  static void cancel(TimerEntry& entry) {
    if (!entry.after_) return;
    entry.before_->after_ = entry.after_;
    entry.after_->before_ = entry.before_;
    entry.before_ = entry.after_ = nullptr;
  }
  /// Time passes: takes out every entry that is due and calls wake(entry), which may set and cancel entries.
  template <class Wake>
  void advance(Tick now, Wake&& wake) {
    while (now_ < now) {
      ++now_;
      TimerEntry& head = slots_[static_cast<std::size_t>(now_) % kSlots];
      // Taken out as a whole first: what wake() sets must not be met again.
      TimerEntry due;
      due.before_ = due.after_ = &due;
      for (TimerEntry* entry = head.after_; entry != &head;) {
        TimerEntry* const next = entry->after_;
        if (entry->at_ <= now_) {
          cancel(*entry);
          entry->before_ = due.before_;
          entry->after_ = &due;
          due.before_->after_ = entry;
          due.before_ = entry;
        }
        entry = next;
      }
      while (due.after_ != &due) {
        TimerEntry& entry = *due.after_;
        cancel(entry);
        wake(entry);
      }
    }
  }

 private:
  static constexpr std::size_t kSlots = 256;
  std::array<TimerEntry, kSlots> slots_;
  Tick now_;
};

}  // namespace tind
