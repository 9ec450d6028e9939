// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <optional>
#include <string>

#include "core/border_line.hpp"
#include "core/result.hpp"
#include "storage/builder/plan.hpp"
#include "storage/builder/progress.hpp"
#include "storage/builder/pyramid_builder.hpp"
#include "storage/builder/tile_digest.hpp"

namespace tind {

/// build_levels where few posts differ from those that `input.earlier` was made of: makes the pieces that they reach,
/// and leaves all others to be copied (docs/decisions/0013 tells which those are, and why): PyramidOutcome::patched has
/// them. `path`: where they will be stored. The bytes are those of the whole way. nullopt: the whole way is to be gone,
/// as lines, levels or many tiles may be other ones. Precondition: input.earlier was checked. kIo, kInterrupted,
/// kCorrupt.
Result<std::optional<PyramidOutcome>> patch_levels(const PyramidInput& input, const TilePlan& plan,
                                                   const RefinementSpec& spec, const PostDigests& posts,
                                                   const std::string& path, Progress& progress);

}  // namespace tind
