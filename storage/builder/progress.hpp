// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <chrono>
#include <cstdio>
#include <string>

namespace tind {

/// Tells a person how far long work is: one line that renews itself with a bar and an ETA on a terminal, plain lines
/// (one a minute, and one per stage) otherwise. One thread.
class Progress {
 public:
  /// Writes to `stream`, or nowhere when it is null.
  explicit Progress(std::FILE* stream);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// `fraction` of all work done, in [0, 1], never falling; `stage`: what is being done now. The ETA is by the
  /// fraction.
  void update(double fraction, const std::string& stage);
  /// Same where nothing is known of the work after this stage: it began at the first call that named it, and `done` of
  /// it is done.
  void update_stage(double fraction, const std::string& stage, double done);
  /// Same where it is known how many seconds all work will take from now on.
  void update_left(const std::string& stage, double left_s);
  /// Ends the line.
  void finish();
  /// A line for the user between updates.
  void note(const std::string& line);

 private:
  using Clock = std::chrono::steady_clock;
  void clear_line();
  void print(double fraction, const std::string& stage, const std::string& eta, const std::string& more);

  std::FILE* stream_;
  bool is_terminal_ = false;
  bool line_open_ = false;
  std::string printed_stage_;
  std::string stage_;  // of update_stage
  Clock::time_point stage_start_{};
  double most_fraction_ = 0;
  Clock::time_point start_ = Clock::now();
  Clock::time_point last_print_{};
};

}  // namespace tind
