// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/progress.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>

namespace tind {
namespace {

constexpr int kBarWidth = 24;
constexpr std::chrono::milliseconds kRenewal{100};

std::string duration(double seconds) {
  const auto s = static_cast<long>(std::ceil(seconds));
  if (s < 60) return fmt::format("{} s", s);
  if (s < 3600) return fmt::format("{} min {:02} s", s / 60, s % 60);
  return fmt::format("{} h {:02} min", s / 3600, s / 60 % 60);
}

}  // namespace

Progress::Progress(std::FILE* stream) : stream_(stream), is_terminal_(stream && isatty(fileno(stream))) {}

Progress::~Progress() { finish(); }

void Progress::clear_line() {
  if (line_open_) std::fputs("\r\033[K", stream_);
  line_open_ = false;
}

void Progress::update(double fraction, const std::string& stage) {
  if (!stream_) return;
  fraction = std::clamp(fraction, 0.0, 1.0);
  const Clock::time_point now = Clock::now();
  const double elapsed_s = std::chrono::duration<double>(now - start_).count();
  // Before a twentieth is done an estimate is noise.
  const std::string eta =
      fraction > 0.05 ? fmt::format("ETA {}", duration(elapsed_s * (1 - fraction) / fraction)) : std::string("ETA ...");
  const int percent = static_cast<int>(fraction * 100);
  if (is_terminal_) {
    if (now - last_print_ < kRenewal) return;
    last_print_ = now;
    const int filled = static_cast<int>(fraction * kBarWidth);
    clear_line();
    fmt::print(stream_, "[{}{}] {:3}%  {}  {}", std::string(static_cast<std::size_t>(filled), '#'),
               std::string(static_cast<std::size_t>(kBarWidth - filled), '.'), percent, eta, stage);
    std::fflush(stream_);
    line_open_ = true;
    return;
  }
  const int tenths = percent / 10;
  if (tenths == printed_tenths_ && stage == printed_stage_) return;
  printed_tenths_ = tenths;
  printed_stage_ = stage;
  fmt::print(stream_, "{:3}%  {}  {}\n", percent, eta, stage);
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
