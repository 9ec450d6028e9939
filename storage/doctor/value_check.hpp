// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "core/format/bytes.hpp"
#include "core/result.hpp"

namespace tind {

/// The record in a stored value, which must be as docs/format.md 2 says: a record, or exactly one zstd frame with its
/// content size, a window log <= 23 and no dictionary. kCorrupt with the reason. Safe for untrusted input.
Result<Bytes> unpack_strictly(ByteView value);

}  // namespace tind
