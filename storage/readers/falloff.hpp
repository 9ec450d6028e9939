// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>

#include "storage/readers/void_fill.hpp"

namespace tind {

/// Gives every remaining void post its height: the nearest post that has one (Euclidean distance d in posts), pulled
/// linearly to the base height at d = falloff_posts, then kFalloffSweeps relaxation sweeps over these posts alone (data
/// and base stay), so that no cliff stands where the nearest post jumps. Posts at d >= falloff_posts are the base
/// exactly. Sets kFalloff or leaves kBase. Returns the number of kFalloff posts, the same posts for any number of
/// threads. Preconditions: falloff_posts >= 1, threads >= 1.
std::uint64_t add_falloff(PostGrid& grid, double base_height_m, std::int64_t falloff_posts, int threads = 1);

/// Relaxation sweeps of add_falloff: they spread a jump over some ten posts.
inline constexpr int kFalloffSweeps = 64;

}  // namespace tind
