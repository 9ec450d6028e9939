// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

namespace tind {

/// How long a build's levels will still take, by how long those before took: the work on a level goes with its posts,
/// which are the same on all, and with its vertices, which grow by a factor that depends on the data. One thread.
class LevelTimes {
 public:
  /// `n_levels` >= 1.
  explicit LevelTimes(int n_levels) : n_left_(n_levels) {}

  /// The level in progress took so long; the next one begins.
  void finish_level(double seconds);
  /// Seconds that all levels will take from now on, when `done` (0..1) of the level in progress is done after so many
  /// seconds.
  double left(double done, double seconds) const;

 private:
  int n_left_;           // with the level in progress
  double last_s_ = 0;    // what the level before took
  double growth_ = 1.6;  // what a level takes to the one before
};

}  // namespace tind
