// SPDX-License-Identifier: GPL-3.0-or-later
// Whether the posts that the manifest speaks of are those of the sources.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "tests/client/checks.hpp"

namespace tind::client {
namespace {

/// Samples of another program may have met a slightly sparser place.
constexpr double kSampling = 1e-3;
/// Share of a spacing by which positions may be off: decimals of JSON.
constexpr double kOfSpacing = 1e-3;

bool is_whole(double value) { return std::abs(value - std::round(value)) <= kOfSpacing; }

/// The corners of the area in which the source has posts.
struct Bounds {
  double west = 1e9, south = 1e9, east = -1e9, north = -1e9;
  void add(double lon, double lat) {
    west = std::min(west, lon);
    east = std::max(east, lon);
    south = std::min(south, lat);
    north = std::max(north, lat);
  }
};

Bounds bounds_of(const SourcePosts& posts) {
  Bounds bounds;
  for (std::size_t k = 0; k < posts.heights_m.size(); ++k) {
    const auto at = static_cast<std::int64_t>(k);
    if (posts.has(at) && !posts.is_uncertain(at)) bounds.add(posts.longitude_of(at), posts.latitude_of(at));
  }
  return bounds;
}

/// True iff `n` may be the number of posts.
bool fits(const SourcePosts& posts, std::uint64_t n) {
  return n >= posts.n_posts && n <= posts.n_posts + posts.either.size();
}

/// meta.json's bounds hold every post, wherever the turn of the globe puts them.
void check_bounds(const Run& run, Check& check) {
  const Bounds b = bounds_of(*run.posts);
  const auto& [west, south, east, north] = run.manifest.bounds_deg;
  const double slack_x = kOfSpacing * run.manifest.spacing_deg[0], slack_y = kOfSpacing * run.manifest.spacing_deg[1];
  check.looked_at(2);
  if (b.south < south - slack_y || b.north > north + slack_y) {
    check.fail(fmt::format("the source has posts from latitude {:.6f} to {:.6f}, bounds_deg say {:.6f} to {:.6f}",
                           b.south, b.north, south, north));
  }
  const bool whole_circle = east - west >= 360 - 1.5 * run.manifest.spacing_deg[0];
  bool held = whole_circle;
  for (int turn = -2; turn <= 2; ++turn) {
    held = held || (b.west + 360 * turn >= west - slack_x && b.east + 360 * turn <= east + slack_x);
  }
  if (!held) {
    check.fail(fmt::format("the source has posts from longitude {:.6f} to {:.6f}, bounds_deg say {:.6f} to {:.6f}",
                           b.west, b.east, west, east));
  }
}

}  // namespace

void check_source_grid(Run& run) {
  Check& check = run.check("source-grid");
  if (run.posts == nullptr) return check.skip("no --source was given");
  const SourcePosts& posts = *run.posts;
  check.looked_at();
  if (run.manifest.source_kind != name_of(posts.kind)) {
    check.fail(fmt::format("source_kind is '{}', but the source's posts are '{}'", run.manifest.source_kind,
                           name_of(posts.kind)));
  }
  for (const auto& note : posts.notes) check.note(note);
  check_bounds(run, check);
  if (posts.kind == SourceKind::kPoints) return;
  check.looked_at();
  if (!fits(posts, run.manifest.n_source_posts)) {
    check.fail(
        fmt::format("meta.json counts {} source posts, the source has {}", run.manifest.n_source_posts, posts.n_posts));
  }
  if (posts.kind == SourceKind::kWarped) return;
  static constexpr std::array<const char*, 2> kAxes = {"longitude", "latitude"};
  const std::array<double, 2> own = {posts.lon_spacing_deg, posts.lat_spacing_deg};
  for (std::size_t a = 0; a < 2; ++a) {
    check.looked_at();
    const double n = static_cast<double>(a == 0 ? posts.n_cols : posts.n_rows);
    if (std::abs(own[a] - run.manifest.spacing_deg[a]) * n > kOfSpacing * own[a]) {
      check.fail(fmt::format("the source's posts are {} degrees of {} apart, spacing_deg says {}", own[a], kAxes[a],
                             run.manifest.spacing_deg[a]));
    }
  }
}

void check_warped_spacing(Run& run) {
  Check& check = run.check("warped-spacing");
  if (run.posts == nullptr) return check.skip("no --source was given");
  if (run.posts->kind != SourceKind::kWarped) return check.skip("the posts are the source's own");
  static constexpr std::array<const char*, 2> kAxes = {"longitude", "latitude"};
  for (std::size_t a = 0; a < 2; ++a) {
    const double spacing = run.manifest.spacing_deg[a];
    const NativeScale& native = run.posts->native[a];
    check.looked_at(4);
    if (!is_whole(1 / spacing)) {
      check.fail(fmt::format("a spacing of {} degrees of {} is no whole part of a degree", spacing, kAxes[a]));
    }
    if (native.cells_per_degree > (1 + kSampling) / spacing) {
      check.fail(fmt::format(
          "{:.6g} posts in a degree of {}, but at longitude {:.5f}, latitude {:.5f} the source has {:.2f} cells "
          "in one: posts are coarser than the source",
          1 / spacing, kAxes[a], native.lon_deg, native.lat_deg, native.cells_per_degree));
    }
    for (const double bound : {run.manifest.bounds_deg[a], run.manifest.bounds_deg[a + 2]}) {
      if (!is_whole(bound / spacing)) {
        check.fail(fmt::format("bounds_deg has {} {}, no whole multiple of the spacing {}", kAxes[a], bound, spacing));
      }
    }
  }
}

void check_kept_points(Run& run) {
  Check& check = run.check("kept-points");
  if (run.posts == nullptr) return check.skip("no --source was given");
  if (run.posts->kind != SourceKind::kPoints) return check.skip("the source is no cloud of points");
  const auto compare = [&](const std::string& who, std::uint64_t n) {
    check.looked_at();
    const std::uint64_t least = run.posts->n_posts;
    if (!fits(*run.posts, n)) check.fail(fmt::format("{} {} points, the source keeps {}", who, n, least));
  };
  compare("meta.json counts", run.manifest.n_source_posts);
  if (run.pyramid.is_sample()) return;
  std::vector<std::uint64_t> by_level(run.manifest.levels.size(), 0);
  for (const Node& node : run.pyramid.nodes()) {
    if (node.tile != nullptr) by_level[static_cast<std::size_t>(node.id.level)] += node.tile->n_posts;
  }
  for (std::size_t l = 0; l < by_level.size(); ++l) compare(fmt::format("the tiles of level {} count", l), by_level[l]);
}

}  // namespace tind::client
