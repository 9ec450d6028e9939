// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <string>

#include "core/format/bytes.hpp"

namespace tind {

/// Reads a quantized-mesh 1.0 tile without extensions as a client does and looks for what breaks one: counts, a number
/// of vertices of exactly 65,536, positions, indices, border lists that are empty or name vertices elsewhere, bytes
/// left over. Empty: nothing found. Pure, thread safe, safe for untrusted bytes.
std::string find_terrain_fault(ByteView tile, std::uint64_t n_triangles);

}  // namespace tind
