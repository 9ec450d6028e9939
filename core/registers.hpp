// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

// Before a function: it is compiled for wide registers, too, with all that is inlined into it, and the processor's best
// is chosen when the program starts. What it calls is not, nor are lambdas; a file of loops takes
// core/register_widths.inc. Sanitizers start too late for that choice.
#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(__clang__) && !defined(__SANITIZE_THREAD__) && \
    !defined(__SANITIZE_ADDRESS__)
#define TIND_WIDE __attribute__((target_clones("avx2", "default")))
#define TIND_WIDE_OR_MASKED __attribute__((target_clones("arch=x86-64-v4", "avx2", "default")))
#else
#define TIND_WIDE
#define TIND_WIDE_OR_MASKED
#endif

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
inline const bool kIsWide = kBestRegisters != Registers::kNarrow;

}  // namespace tind
