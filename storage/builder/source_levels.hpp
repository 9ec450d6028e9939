// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "core/level_spec.hpp"
#include "core/result.hpp"
#include "storage/builder/build.hpp"
#include "storage/builder/elevation_source.hpp"

namespace tind {

/// The level table that a build of this source with these options has. kInvalidInput as make_level_table().
Result<LevelTable> make_source_levels(const ElevationSource& source, const BuildOptions& options);

}  // namespace tind
