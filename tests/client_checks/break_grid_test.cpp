// SPDX-License-Identifier: GPL-3.0-or-later
// The small world's posts once more, as a projected raster and as points; then their manifest and tiles broken on
// purpose.
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>

#include "tests/client_checks/checks_of.hpp"
#include "tests/client_checks/projected_raster.hpp"

namespace tind::test {
namespace {

using client::SourceKind;
using client::SourcePosts;
using testing::Contains;
using testing::HasSubstr;
using testing::Not;

/// The claim of the small world, as verify() would take it from its manifest.
client::GridClaim world_claim(const Manifest& manifest) {
  return {{manifest.lattice.level, manifest.lattice.height_exponent}, manifest.spacing_deg, false};
}

std::string beside_world(const std::string& name) {
  return (std::filesystem::path(small_world().raster).parent_path() / name).string();
}

/// The world in a cylindrical projection whose cells have their centres on the world's posts, and exactly as many of
/// them.
const SourcePosts& warped_world(const Manifest& manifest) {
  static const SourcePosts posts = [&] {
    const SourcePosts& world = world_posts();
    ProjectedPlan plan;
    plan.crs = "+proj=longlat +datum=WGS84 +pm=10 +no_defs";
    const double cell = world.lon_spacing_deg;
    plan.n_columns = static_cast<int>(world.n_cols);
    plan.n_rows = static_cast<int>(world.n_rows);
    const double north = world.latitude_of(world.n_cols * (world.n_rows - 1));
    plan.transform = {world.west_deg - 10 - cell / 2, cell, 0, north + cell / 2, 0, -cell};
    plan.height = [&](double x, double y) {
      const auto column = std::llround((x - plan.transform[0]) / cell - 0.5);
      const auto row = world.n_rows - 1 - std::llround((plan.transform[3] - y) / cell - 0.5);
      return static_cast<double>(world.heights_m[static_cast<std::size_t>(row * world.n_cols + column)]);
    };
    write_projected(beside_world("turned.tif"), plan);
    return client::read_source_posts({beside_world("turned.tif")}, {}, world_claim(manifest)).value();
  }();
  return posts;
}

/// Every post of the world as a line of text; `spoil(k, lon, lat, z)` may change one or return false to leave it out.
template <class Spoil>
SourcePosts world_as_points(const Manifest& manifest, const Spoil& spoil) {
  const SourcePosts& world = world_posts();
  std::ofstream out(beside_world("points.xyz"));
  for (std::size_t k = 0; k < world.heights_m.size(); ++k) {
    const auto at = static_cast<std::int64_t>(k);
    double lon = world.longitude_of(at), lat = world.latitude_of(at);
    auto z = static_cast<double>(world.heights_m[k]);
    if (!spoil(k, lon, lat, z)) continue;
    char line[120];
    std::snprintf(line, sizeof line, "%.17g %.17g %.9g\n", lon, lat, z);
    out << line;
  }
  out.close();
  return client::read_source_posts({beside_world("points.xyz")}, {}, world_claim(manifest)).value();
}

class BrokenGrid : public testing::Test {
 protected:
  MemoryPyramid pyramid{small_world().tind};

  std::set<std::string> failed_with(const SourcePosts& posts, int cuts = 16) {
    client::VerifyOptions options;
    options.dataset = "p";
    options.cuts = cuts;
    auto report = client::verify(pyramid, &posts, options);
    EXPECT_TRUE(report.has_value()) << report.error();
    report_ = std::move(*report);
    return failed_checks(*report_);
  }
  std::string offenders(const std::string& id) { return offenders_of(*report_, id); }
  client::Report& report() { return *report_; }

  Manifest warped_manifest() {
    Manifest manifest = pyramid.manifest();
    manifest.source_kind = "warped";
    manifest.resampling = "bilinear";
    return manifest;
  }
  Manifest point_manifest() {
    Manifest manifest = pyramid.manifest();
    manifest.source_kind = "points";
    return manifest;
  }
  /// A bottom tile with many interior vertices, one of them raised by 2.5 E_L.
  TileKey raise_a_vertex() {
    TileKey best;
    std::size_t most = 0;
    for (const TileKey& key : pyramid.tiles(pyramid.manifest().bottom_level)) {
      const auto n = pyramid.pieces(key).body.interior.size();
      if (n > most) {
        most = n;
        best = key;
      }
    }
    TilePieces pieces = pyramid.pieces(best);
    pieces.body.interior[3].z += static_cast<std::int32_t>(std::ldexp(
        2.5 * pyramid.manifest().levels[best.level].tolerance_m, pyramid.manifest().lattice.height_exponent));
    pyramid.serve_pieces(best, pieces);
    return best;
  }

