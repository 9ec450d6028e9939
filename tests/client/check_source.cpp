// SPDX-License-Identifier: GPL-3.0-or-later
// The promise itself: |TIN - h| <= E_L at every source post.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "tests/client/checks.hpp"
#include "tests/client/parallel.hpp"
#include "tests/client/post_scan.hpp"
#include "tests/client/tessellate.hpp"

namespace tind::client {
namespace {

SurfacePoint surface_point(const Vertex& v, double unit_m) {
  return {static_cast<double>(v.x), static_cast<double>(v.y), v.z * unit_m};
}

/// Judges one post and counts what only fails because the sources disagree.
class Judge {
 public:
  Judge(const Run& run, const TileId& id, Check& check, std::string situation)
      : run_(run),
        posts_(*run.posts),
        id_(id),
        check_(check),
        situation_(std::move(situation)),
        tolerance_m_(run.tolerance_m(id.level)) {}
  Judge(const Judge&) = delete;
  Judge& operator=(const Judge&) = delete;
  ~Judge() {
    check_.looked_at(looked_at_);
    if (n_disputed_ > 0) {
      check_.note(
          fmt::format("tile {}: {} post(s) are beyond E_L only where the sources themselves disagree (by up to {} m)",
                      id_.text(), n_disputed_, run_.manifest.disagreement_m));
    }
    if (n_excused_ > 0) {
      check_.note(fmt::format(
          "tile {}{}: {} post(s) are off by up to {:.3f} m because their own vertices are rounded to 0..32767, on "
          "slopes of more than E_L within a step: no mesh in that format is closer",
          id_.text(), situation_.empty() ? "" : " " + situation_, n_excused_, worst_excused_m_));
    }
  }

  /// `at`: the post's index; it must have a height. `is_excused(height_m)`: asked of a post that is beyond E_L, whether
  /// that is only to be noted.
  template <class IsExcused>
  void see(std::int64_t at, double z_m, IsExcused is_excused) {
    if (posts_.is_uncertain(at)) return;
    const auto height = static_cast<double>(posts_.heights_m[static_cast<std::size_t>(at)]);
    ++looked_at_;
    const PostErrors errors = post_errors(posts_, at, z_m);
    worst_ = std::max(worst_, errors.nearest);
    const double allowed = tolerance_m_ + error_slack_m(posts_, height);
    if (errors.farthest <= allowed) return;
    const bool disputed = posts_.other_values.contains(at);
    if (disputed && errors.farthest <= allowed + run_.manifest.disagreement_m) {
      ++n_disputed_;
      return;
    }
    if (is_excused(height)) {
      ++n_excused_;
      worst_excused_m_ = std::max(worst_excused_m_, errors.farthest);
      return;
    }
    check_.fail(
        fmt::format("tile {}{}: post at longitude {:.6f}, latitude {:.6f}: source {} m, TIN {:.3f} m, off by {:.3f} m "
                    "> E_L {:.3f} m",
                    id_.text(), situation_.empty() ? "" : " " + situation_, posts_.longitude_of(at),
                    posts_.latitude_of(at), height, z_m, errors.farthest, tolerance_m_));
  }
  double worst() const { return worst_; }

 private:
  const Run& run_;
  const SourcePosts& posts_;
  TileId id_;
  Check& check_;
  std::string situation_;
  double tolerance_m_;
  std::uint64_t looked_at_ = 0, n_disputed_ = 0, n_excused_ = 0;
  double worst_ = 0, worst_excused_m_ = 0;
};

/// Sums over posts, as ranges where the sources disagree or where a post may not be one.
struct PostSums {
  std::uint64_t n_posts = 0, n_uncertain = 0;
  double max_low = 0, max_high = 0, squares_low = 0, squares_high = 0;

