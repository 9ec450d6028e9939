// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "core/height_field.hpp"
#include "core/level_spec.hpp"

namespace tind {

/// About how many vertices the bottom level takes without break lines: a few of its tiles, triangulated alone. At least
/// 1; the same for any number of threads.
double estimate_bottom_vertices(const HeightField& field, const LevelTable& table, int threads);

}  // namespace tind
