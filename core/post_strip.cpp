// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/post_strip.hpp"

#include <cstdint>

// Vectors as arguments would be passed otherwise with wide registers than without: those functions leave no call.
#pragma GCC diagnostic ignored "-Wpsabi"

namespace tind {
namespace {

using Four = double __attribute__((vector_size(32)));
using FourFloats = float __attribute__((vector_size(16)));
using FourBits = std::int64_t __attribute__((vector_size(32)));

namespace narrow {
#include "core/post_strip_loops.inc"
}  // namespace narrow

#if defined(__x86_64__) && !defined(__clang__)
#pragma GCC push_options
#pragma GCC target("avx2")
namespace wide {
#include "core/post_strip_loops.inc"
}  // namespace wide
#pragma GCC pop_options
const bool kIsWide = __builtin_cpu_supports("avx2");
#else
namespace wide = narrow;
constexpr bool kIsWide = false;
#endif

}  // namespace

StripWorst worst_in_strip(const PostStrip& strip, const WidenedRows& triangle, const PlaneOverPosts& plane,
                          double least_m, Registers registers) {
  return kIsWide && registers == Registers::kWidest ? wide::worst_in_strip(strip, triangle, plane, least_m)
                                                    : narrow::worst_in_strip(strip, triangle, plane, least_m);
}

StripErrors errors_in_strip(const PostStrip& strip, const TriangleRows& triangle, const PlaneOverPosts& plane,
                            const SquareQuantum& quantum, Registers registers) {
  return kIsWide && registers == Registers::kWidest ? wide::errors_in_strip(strip, triangle, plane, quantum.anchor())
                                                    : narrow::errors_in_strip(strip, triangle, plane, quantum.anchor());
}

}  // namespace tind
