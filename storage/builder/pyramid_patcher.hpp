// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <optional>

#include "core/border_line.hpp"
#include "core/result.hpp"
#include "storage/builder/plan.hpp"
#include "storage/builder/progress.hpp"
#include "storage/builder/pyramid_builder.hpp"
#include "storage/builder/tile_digest.hpp"
#include "storage/tile_store.hpp"

namespace tind {

/// build_levels where few posts differ from those that `input.earlier` was made of: makes the pieces that they reach,
/// and copies all others (docs/decisions/0013 tells which those are, and why). The bytes are those of the whole way.
/// nullopt, and nothing is written: the whole way is to be gone, as lines, levels or many tiles may be other ones.
/// Precondition: input.earlier was checked. kIo, kInterrupted, kCorrupt.
Result<std::optional<PyramidOutcome>> patch_levels(const PyramidInput& input, const TilePlan& plan,
                                                   const RefinementSpec& spec, const PostDigests& posts,
                                                   TileStoreWriter& writer, Progress& progress);

}  // namespace tind
