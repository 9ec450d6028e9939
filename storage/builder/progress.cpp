// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/progress.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>

#include "storage/builder/duration.hpp"

namespace tind {
namespace {

constexpr int kBarWidth = 24;
constexpr std::chrono::milliseconds kRenewal{100};
// Off a terminal a line is kept, so few are enough.
constexpr std::chrono::seconds kLinePeriod{60};
constexpr double kLeastFraction = 0.05, kPatience_s = 30;

// Before a twentieth is done an estimate is noise, but who waits for a day wants to know.
bool tells(double fraction, double elapsed_s) {
  return fraction > kLeastFraction || (elapsed_s > kPatience_s && fraction > kLeastFraction / 50);
}

}  // namespace

Progress::Progress(std::FILE* stream) : stream_(stream), is_terminal_(stream && isatty(fileno(stream))) {}

Progress::~Progress() { finish(); }

void Progress::clear_line() {
  if (line_open_) std::fputs("\r\033[K", stream_);
  line_open_ = false;
}

void Progress::update(double fraction, const std::string& stage) {
  fraction = std::clamp(fraction, 0.0, 1.0);
  const double elapsed_s = seconds_since(start_);
  const bool is_known = tells(fraction, elapsed_s);
  print(fraction, stage, is_known ? "ETA " + duration_text(elapsed_s * (1 - fraction) / fraction) : "ETA ...", "");
}

void Progress::update_stage(double fraction, const std::string& stage, double done) {
  if (stage != stage_) {
    stage_ = stage;
    stage_start_ = Clock::now();
  }
  const double elapsed_s = seconds_since(stage_start_);
  const bool is_known = tells(done, elapsed_s) && done < 1;
  print(fraction, stage, "ETA ...", is_known ? ", " + duration_text(elapsed_s * (1 - done) / done) + " more" : "");
}

void Progress::update_left(const std::string& stage, double left_s) {
  const double elapsed_s = seconds_since(start_);
  print(elapsed_s / std::max(elapsed_s + left_s, 1e-9), stage, "ETA " + duration_text(left_s), "");
}

void Progress::print(double fraction, const std::string& stage, const std::string& eta, const std::string& more) {
  if (!stream_) return;
  most_fraction_ = std::max(most_fraction_, std::clamp(fraction, 0.0, 1.0));
  const Clock::time_point now = Clock::now();
  const int percent = static_cast<int>(most_fraction_ * 100);
  if (is_terminal_) {
    if (now - last_print_ < kRenewal) return;
    last_print_ = now;
    const int filled = static_cast<int>(most_fraction_ * kBarWidth);
    clear_line();
    fmt::print(stream_, "[{}{}] {:3}%  {}  {}{}", std::string(static_cast<std::size_t>(filled), '#'),
               std::string(static_cast<std::size_t>(kBarWidth - filled), '.'), percent, eta, stage, more);
    std::fflush(stream_);
    line_open_ = true;
    return;
  }
  if (stage == printed_stage_ && now - last_print_ < kLinePeriod) return;
  last_print_ = now;
  printed_stage_ = stage;
  fmt::print(stream_, "{:3}%  {}  {}{}\n", percent, eta, stage, more);
  std::fflush(stream_);
}

void Progress::note(const std::string& line) {
  if (!stream_) return;
  clear_line();
  fmt::print(stream_, "{}\n", line);
}

void Progress::finish() {
  if (stream_) clear_line();
}

}  // namespace tind
