// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <string>

#include "core/tile_key.hpp"

namespace tind {

/// Lattice steps along the side of a tile of the lattice level, as a power of two.
inline constexpr int kLatticeBits = 16;

/// Nearest multiple of a step, halves upwards. `step` > 0, in the unit of `value`.
inline double round_to_step(double value, double step) { return std::floor(value / step + 0.5) * step; }

/// Ellipsoid of revolution named by the manifest. Lengths in metres.
struct Ellipsoid {
  std::string name = "WGS 84";
  double semi_major_m = 6378137.0;
  double inverse_flattening = 298.257223563;

  double semi_minor_m() const { return semi_major_m * (1.0 - 1.0 / inverse_flattening); }
};

/// A lattice point: X steps east of longitude -180, Y steps north of latitude -90, z in height units.
struct LatticePoint {
  std::int64_t x = 0;
  std::int64_t y = 0;
  std::int32_t z = 0;
};

/// The integer grid that all vertices of all levels live on (DESIGN "Lattice").
/// A tile of level `level` has 2^(16 + level_ - level) steps a side, so one lattice serves every level and nothing is
/// rounded twice. Heights are integers in units of 2^-height_exponent metres.
struct Lattice {
  int level = 0;            ///< Lattice level: tiles of this level have 2^16 steps a side; >= the bottom level.
  int height_exponent = 0;  ///< k of the height unit 2^-k m, 0 <= k <= 16.
  Ellipsoid ellipsoid;

  /// Steps along a tile side at `tile_level`. Precondition: tile_level <= level.
  std::int64_t tile_side(int tile_level) const { return std::int64_t{1} << (kLatticeBits + level - tile_level); }
  /// Steps around the globe along x.
  std::int64_t width() const { return tile_side(0) * kRootCountX; }
  /// Steps from pole to pole along y.
  std::int64_t height() const { return tile_side(0); }
  /// Degrees per lattice step (both axes).
  double step_deg() const { return 180.0 / static_cast<double>(tile_side(0)); }
  /// Metres per height unit.
  double height_unit_m() const { return power_of_two(-height_exponent); }

  double longitude_deg(std::int64_t x) const { return static_cast<double>(x) * step_deg() - 180.0; }
  double latitude_deg(std::int64_t y) const { return static_cast<double>(y) * step_deg() - 90.0; }
  double height_m(std::int32_t z) const { return static_cast<double>(z) * height_unit_m(); }
  /// Nearest height unit, halves away from zero.
  std::int32_t height_from_m(double metres) const {
    const double units = metres * power_of_two(height_exponent);
    const auto whole = static_cast<std::int32_t>(units);
    const double rest = units - static_cast<double>(whole);  // exact
    return whole + (rest >= 0.5 ? 1 : rest <= -0.5 ? -1 : 0);
  }

  /// The one function that turns lattice integers into a globe position: Earth-centred Earth-fixed metres.
  std::array<double, 3> globe_position(const LatticePoint& p) const {
    return geodetic_to_ecef(longitude_deg(p.x), latitude_deg(p.y), height_m(p.z));
  }
  /// Geodetic degrees and metres above the ellipsoid to ECEF metres.
  std::array<double, 3> geodetic_to_ecef(double lon_deg, double lat_deg, double height_m) const;

 private:
  /// 2^n exactly, |n| <= 1000, without a call.
  static constexpr double power_of_two(int n) {
    return std::bit_cast<double>(static_cast<std::uint64_t>(1023 + n) << 52);
  }
};

}  // namespace tind
