// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace tind::test {

struct LasTestPoint {
  double x = 0, y = 0, z = 0;
  int classification = 2;
  bool withheld = false;
};

/// What a LAS file is to be; its bytes may be spoiled afterwards with put_at.
struct LasTestSpec {
  int version_minor = 2;
  int point_format = 0;
  std::size_t extra_bytes = 0;  ///< Behind each point's own fields.
  std::array<double, 3> scale = {0.001, 0.001, 0.001}, offset = {};
  std::string wkt = {};  ///< Variable length record 2112, with `wkt_at_end` (version 1.4) an extended one.
  std::vector<std::uint16_t> geo_keys = {};  ///< Record 34735.
  std::vector<double> geo_doubles = {};
  std::string geo_ascii = {};
  bool wkt_at_end = false;
  bool legacy_count = true;  ///< Version 1.4: the 32-bit count holds the number of points, too.
  bool laszip = false;       ///< A record of the LAZ compressor.
};

/// The bytes of a LAS file, written by the specification and not by tind's reader.
std::vector<std::uint8_t> make_las(const LasTestSpec& spec, const std::vector<LasTestPoint>& points);

/// Overwrites the little-endian bytes of a number.
template <class T>
void put_at(std::vector<std::uint8_t>& bytes, std::size_t at, T value) {
  const auto* from = reinterpret_cast<const std::uint8_t*>(&value);
  if (bytes.size() < at + sizeof(T)) bytes.resize(at + sizeof(T));
  for (std::size_t i = 0; i < sizeof(T); ++i) bytes[at + i] = from[i];
}

/// GeoTIFF keys of a projected CRS with a code.
std::vector<std::uint16_t> keys_of_epsg(std::uint16_t code);
/// Keys of a geographic CRS with a code, and a vertical unit when `vertical_unit` is not 0.
std::vector<std::uint16_t> keys_of_geographic(std::uint16_t code, std::uint16_t vertical_unit);

}  // namespace tind::test
