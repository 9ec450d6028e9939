// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

namespace tind {

/// The registers that a loop uses; all give the same bytes. kWide: those of AVX2. kMasked: the same of AVX-512VL, whose
/// comparisons are masks.
enum class Registers { kNarrow, kWide, kMasked };

/// The last of them that this processor has.
inline Registers best_registers() {
#if defined(__x86_64__) && !defined(__clang__)
  if (__builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq")) return Registers::kMasked;
  if (__builtin_cpu_supports("avx2")) return Registers::kWide;
#endif
  return Registers::kNarrow;
}
inline const Registers kBestRegisters = best_registers();

}  // namespace tind
