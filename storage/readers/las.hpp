// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/result.hpp"
#include "storage/readers/byte_source.hpp"

namespace tind {

/// What a LAS file says about its coordinates, as found in its (extended) variable length records. Not interpreted.
struct LasCrs {
  std::string wkt;                      ///< OGC WKT (LASF_Projection 2112); empty: none.
  std::vector<std::uint16_t> geo_keys;  ///< GeoKeyDirectory (34735); empty: none.
  std::vector<double> geo_doubles;      ///< GeoDoubleParams (34736).
  std::string geo_ascii;                ///< GeoAsciiParams (34737).
};

/// Header of an ASPRS LAS file, versions 1.0 to 1.4, point formats 0 to 10 (LAS 1.4 R15 specification).
struct LasHeader {
  int version_minor = 0;
  int point_format = 0;
  std::uint64_t n_points = 0;
  std::uint64_t points_offset = 0;          ///< First point record, bytes from the file's start.
  std::size_t record_bytes = 0;             ///< >= the format's minimum; what lies behind that is not ours to know.
  std::array<double, 3> scale{}, offset{};  ///< coordinate = stored * scale + offset, in units of the CRS.
  LasCrs crs;
};

/// Reads and checks the header and the records that name the CRS; the points all lie within the file afterwards. Safe
/// for any bytes: counts and offsets are checked against the file before memory is taken. `path` is for messages.
/// kInvalidInput: not LAS, truncated, broken. kUnsupported: LAZ, LAS 2, point formats that do not exist.
Result<LasHeader> read_las_header(ByteSource& bytes, const std::string& path);

/// One point as stored.
struct LasPoint {
  double x = 0, y = 0, z = 0;  ///< In units of the CRS.
  std::uint8_t classification = 0;
  bool withheld = false;  ///< Deleted by its maker.
};

/// Decodes whole point records (n * header.record_bytes bytes, else the rest is left out) and appends them.
void decode_las_points(const LasHeader& header, std::span<const std::uint8_t> records, std::vector<LasPoint>& points);

}  // namespace tind
