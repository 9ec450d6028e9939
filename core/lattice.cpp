// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/lattice.hpp"

#include <numbers>

namespace tind {

std::array<double, 3> Lattice::geodetic_to_ecef(double lon_deg, double lat_deg, double height_m) const {
  const double lon = lon_deg * std::numbers::pi / 180.0, lat = lat_deg * std::numbers::pi / 180.0;
  const double f = 1.0 / ellipsoid.inverse_flattening, e2 = f * (2.0 - f);
  const double sin_lat = std::sin(lat), cos_lat = std::cos(lat);
  const double n = ellipsoid.semi_major_m / std::sqrt(1.0 - e2 * sin_lat * sin_lat);
  return {(n + height_m) * cos_lat * std::cos(lon), (n + height_m) * cos_lat * std::sin(lon),
          (n * (1.0 - e2) + height_m) * sin_lat};
}

}  // namespace tind
