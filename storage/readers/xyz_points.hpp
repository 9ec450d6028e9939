// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.hpp"
#include "storage/readers/byte_source.hpp"

namespace tind {

/// A line's three numbers, in the order of their meaning; an infinity or NaN where the file has one.
struct XyzPoint {
  double x = 0, y = 0, z = 0;
};

/// Points as text, one a line: columns x, y, z apart by semicolons, tabs, commas or blanks (the first of these that the
/// first line has). A header line may name the columns in any order (x/lon/longitude/easting/east,
/// y/lat/latitude/northing/north, z/height/elevation/elev/altitude/alt, capitals and quotes do not matter); without one
/// the first three columns count. Further columns, empty lines and lines that start with # are left out.
///
/// Ours because GDAL's XYZ driver reads regular grids alone and OGR's CSV driver gives no line number for a broken
/// line. Safe for any bytes. One thread at a time.
class XyzReader {
 public:
  /// Reads up to the first data line. kInvalidInput names the line.
  static Result<XyzReader> open(ByteSource& bytes, const std::string& path);

  /// Appends up to `n_most` points; false at the file's end. kInvalidInput: a line with too few columns or something
  /// that is no number; kIo: a read failed.
  Result<bool> next(std::size_t n_most, std::vector<XyzPoint>& points);

 private:
  XyzReader(ByteSource& bytes, std::string path) : bytes_(&bytes), path_(std::move(path)) {}
  /// The next line without its end; false at the file's end. Valid until the next call.
  Result<bool> next_line(std::string_view& line);
  Result<bool> next_data_line(std::string_view& line);
  void split(std::string_view line);
  Result<void> read_header();
  Result<XyzPoint> parse() const;
  tl::unexpected<Error> bad_line(const std::string& what) const;

  ByteSource* bytes_;
  std::string path_;
  std::vector<std::uint8_t> buffer_;
  std::size_t begin_ = 0;          ///< Of the unread part of buffer_.
  std::uint64_t next_offset_ = 0;  ///< Of the first byte after buffer_ in the file.
  std::uint64_t line_number_ = 0;  ///< Of the line read last, from 1.
  char separator_ = 0;             ///< ' ' stands for any run of blanks.
  std::array<std::size_t, 3> columns_ = {0, 1, 2};
  std::vector<std::string_view> fields_;  ///< Of the line read last.
  bool pending_ = false;                  ///< fields_ holds a data line that next() has not given out.
};

}  // namespace tind
