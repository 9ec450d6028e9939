// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/report/source_grid.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include <fmt/format.h>

#include "storage/builder/tile_posts.hpp"

namespace tind {
namespace {

constexpr const char* kSameFiles = "give the very files that the pyramid was built from";
constexpr const char* kSameOptions = "read it with the options that the pyramid was built with";

tl::unexpected<Error> refuse(std::string why) { return fail(ErrorKind::kInvalidInput, std::move(why)); }

bool has_hash(const std::vector<SourceInfo>& sources, const std::string& sha256) {
  return std::any_of(sources.begin(), sources.end(), [&](const SourceInfo& s) { return s.sha256 == sha256; });
}

/// Whether `given`, what was read, is what `built`, the pyramid's manifest, says.
Result<void> check_same(const Manifest& built, const Manifest& given) {
  for (const SourceInfo& s : given.sources) {
    if (has_hash(built.sources, s.sha256)) continue;
    return refuse(fmt::format("{} is not a source of the pyramid: none has its SHA-256 {}...; {}", s.name,
                              s.sha256.substr(0, 12), kSameFiles));
  }
  for (const SourceInfo& s : built.sources) {
    if (has_hash(given.sources, s.sha256)) continue;
    return refuse(fmt::format("the pyramid was also built from {}: name that file with --source, too", s.name));
  }
  bool same_place = true;
  for (std::size_t k = 0; k < 4; ++k) {
    // JSON keeps these numbers; half a post is for what another version of PROJ may move.
    same_place = same_place && std::abs(given.bounds_deg[k] - built.bounds_deg[k]) <= built.spacing_deg[k % 2] / 2 &&
                 std::abs(given.spacing_deg[k % 2] - built.spacing_deg[k % 2]) <= 1e-6 * built.spacing_deg[k % 2];
  }
  if (!same_place) {
    const auto text = [](const std::array<double, 4>& b) {
      return fmt::format("{:.6f}, {:.6f}, {:.6f}, {:.6f}", b[0], b[1], b[2], b[3]);
    };
    return refuse(fmt::format("the posts read lie in [{}] degrees, the pyramid's in [{}]: {}", text(given.bounds_deg),
                              text(built.bounds_deg), kSameOptions));
  }
  if (given.n_source_posts != built.n_source_posts) {
    return refuse(fmt::format("{} posts were read, the pyramid was built from {}: {} (nodata value, unit, classes)",
                              given.n_source_posts, built.n_source_posts, kSameOptions));
  }
  return {};
}

}  // namespace

double cell_area_km2(const HeightField& field, std::int64_t row) {
  // The ellipsoid's surface from the equator to a latitude, per radian of longitude (Snyder 1987, Map projections: a
  // working manual, eq. 3-12).
  const Ellipsoid& ellipsoid = field.lattice.ellipsoid;
  const double f = 1 / ellipsoid.inverse_flattening, e2 = f * (2 - f), e = std::sqrt(e2);
  const auto from_equator_m2 = [&](double y) {
    const double lat_deg = (y - static_cast<double>(field.lattice.height()) / 2) * field.lattice.step_deg();
    const double s = std::sin(std::clamp(lat_deg, -90.0, 90.0) * std::numbers::pi / 180);
    const double q = e > 0 ? s / (1 - e2 * s * s) + std::atanh(e * s) / e : 2 * s;
    return ellipsoid.semi_minor_m() * ellipsoid.semi_minor_m() / 2 * q;
  };
  const double y = field.post_y(row), width_rad = field.dx * field.lattice.step_deg() * std::numbers::pi / 180;
  return width_rad * (from_equator_m2(y + field.dy / 2) - from_equator_m2(y - field.dy / 2)) / 1e6;
}

Result<SourceGrid> load_source(const Manifest& manifest, const SourceOptions& options, const std::string& scratch_dir,
                               int threads, const std::function<void(double)>& progress) {
  auto opened = ElevationSource::open(options);
  if (!opened) return tl::unexpected(opened.error());
  if (opened->has_points() != (manifest.source_kind == "points")) {
    return refuse(fmt::format("{}: the pyramid was built from {}; {}", options.inputs.front(),
                              opened->has_points() ? "rasters" : "points", kSameFiles));
  }
  SourceGrid grid{std::move(*opened)};
  if (auto loaded = grid.source.load(manifest.lattice, manifest.base_height_m, manifest.falloff_posts, scratch_dir,
                                     threads, progress);
      !loaded) {
    return tl::unexpected(loaded.error());
  }
  Manifest given;
  grid.source.describe(given);
  if (auto same = check_same(manifest, given); !same) return tl::unexpected(same.error());
  grid.n_posts = given.n_source_posts;

  const HeightField& field = grid.field();
  std::int64_t row_begin = field.n_rows, row_end = 0, col_begin = field.n_cols, col_end = 0;
  for (std::int64_t r = 0; r < field.n_rows; ++r) {
    std::uint64_t n_in_row = 0;
    for (std::int64_t c = 0; c < field.n_cols; ++c) {
      if (!is_of_source(field.origin_at(r, c))) continue;
      ++n_in_row;
      col_begin = std::min(col_begin, c);
      col_end = std::max(col_end, c + 1);
    }
    if (n_in_row == 0) continue;
    row_begin = std::min(row_begin, r);
    row_end = r + 1;
    grid.n_grid_posts += n_in_row;
    grid.area_km2 += static_cast<double>(n_in_row) * cell_area_km2(field, r);
  }
  grid.first_row = row_begin;
  grid.first_col = col_begin;
  grid.n_rows = row_end - row_begin;
  grid.n_cols = col_end - col_begin;
  return grid;
}

}  // namespace tind
