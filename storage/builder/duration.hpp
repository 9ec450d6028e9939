// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <chrono>
#include <string>

namespace tind {

/// A time span for people, in its two largest units: "8 s", "12 min 05 s", "3 h 20 min", "2 d 4 h". Parts of a second
/// count as one; negative spans and those beyond 1000 days are "0 s" and "years".
std::string duration_text(double seconds);

/// By the clock that never goes back.
inline double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

}  // namespace tind
