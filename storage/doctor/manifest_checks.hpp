// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "core/format/bytes.hpp"
#include "storage/doctor/fault.hpp"
#include "storage/manifest.hpp"

namespace tind {

/// Degrees that the tiles of a level with source posts span: west, south, east, north; nullopt: none.
using PostBox = std::optional<std::array<double, 4>>;

/// What docs/format.md 9 says of the manifest alone, beyond what decode_manifest() refuses. `json`: its text.
Faults check_manifest(const Manifest& manifest, ByteView json);

/// Whether the manifest says of a level what was counted in the file. `counted.rows` are the stored tiles.
Faults compare_level(const LevelInfo& said, const LevelInfo& counted);

/// Whether `bounds_deg` and the count of source posts fit the tiles of the deepest level.
Faults check_posts(const Manifest& manifest, std::uint64_t n_posts, const PostBox& box);

}  // namespace tind
