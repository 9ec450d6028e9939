// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/level_times.hpp"

#include <algorithm>

namespace tind {
namespace {

// Levels that take less tell nothing of the next.
constexpr double kTelling_s = 0.05;
// Half as many vertices a level coarser is the usual; posts alone make levels alike.
constexpr double kLeastGrowth = 1, kMostGrowth = 1.75;

}  // namespace

void LevelTimes::finish_level(double seconds) {
  if (last_s_ > kTelling_s) growth_ = (growth_ + std::clamp(seconds / last_s_, kLeastGrowth, kMostGrowth)) / 2;
  last_s_ = seconds;
  n_left_ = std::max(n_left_ - 1, 0);
}

double LevelTimes::left(double done, double seconds) const {
  if (n_left_ == 0) return 0;
  // What is done tells of the rest of the level the more, the more it is.
  const double before = std::max(last_s_ * growth_, seconds), share = std::clamp(done, 0.0, 1.0);
  const double whole_s = share > 0 ? seconds + (1 - share) * before : before;
  double left_s = (1 - share) * whole_s, level_s = share * seconds + (1 - share) * whole_s;
  level_s = std::max(level_s, seconds);
  for (int k = 1; k < n_left_; ++k) {
    level_s *= growth_;
    left_s += level_s;
  }
  return left_s;
}

}  // namespace tind
