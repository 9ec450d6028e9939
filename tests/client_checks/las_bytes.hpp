// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

namespace tind::test {

/// A point to write; `withheld` sets the flag where its format has it.
struct LasPoint {
  double x = 0, y = 0, z = 0;
  std::uint8_t classification = 2;
  bool withheld = false;
};

/// A variable length record to write.
struct LasRecord {
  std::string user = "LASF_Projection";
  std::uint16_t id = 0;
  std::vector<std::uint8_t> data;
};

/// A LAS file to write, byte by byte after the ASPRS LAS Specification 1.4 R15.
struct LasPlan {
  int minor = 2;
  std::uint8_t format = 0;
  std::uint16_t extra_bytes = 0;  ///< After each point's own.
  double scale = 0.001, x_offset = 0, y_offset = 0, z_offset = 0;
  std::vector<LasRecord> records, extended_records;  ///< Extended ones need minor 4.
  std::vector<LasPoint> points;
};

/// A record that holds a text, ended by a zero.
LasRecord text_record(std::uint16_t id, const std::string& text);
/// A record of 16-bit numbers (34735) or doubles (34736).
LasRecord shorts_record(const std::vector<std::uint16_t>& values);
LasRecord doubles_record(const std::vector<double>& values);

std::vector<std::uint8_t> las_bytes(const LasPlan& plan);
/// Writes them to a file.
void write_las(const std::string& path, const LasPlan& plan);

/// Overwrites bytes: a header field changed after the fact.
template <class T>
void poke(std::vector<std::uint8_t>& bytes, std::size_t at, T value) {
  std::memcpy(bytes.data() + at, &value, sizeof(T));
}

}  // namespace tind::test