  void see(const PostErrors& errors, bool uncertain) {
    ++(uncertain ? n_uncertain : n_posts);
    max_high = std::max(max_high, errors.farthest);
    squares_high += errors.farthest * errors.farthest;
    if (uncertain) return;
    max_low = std::max(max_low, errors.nearest);
    squares_low += errors.nearest * errors.nearest;
  }
  void add(const PostSums& other) {
    n_posts += other.n_posts;
    n_uncertain += other.n_uncertain;
    max_low = std::max(max_low, other.max_low);
    max_high = std::max(max_high, other.max_high);
    squares_low += other.squares_low;
    squares_high += other.squares_high;
  }
  bool fits(std::uint64_t n) const { return n >= n_posts && n <= n_posts + n_uncertain; }
  /// Of `n` posts that have these squares.
  static double rmse(double squares, std::uint64_t n) {
    return n > 0 ? std::sqrt(squares / static_cast<double>(n)) : 0;
  }
};

/// Which sides of its tile a post lies on within the rounding of real positions. A body counts posts with west <= X <
/// east and south <= Y < north; on which side of a line such a post falls is a matter of the last bit.
enum SideBit : unsigned { kOnWest = 1, kOnEast = 2, kOnSouth = 4, kOnNorth = 8, kSideBits = 16 };

/// Posts of the closed tile, apart by the sides they lie on.
using TileSums = std::array<PostSums, kSideBits>;

unsigned sides_of(double x, double y, double side, double nudge) {
  return (x <= nudge ? kOnWest : 0u) | (x >= side - nudge ? kOnEast : 0u) | (y <= nudge ? kOnSouth : 0u) |
         (y >= side - nudge ? kOnNorth : 0u);
}

/// The posts that lie on no other sides than those in `inside`.
PostSums sum_of(const TileSums& sums, unsigned inside) {
  PostSums sum;
  for (unsigned on = 0; on < kSideBits; ++on) {
    if ((on & ~inside) == 0) sum.add(sums[on]);
  }
  return sum;
}

/// The sides whose posts a body counts as its own: nothing lies north of the pole's row of tiles.
unsigned own_sides(const TileId& id) {
  const bool at_pole = id.y + 1 == TileId::count_y(id.level);
  return kOnWest | kOnSouth | (at_pole ? kOnNorth : 0u);
}

void compare_stored(Run& run, const Tile& tile, const TileSums& sums) {
  Check& check = run.check("stored-error");
  check.looked_at();
  const std::string name = "tile " + tile.id.text() + ": ";
  const auto stored_max = static_cast<double>(tile.max_error_m), stored_rmse = static_cast<double>(tile.rmse_m);
  bool count_fits = false;
  for (unsigned inside = 0; inside < kSideBits; ++inside) {
    const PostSums s = sum_of(sums, inside);
    if (!s.fits(tile.n_posts)) continue;
    count_fits = true;
    const double slack = 1e-5 * (1 + s.max_high) + (run.posts->rounded ? 1e-3 : 0);
    if (stored_max >= s.max_low - slack && stored_max <= s.max_high + slack &&
        stored_rmse >= PostSums::rmse(s.squares_low, tile.n_posts) - slack &&
        stored_rmse <= PostSums::rmse(s.squares_high, tile.n_posts) + slack) {
      return;
    }
  }
  const PostSums s = sum_of(sums, own_sides(tile.id));
  if (!count_fits) {
    check.fail(fmt::format("{}says {} source posts, the source has {} in it", name, tile.n_posts, s.n_posts));
  } else {
    check.fail(fmt::format("{}says max error {:.6f} m and RMSE {:.6f} m, measured {:.6f} m and {:.6f} m", name,
                           stored_max, stored_rmse, s.max_high, PostSums::rmse(s.squares_high, tile.n_posts)));
  }
}

/// A triangle of a tile as a piece of surface.
std::array<SurfacePoint, 3> corners_of(const Corners& t, const std::vector<Vertex>& vertices, double unit_m) {
  return {surface_point(vertices[t[0]], unit_m), surface_point(vertices[t[1]], unit_m),
          surface_point(vertices[t[2]], unit_m)};
}

/// Measures one tile as stored.
TileSums measure_tile(Run& run, const Tile& tile) {
  const SourcePosts& posts = *run.posts;
  const LatticeFrame& frame = run.manifest.frame;
  const double unit = frame.unit_m(), side = static_cast<double>(frame.side(tile.id.level));
  Check& check = run.check("source-error");
  Judge judge(run, tile.id, check, "");
  TileSums sums;
  const TilePosts tile_posts(posts, frame, tile.id);
  std::vector<double> surface(tile_posts.size(), std::numeric_limits<double>::quiet_NaN());
  for (const Corners& t : tile.triangles) {
    tile_posts.scan(corners_of(t, tile.vertices, unit), [&](std::size_t slot, double z) { surface[slot] = z; });
  }
  for (std::size_t slot = 0; slot < tile_posts.size(); ++slot) {
    const auto place = tile_posts.place(slot);
    if (!posts.has(place.at)) continue;
    const double z = surface[slot];
    if (std::isnan(z)) {
      check.fail(fmt::format("tile {}: no triangle holds the post at longitude {:.6f}, latitude {:.6f}", tile.id.text(),
                             posts.longitude_of(place.at), posts.latitude_of(place.at)));
      continue;
    }
    judge.see(place.at, z, [](double) { return false; });
    sums[sides_of(place.x, place.y, side, tile_posts.nudge())].see(post_errors(posts, place.at, z),
                                                                   posts.is_uncertain(place.at));
  }
  return sums;
}

/// Source posts that each level's tiles hold between them.
std::uint64_t certain_posts(const SourcePosts& posts) {
  std::uint64_t n = 0;
  for (std::size_t k = 0; k < posts.heights_m.size(); ++k) {
    const auto at = static_cast<std::int64_t>(k);
    if (posts.has(at) && !posts.is_uncertain(at)) ++n;
  }
  return n;
}

}  // namespace

void check_source_errors(Run& run) {
  Check& check = run.check("source-error");
  if (run.posts == nullptr) {
    check.skip("no --source was given");
    run.check("stored-error").skip("no --source was given");
    return;
  }
  const auto& nodes = run.pyramid.nodes();
  std::vector<PostSums> by_level(run.report.levels.size());
  std::vector<std::uint64_t> stored_posts(run.report.levels.size());
  for_each_parallel(nodes.size(), run.options.threads, [&](std::size_t k) {
    if (nodes[k].tile == nullptr) return;
    const TileSums sums = measure_tile(run, *nodes[k].tile);
    compare_stored(run, *nodes[k].tile, sums);
    const auto level = static_cast<std::size_t>(nodes[k].id.level);
    const std::lock_guard lock(run.figures_mutex);
    by_level[level].add(sum_of(sums, own_sides(nodes[k].id)));
    stored_posts[level] += nodes[k].tile->n_posts;
  });
  const std::uint64_t expected = certain_posts(*run.posts);
  for (std::size_t l = 0; l < by_level.size(); ++l) {
    LevelFigures& figures = run.figures(static_cast<int>(l));
    figures.posts = by_level[l].n_posts;
    figures.measured_max_error_m = by_level[l].max_high;
    figures.measured_rmse_m = PostSums::rmse(by_level[l].squares_high, by_level[l].n_posts + by_level[l].n_uncertain);
    if (!run.pyramid.is_sample() && by_level[l].n_posts != expected) {
      check.fail(fmt::format("level {}: tiles hold {} of the source's {} posts", l, by_level[l].n_posts, expected));
    }
  }
  if (run.posts->disagreement_m > 0) {
    check.note(fmt::format(
        "the sources disagree with each other by up to {} m at {} posts; the manifest says {} m from the field",
        run.posts->disagreement_m, run.posts->other_values.size(), run.manifest.disagreement_m));
  }
  if (run.manifest.disagreement_m > run.posts->disagreement_m + 1e-3) {
    check.fail(fmt::format("the manifest claims the sources disagree by {} m, they differ by at most {} m",
                           run.manifest.disagreement_m, run.posts->disagreement_m));
  }
}

double scan_surface(const Run& run, const TileId& id, const std::vector<std::array<SurfacePoint, 3>>& triangles,
                    Check& check, const std::string& situation, const IsExcused& is_excused) {
  Judge judge(run, id, check, situation);
  const TilePosts tile_posts(*run.posts, run.manifest.frame, id);
  for (const auto& t : triangles) {
    tile_posts.scan(t, [&](std::size_t slot, double z) {
      if (!tile_posts.has(slot)) return;
      const TilePosts::Place place = tile_posts.place(slot);
      judge.see(place.at, z, [&](double height_m) { return is_excused && is_excused(place.x, place.y, height_m); });
    });
  }
  return judge.worst();
}

double scan_changed_triangles(const Run& run, const TileId& id, const TessellatedTile& mesh, Check& check,
                              const std::string& situation) {
  std::vector<std::array<SurfacePoint, 3>> triangles;
  for (std::size_t k = mesh.first_changed; k < mesh.triangles.size(); ++k) {
    triangles.push_back(corners_of(mesh.triangles[k], mesh.vertices, run.manifest.frame.unit_m()));
  }
  return scan_surface(run, id, triangles, check, situation);
}

void check_tessellated_errors(Run& run) {
  Check& check = run.check("tessellated-error");
  if (run.posts == nullptr) return check.skip("no --source was given");
  const Pyramid& pyramid = run.pyramid;
  const auto& nodes = pyramid.nodes();
  std::atomic<bool> any{false};
  for_each_parallel(nodes.size(), run.options.threads, [&](std::size_t k) {
    const Node& node = nodes[k];
    if (node.tile == nullptr || TilePosts(*run.posts, pyramid.frame(), node.id).empty()) return;
    // All four sides at once against what stands beyond them down to level L + gap; deeper gaps until nothing new
    // comes.
    for (int gap = 1;; ++gap) {
      std::array<std::optional<SideInserts>, 4> sides;
      bool new_depth = false;
      for (int b = 0; b < 4; ++b) {
        const std::int32_t beyond = node.neighbours[static_cast<std::size_t>(b)];
        if (beyond < 0 || !pyramid.node(beyond).splittable()) continue;
        const auto line = pyramid.line_beyond(node, b, beyond, [&](std::int32_t index) {
          const int level = pyramid.node(index).id.level;
          new_depth = new_depth || level + 1 == node.id.level + gap;
          return level < node.id.level + gap;
        });
        auto inserts = decode_by_entry_levels(*node.tile, b, line);
        if (inserts) {
          sides[static_cast<std::size_t>(b)] = std::move(*inserts);
        } else {
          check.fail(inserts.error());
        }
      }
      if (!new_depth) break;
      any = true;
      const auto mesh = tessellate(*node.tile, sides);
      if (!mesh) {
        check.fail(mesh.error());
        break;
      }
      if (mesh->changed_vts == 0) continue;
      const double error =
          scan_changed_triangles(run, node.id, *mesh, check, fmt::format("against level {}", node.id.level + gap));
      const std::lock_guard lock(run.figures_mutex);
      LevelFigures& figures = run.figures(node.id.level);
      figures.tessellated_max_error_m = std::max(figures.tessellated_max_error_m.value_or(0), error);
    }
  });
  if (!any) {
    check.skip("no tile with source posts has a finer neighbour");
  } else if (check.count() == 0 && check.failures() == 0) {
    check.skip("no post lies in a virtual triangle that a finer neighbour re-triangulates");
  }
}

}  // namespace tind::client