 private:
  std::unique_ptr<client::Report> report_;
};

TEST_F(BrokenGrid, TheWorldCountedFromAnotherMeridianHolds) {
  const SourcePosts& posts = warped_world(pyramid.manifest());
  EXPECT_EQ(posts.kind, SourceKind::kWarped);
  EXPECT_EQ(posts.n_posts + posts.either.size(), world_posts().n_posts);
  pyramid.serve_manifest(warped_manifest());
  EXPECT_EQ(failed_with(posts), std::set<std::string>{}) << report().text();
  EXPECT_EQ(report().find("warped-spacing")->skipped(), "");
}

TEST_F(BrokenGrid, PostsCoarserThanTheSourceAreSeen) {
  Manifest manifest = warped_manifest();
  manifest.spacing_deg = {1.0 / 49, 1.0 / 50};
  pyramid.serve_manifest(manifest);
  EXPECT_THAT(failed_with(warped_world(pyramid.manifest())), Contains("warped-spacing"));
  EXPECT_THAT(offenders("warped-spacing"), HasSubstr("49 posts in a degree of longitude"));
  EXPECT_THAT(offenders("warped-spacing"), HasSubstr("coarser than the source"));
}

TEST_F(BrokenGrid, SpacingAndBoundsOffTheGridAreSeen) {
  Manifest manifest = warped_manifest();
  manifest.spacing_deg = {0.02, 0.0195};
  pyramid.serve_manifest(manifest);
  EXPECT_THAT(failed_with(warped_world(pyramid.manifest())), Contains("warped-spacing"));
  EXPECT_THAT(offenders("warped-spacing"), HasSubstr("no whole part of a degree"));
  manifest = warped_manifest();
  manifest.bounds_deg[0] -= 0.007;
  pyramid.serve_manifest(manifest);
  EXPECT_EQ(failed_with(warped_world(pyramid.manifest())), std::set<std::string>{"warped-spacing"});
  EXPECT_THAT(offenders("warped-spacing"), HasSubstr("no whole multiple"));
}

TEST_F(BrokenGrid, BoundsThatLeaveOutPostsAreSeen) {
  for (const std::size_t side : {0u, 1u, 2u, 3u}) {
    Manifest manifest = pyramid.manifest();
    manifest.bounds_deg[side] += side < 2 ? 0.02 : -0.02;
    pyramid.serve_manifest(manifest);
    EXPECT_EQ(failed_with(world_posts(), 8), std::set<std::string>{"source-grid"}) << side;
    EXPECT_THAT(offenders("source-grid"), HasSubstr("bounds_deg say"));
  }
}

TEST_F(BrokenGrid, AnotherKindOrSpacingOrNumberIsSeen) {
  pyramid.serve_manifest(warped_manifest());
  EXPECT_EQ(failed_with(world_posts(), 8), std::set<std::string>{"source-grid"});
  EXPECT_THAT(offenders("source-grid"), HasSubstr("source_kind is 'warped'"));
  Manifest manifest = pyramid.manifest();
  manifest.spacing_deg[1] *= 1.01;
  pyramid.serve_manifest(manifest);
  EXPECT_EQ(failed_with(world_posts(), 8), std::set<std::string>{"source-grid"});
  EXPECT_THAT(offenders("source-grid"), HasSubstr("degrees of latitude apart"));
  manifest = pyramid.manifest();
  manifest.n_source_posts += 1;
  pyramid.serve_manifest(manifest);
  EXPECT_EQ(failed_with(world_posts(), 8), std::set<std::string>{"source-grid"});
  EXPECT_THAT(offenders("source-grid"), HasSubstr("source posts"));
}

TEST_F(BrokenGrid, AHalfCellShiftOfTheSourceIsSeen) {
  pyramid.serve_manifest(warped_manifest());
  SourcePosts shifted = warped_world(pyramid.manifest());
  // What a confusion of pixel-is-area and pixel-is-point would give: heights from half a cell away.
  for (std::size_t k = 0; k + 1 < shifted.heights_m.size(); ++k) {
    shifted.heights_m[k] = (shifted.heights_m[k] + shifted.heights_m[k + 1]) / 2;
  }
  EXPECT_THAT(failed_with(shifted, 8), Contains("stored-error"));
}

TEST_F(BrokenGrid, ARaisedVertexIsSeenAtWarpedPostsAndAtPoints) {
  const TileKey key = raise_a_vertex();
  pyramid.serve_manifest(warped_manifest());
  const auto failed = failed_with(warped_world(pyramid.manifest()), 8);
  EXPECT_THAT(failed, Contains("source-error"));
  EXPECT_THAT(failed, Contains("stored-error"));
  pyramid.serve_manifest(point_manifest());
  const auto points = world_as_points(pyramid.manifest(), [](std::size_t, double&, double&, double&) { return true; });
  const auto failed_points = failed_with(points, 8);
  EXPECT_THAT(failed_points, Contains("source-error"));
  EXPECT_THAT(failed_points, Contains("stored-error"));
  EXPECT_THAT(failed_points, Not(Contains("kept-points")));
  EXPECT_THAT(offenders("source-error"), HasSubstr("tile " + text_of(key) + ": post at longitude"));
}

TEST_F(BrokenGrid, TheWorldAsPointsHoldsAndEveryCutMeetsThem) {
  const auto points = world_as_points(pyramid.manifest(), [](std::size_t, double&, double&, double&) { return true; });
  EXPECT_EQ(points.kind, SourceKind::kPoints);
  pyramid.serve_manifest(point_manifest());
  EXPECT_EQ(failed_with(points, 24), std::set<std::string>{}) << report().text();
  const auto n_points = report().find("cut-error")->count(),
             n_tessellated = report().find("tessellated-error")->count();
  EXPECT_EQ(failed_with(points, 24), std::set<std::string>{});
  pyramid.serve_manifest(pyramid.manifest());
  EXPECT_EQ(failed_with(world_posts(), 24), std::set<std::string>{});
  EXPECT_EQ(report().find("cut-error")->count(), n_points) << "the same posts, whichever way they are read";
  EXPECT_EQ(report().find("tessellated-error")->count(), n_tessellated);
}

TEST_F(BrokenGrid, APointTooManyOrTooFewIsSeen) {
  const auto fewer =
      world_as_points(pyramid.manifest(), [](std::size_t k, double&, double&, double&) { return k != 60000; });
  pyramid.serve_manifest(point_manifest());
  const auto failed = failed_with(fewer, 8);
  EXPECT_THAT(failed, Contains("kept-points"));
  EXPECT_THAT(failed, Contains("stored-error"));
  EXPECT_THAT(offenders("kept-points"), HasSubstr("meta.json counts 120000 points, the source keeps 119999"));
  EXPECT_THAT(offenders("kept-points"), HasSubstr("the tiles of level 0 count"));
}

TEST_F(BrokenGrid, APointThatTheSurfaceMissesIsSeen) {
  const double tolerance = pyramid.manifest().levels.back().tolerance_m;
  const auto lower = world_as_points(pyramid.manifest(), [&](std::size_t k, double&, double&, double& z) {
    if (k == 60000) z -= 2.5 * tolerance;
    return true;
  });
  pyramid.serve_manifest(point_manifest());
  const auto failed = failed_with(lower, 8);
  EXPECT_THAT(failed, Contains("source-error"));
  EXPECT_THAT(failed, Not(Contains("kept-points")));
}

TEST_F(BrokenGrid, AnUncertainPostIsNeitherMissedNorJudged) {
  SourcePosts posts = world_posts();
  posts.heights_m[60000] += 9000;
  EXPECT_THAT(failed_with(posts, 8), Contains("source-error"));
  posts.either.insert(60000);
  --posts.n_posts;
  EXPECT_THAT(failed_with(posts, 8), Not(Contains("source-error")));
}

}  // namespace
}  // namespace tind::test
