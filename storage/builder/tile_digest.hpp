// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "core/border_line.hpp"
#include "core/triangulator.hpp"

namespace tind {

/// Digest of everything that shapes a tile's body: its posts (with one more all around, as coverage and bilinear
/// samples see them), its borders with all finer vertices (so envelopes and runs), the vertices to start from, break
/// lines and their heights, tolerances, and the version of the builder. `n_gaps`: finer levels. Pure; thread safe.
std::array<std::uint8_t, 16> tile_digest(const HeightField& field, const TileTask& task,
                                         const std::array<std::span<const LineVertex>, 4>& borders, int n_gaps);

}  // namespace tind
