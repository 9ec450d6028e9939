// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "core/drainage/flow_grid.hpp"

namespace tind {

/// Total area of connected posts at or below 0 m from which on they are the sea: the world's oceans, not Death Valley.
inline constexpr double kSeaAreaM2 = 1e11;
/// Fewest core posts of a lake or posts of a basin: fewer are noise of a level surface.
inline constexpr std::int64_t kLakePosts = 64;
/// Largest share of a lake's rim that may be lower than it. In heights of whole metres a plain is made of flats, too,
/// but those are bands: about half of their rim is lower (docs/decisions/0007-drainage.md).
inline constexpr double kLakeLowerRim = 0.0625;

/// A level stretch of water: posts of exactly one height.
struct Lake {
  std::int64_t root = 0;  ///< The first post (in index order) of the flat that the lake is part of.
  double height_m = 0;
  double core_area_m2 = 0;  ///< Area of the posts whose eight neighbours have their height, too.
  std::int64_t core_posts = 0;
  std::int64_t rim = 0;        ///< Steps along rows and columns from the flat to other posts.
  std::int64_t lower_rim = 0;  ///< Of those, downwards.
};

/// Sets kSea. Without `sea_level_m`: the 4-connected posts at or below 0 m, if these bodies have kSeaAreaM2 or more
/// each. With it: every post at or below it. `labels` (size()) is scratch. Returns the number of sea posts.
std::int64_t mark_sea(const FlowGrid& grid, std::optional<double> sea_level_m, std::int64_t* labels);

/// Labels flats: `labels` (size()) becomes the first post of each post's flat (4-connected posts of the source of
/// exactly equal height), -1 at voids, outside, and in the sea other than at `sea_level_m`: that is its floor.
void label_flats(const FlowGrid& grid, double sea_level_m, std::int64_t* labels);

/// Sets kLake and returns the lakes in ascending order of `root`. A lake is part of a flat: its core, the posts
/// whose eight neighbours belong to it, and their neighbours; the core has at least `min_area_m2` and kLakePosts posts,
/// and at most kLakeLowerRim of the flat's rim is lower.
/// Calls label_flats.
std::vector<Lake> mark_lakes(const FlowGrid& grid, double min_area_m2, double sea_level_m, std::int64_t* labels);

/// Sets kBasin on 4-connected posts that filling raised by more than `max_depth_m`, where such a piece has at least
/// `min_area_m2` and kLakePosts posts: no noise but a basin of its own. `labels` is scratch. Returns the number of
/// posts.
std::int64_t mark_basins(const FlowGrid& grid, const float* filled_m, double max_depth_m, double min_area_m2,
                         std::int64_t* labels);

/// One stretch of shore, as posts.
struct ShoreLine {
  std::int64_t root = 0;            ///< Of the Lake.
  std::vector<std::int64_t> posts;  ///< Indices; neighbours are one step along a row or column apart. A ring repeats
                                    ///< its first. The lake lies to the left.
};

/// The shores of the lakes: the rim of the squares between posts of which all four corners are posts of one lake (each
/// post of a lake is a corner of one; a post with a neighbour that is not of the lake lies on the rim). Outer rings and
/// those of islands; cut where `is_node(post)` says so and where a ring touches itself or another, so that lines meet
/// in their ends alone. Ordered by first post, then by direction. `labels`: from label_flats.
std::vector<ShoreLine> shore_lines(const FlowGrid& grid, const std::int64_t* labels,
                                   const std::function<bool(std::int64_t)>& is_node);

}  // namespace tind
