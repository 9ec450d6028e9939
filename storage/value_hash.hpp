// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>

#include "core/format/bytes.hpp"

namespace tind {

/// 64-bit XXH3 of the bytes: for tables in memory, entity tags, and inputs records (docs/format.md 5). Pure, thread
/// safe.
std::uint64_t value_hash(ByteView bytes);

}  // namespace tind
