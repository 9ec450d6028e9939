// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/source_levels.hpp"

#include <cmath>
#include <numbers>

namespace tind {

Result<LevelTable> make_source_levels(const ElevationSource& source, const BuildOptions& options) {
  LevelOptions levels = options.levels;
  levels.irregular_posts = source.has_points();
  levels.metres_per_degree = Lattice().ellipsoid.semi_major_m * std::numbers::pi / 180;
  if (options.metres == BuildOptions::Metres::kMidLatitude) {
    const auto [west, south, east, north] = source.bounds_deg();
    levels.metres_per_degree *= std::cos((south + north) / 2 * std::numbers::pi / 180);
  } else if (const auto own = source.own_spacing_m(); own && options.metres == BuildOptions::Metres::kAuto) {
    levels.metres_per_degree = *own / source.lon_spacing_deg();
  }
  return make_level_table(source.lon_spacing_deg(), source.lat_spacing_deg(), levels);
}

}  // namespace tind
