// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <bitset>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "tests/client/byte_cursor.hpp"

namespace tind::client {

/// Gives up to `n` bytes of a file from `offset` on; fewer at its end. The caller asks for a bounded `n` only.
using ReadAt = std::function<Blob(std::uint64_t offset, std::size_t n)>;

/// Classes of points to keep. Classes are 0..255.
using ClassFilter = std::bitset<256>;

/// A GeoTIFF key directory as a LAS file holds it: records 34735, 34736 and 34737 of LASF_Projection.
struct GeoKeys {
  std::vector<std::uint16_t> directory;
  std::vector<double> doubles;
  std::string text;
};

/// The points of a LAS file that pass the filter, and what the file says of their coordinate system. x, y in units of
/// that system, z in the file's vertical unit; all of one size.
struct LasPoints {
  std::vector<double> x, y, z;
  std::array<std::uint64_t, 256> n_of_class{};  ///< Of all points that are not withheld, kept or not.
  std::uint64_t n_withheld = 0;
  std::string wkt;  ///< Record 2112 of LASF_Projection; empty when there is none.
  GeoKeys keys;     ///< Empty directory when there is none.
};

/// Reads LAS 1.0 to 1.4, point formats 0 to 10, uncompressed (ASPRS LAS Specification 1.4 R15). Safe for any bytes:
/// every offset, count and length is checked against `file_bytes` before memory is taken. A refusal is one line without
/// the file's name.
Outcome<LasPoints> read_las(const ReadAt& read, std::uint64_t file_bytes, const ClassFilter& classes);

/// One line that says what to do about "no point passed the filter": the classes that there are.
std::string describe_classes(const LasPoints& points);

}  // namespace tind::client
