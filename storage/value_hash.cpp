// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/value_hash.hpp"

#include <xxhash.h>

namespace tind {

std::uint64_t value_hash(ByteView bytes) { return XXH3_64bits(bytes.data(), bytes.size()); }

}  // namespace tind
