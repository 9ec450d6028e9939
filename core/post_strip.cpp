// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/post_strip.hpp"

#include <cstdint>

// Vectors as arguments would be passed otherwise with wide registers than without: those functions leave no call.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace tind {
namespace {

using FourBits = std::int64_t __attribute__((vector_size(32)));

#define TIND_LOOPS "core/post_strip_loops.inc"
#include "core/register_widths.inc"

}  // namespace

StripWorst worst_in_strip(const PostStrip& strip, const WidenedRows& triangle, const PlaneOverPosts& plane,
                          double least_m, Registers registers) {
  switch (registers) {
    case Registers::kMasked:
      return masked::worst_in_strip(strip, triangle, plane, least_m);
    case Registers::kWide:
      return wide::worst_in_strip(strip, triangle, plane, least_m);
    case Registers::kNarrow:
      break;
  }
  return narrow::worst_in_strip(strip, triangle, plane, least_m);
}

StripErrors errors_in_strip(const PostStrip& strip, const TriangleRows& triangle, const PlaneOverPosts& plane,
                            const SquareQuantum& quantum, Registers registers) {
  switch (registers) {
    case Registers::kMasked:
      return masked::errors_in_strip(strip, triangle, plane, quantum.anchor());
    case Registers::kWide:
      return wide::errors_in_strip(strip, triangle, plane, quantum.anchor());
    case Registers::kNarrow:
      break;
  }
  return narrow::errors_in_strip(strip, triangle, plane, quantum.anchor());
}

}  // namespace tind
