// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <functional>
#include <span>

#include "core/format/bytes.hpp"
#include "core/result.hpp"

namespace tind {

/// Most bytes that a stored zstd frame may announce (docs/format.md 2).
inline constexpr std::uint64_t kMaxRecordBytes = std::uint64_t{256} << 20;

/// True iff the bytes start with zstd's frame magic.
bool is_zstd_frame(ByteView bytes);

/// One zstd frame with content size, window log <= 23 and no dictionary. `level` 1..19. Thread safe.
Bytes zstd_compress(ByteView bytes, int level);

/// The shorter of the bytes themselves and their zstd frame: a value as docs/format.md 2 has it, made for storing
/// (docs/decisions/0012-compression.md). `section_ends`: ascending places inside the record where one kind of numbers
/// ends and another begins; zstd then codes each kind by its own statistics. Thread safe.
Bytes pack_value(Bytes record, std::span<const std::size_t> section_ends = {});

/// The record in a stored value: decompressed when it is a zstd frame, else as it is (copied).
/// Fails with kCorrupt on anything broken or larger than kMaxRecordBytes. Safe for untrusted input.
Result<Bytes> unpack_value(ByteView value);

/// Asked with the record's bytes so far and the size that the whole record has: are these enough?
using EnoughBytes = std::function<bool(ByteView so_far, std::uint64_t record_bytes)>;

/// The start of the record in a stored value: unpacked block by block until `enough` says so, else all of it. A value
/// that is no frame is copied unasked. What
/// follows is not looked at, so damage there is not seen. Fails as unpack_value does. `enough` must not unpack on its
/// own.
Result<Bytes> unpack_start(ByteView value, const EnoughBytes& enough);

}  // namespace tind
