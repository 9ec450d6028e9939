// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/timer_wheel.hpp"

#include <gtest/gtest.h>

#include <map>
#include <memory>
#include <random>
#include <vector>

namespace tind {
namespace {

struct Alarm : TimerEntry {
  Tick at = 0;
};

TEST(TimerWheel, WakesEachEntryAtItsTimeOnce) {
  TimerWheel wheel(100);
  std::mt19937 random(1);
  std::vector<std::unique_ptr<Alarm>> alarms;
  for (int k = 0; k < 2000; ++k) {
    alarms.push_back(std::make_unique<Alarm>());
    alarms.back()->at = 101 + static_cast<Tick>(random() % 1000);  // several turns of the wheel
    wheel.set(*alarms.back(), alarms.back()->at);
  }
  std::map<const TimerEntry*, int> woken;
  for (Tick now = 101; now <= 1200; now += 1 + static_cast<Tick>(random() % 3)) {
    wheel.advance(now, [&](TimerEntry& entry) {
      const Tick at = static_cast<Alarm&>(entry).at;
      EXPECT_LE(at, now);
      EXPECT_GT(at, now - 4);
      ++woken[&entry];
    });
  }
  wheel.advance(1300, [&](TimerEntry& entry) { ++woken[&entry]; });
  EXPECT_EQ(woken.size(), alarms.size());
  for (const auto& [entry, n] : woken) EXPECT_EQ(n, 1);
}

TEST(TimerWheel, EntriesMoveAndLeave) {
  TimerWheel wheel(0);
  Alarm early, late, gone;
  std::vector<const TimerEntry*> woken;
  const auto note = [&](TimerEntry& entry) { woken.push_back(&entry); };
  wheel.set(early, 5);
  wheel.set(late, 5);
  wheel.set(gone, 5);
  wheel.set(late, 300);
  TimerWheel::cancel(gone);
  TimerWheel::cancel(gone);
  wheel.advance(299, note);
  EXPECT_EQ(woken, (std::vector<const TimerEntry*>{&early}));
  wheel.advance(300, note);
  EXPECT_EQ(woken.size(), 2u);
  wheel.set(early, 7);  // a time that has passed
  wheel.advance(301, note);
  EXPECT_EQ(woken.size(), 3u);
}

TEST(TimerWheel, WakingMaySetAndCancelOthers) {
  TimerWheel wheel(0);
  Alarm a, b;
  int n = 0;
  wheel.set(a, 1);
  wheel.set(b, 1);
  wheel.advance(1, [&](TimerEntry& entry) {
    ++n;
    TimerWheel::cancel(&entry == &a ? b : a);
    wheel.set(entry, 1);  // the next tick's, not met again in this one
  });
  EXPECT_EQ(n, 1);
  wheel.advance(2, [&](TimerEntry&) { ++n; });
  EXPECT_EQ(n, 2);
}

}  // namespace
}  // namespace tind
