// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/duration.hpp"

#include <fmt/format.h>

#include <cmath>

namespace tind {

std::string duration_text(double seconds) {
  constexpr double kMostSeconds = 1000.0 * 86400;
  if (!(seconds < kMostSeconds)) return "years";
  const auto s = static_cast<long>(std::ceil(std::max(0.0, seconds)));
  if (s < 60) return fmt::format("{} s", s);
  if (s < 3600) return fmt::format("{} min {:02} s", s / 60, s % 60);
  if (s < 86400) return fmt::format("{} h {:02} min", s / 3600, s / 60 % 60);
  return fmt::format("{} d {} h", s / 86400, s / 3600 % 24);
}

}  // namespace tind
