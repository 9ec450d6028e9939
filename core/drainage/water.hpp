// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "core/drainage/flow_grid.hpp"
#include "core/drainage/flow_run.hpp"

namespace tind {

/// Total area of connected posts at or below 0 m from which on they are the sea: the world's oceans, not Death Valley.
inline constexpr double kSeaAreaM2 = 1e11;
/// Fewest core posts of a lake or posts of a basin: fewer are noise of a level surface.
inline constexpr std::int64_t kLakePosts = 64;
/// Largest share of a lake's rim that may be lower than it. In heights of whole metres a plain is made of flats, too,
/// but those are bands: about half of their rim is lower (docs/decisions/0007-drainage.md).
inline constexpr double kLakeLowerRim = 0.0625;

/// Neighbouring posts of a row: indices [begin, end).
struct PostRun {
  std::int64_t begin = 0, end = 0;
};

/// A level stretch of water: posts of exactly one height.
struct Lake {
  std::int64_t root = 0;  ///< The first post (in index order) of the flat that the lake is part of.
  double height_m = 0;
  double core_area_m2 = 0;  ///< Area of the posts whose eight neighbours have their height, too.
  std::int64_t core_posts = 0;
  std::int64_t rim = 0;        ///< Steps along rows and columns from the flat to other posts.
  std::int64_t lower_rim = 0;  ///< Of those, downwards.
  std::vector<PostRun> runs;   ///< The flat, in no particular order.
};

/// Sets kSea. Without `sea_level_m`: the 4-connected posts at or below 0 m, if these bodies have kSeaAreaM2 or more
/// each. With it: every post at or below it. Returns the number of sea posts.
/// Uses kInFlat on its way, as the next two do, and clears it.
std::int64_t mark_sea(const FlowGrid& grid, std::optional<double> sea_level_m, const FlowRun& run = {});

/// Sets kLake and returns the lakes in ascending order of `root`. A lake is part of a flat (4-connected posts of the
/// source of exactly equal height, in the sea only at `sea_level_m`: all else there is its floor): its core, the posts
/// whose eight neighbours belong to it, and their neighbours; the core has at least `min_area_m2` and kLakePosts posts,
/// and at most kLakeLowerRim of the flat's rim is lower. Uses kBasin on its way and clears it.
std::vector<Lake> mark_lakes(const FlowGrid& grid, double min_area_m2, double sea_level_m, const FlowRun& run = {});

/// Sets kBasin on 4-connected posts that filling raised by more than `max_depth_m`, where such a piece has at least
/// `min_area_m2` and kLakePosts posts: no noise but a basin of its own. Returns the number of posts.
std::int64_t mark_basins(const FlowGrid& grid, const float* filled_m, double max_depth_m, double min_area_m2,
                         const FlowRun& run = {});

/// One stretch of shore, as posts.
struct ShoreLine {
  std::size_t lake = 0;             ///< Its index.
  std::vector<std::int64_t> posts;  ///< Indices; neighbours are one step along a row or column apart. A ring repeats
                                    ///< its first. The lake lies to the left.
};

/// The shores of the lakes: the rim of the squares between posts of which all four corners are posts of one lake (each
/// post of a lake is a corner of one; a post with a neighbour that is not of the lake lies on the rim). Outer rings and
/// those of islands; cut where `is_node(post)` says so and where a ring touches itself or another, so that lines meet
/// in their ends alone. Ordered by first post, then by direction. `lakes`: from mark_lakes.
std::vector<ShoreLine> shore_lines(const FlowGrid& grid, std::span<const Lake> lakes,
                                   const std::function<bool(std::int64_t)>& is_node);

}  // namespace tind
