// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "core/format/bytes.hpp"
#include "core/result.hpp"

namespace tind {

/// Most bytes that a stored zstd frame may announce (docs/format.md 2).
inline constexpr std::uint64_t kMaxRecordBytes = std::uint64_t{256} << 20;

/// True iff the bytes start with zstd's frame magic.
bool is_zstd_frame(ByteView bytes);

/// One zstd frame with content size, window log <= 23 and no dictionary. `level` 1..19. Thread safe.
Bytes zstd_compress(ByteView bytes, int level);

/// The shorter of the bytes themselves and their zstd frame: a value as docs/format.md 2 has it.
Bytes pack_value(Bytes record);

/// The record in a stored value: decompressed when it is a zstd frame, else as it is (copied).
/// Fails with kCorrupt on anything broken or larger than kMaxRecordBytes. Safe for untrusted input.
Result<Bytes> unpack_value(ByteView value);

}  // namespace tind
