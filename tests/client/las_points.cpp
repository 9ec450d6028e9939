// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/las_points.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace tind::client {
namespace {

constexpr std::size_t kShortestHeader = 227, kHeader14 = 375;
constexpr std::size_t kVlrHeader = 54, kEvlrHeader = 60;
/// More is no projection; the specification's own limit for a VLR is 65535.
constexpr std::uint64_t kLargestRecord = 1 << 20;
/// What a file may spend on records before its points (64 K records of a hundred bytes, say).
constexpr std::uint64_t kMostRecords = 1 << 16;
constexpr std::size_t kPointsAtOnce = 1 << 14;
/// Shortest record of each point format.
constexpr std::array<std::uint16_t, 11> kShortestPoint = {20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67};

struct Header {
  int minor = 0;
  std::uint16_t header_bytes = 0;
  std::uint32_t points_at = 0, n_vlrs = 0;
  std::uint8_t format = 0;
  std::uint16_t point_bytes = 0;
  std::uint64_t n_points = 0, evlrs_at = 0;
  std::uint32_t n_evlrs = 0;
  std::array<double, 3> scale{}, offset{};
};

std::string fixed_text(BlobView bytes) {
  const auto end = std::find(bytes.begin(), bytes.end(), std::uint8_t{0});
  return std::string(bytes.begin(), end);
}

Outcome<Header> read_header(const ReadAt& read, std::uint64_t file_bytes) {
  const Blob bytes = read(0, kHeader14);
  if (bytes.size() < 4 || std::memcmp(bytes.data(), "LASF", 4) != 0)
    return refuse("is no LAS file (no 'LASF' at its start)");
  ByteCursor in(bytes);
  Header h;
  in.take_bytes(24);
  const int major = in.take<std::uint8_t>();
  h.minor = in.take<std::uint8_t>();
  in.take_bytes(94 - 26);
  h.header_bytes = in.take<std::uint16_t>();
  h.points_at = in.take<std::uint32_t>();
  h.n_vlrs = in.take<std::uint32_t>();
  const auto format = in.take<std::uint8_t>();
  h.point_bytes = in.take<std::uint16_t>();
  h.n_points = in.take<std::uint32_t>();
  in.take_bytes(20);
  for (double& s : h.scale) s = in.take<double>();
  for (double& o : h.offset) o = in.take<double>();
  in.take_bytes(48);
  if (in.bad()) return refuse(fmt::format("ends after {} bytes, inside its header", bytes.size()));
  if (major != 1 || h.minor > 4) return refuse(fmt::format("is LAS {}.{}; 1.0 to 1.4 are known", major, h.minor));
  if ((format & 0xc0) != 0)
    return refuse("holds compressed points (LAZ): convert it, e.g. pdal translate in.laz out.las");
  if (format >= kShortestPoint.size()) return refuse(fmt::format("has point format {}; 0 to 10 are known", format));
  h.format = format;
  if (h.point_bytes < kShortestPoint[format]) {
    return refuse(
        fmt::format("has points of {} bytes; format {} needs {}", h.point_bytes, format, kShortestPoint[format]));
  }
  const std::size_t shortest = h.minor == 4 ? kHeader14 : h.minor == 3 ? kShortestHeader + 8 : kShortestHeader;
  if (h.header_bytes < shortest)
    return refuse(fmt::format("has a header of {} bytes; LAS 1.{} needs {}", h.header_bytes, h.minor, shortest));
  if (h.minor == 4) {
    in.take_bytes(8);
    h.evlrs_at = in.take<std::uint64_t>();
    h.n_evlrs = in.take<std::uint32_t>();
    const auto n = in.take<std::uint64_t>();
    if (in.bad()) return refuse("ends inside its header");
    if (n != 0) h.n_points = n;
  }
  if (h.points_at < h.header_bytes || h.points_at > file_bytes) {
    return refuse(fmt::format("says its points start at byte {}, which is not between header and end ({} bytes)",
                              h.points_at, file_bytes));
  }
  if (h.n_points > (file_bytes - h.points_at) / h.point_bytes) {
    return refuse(fmt::format("announces {} points, but has room for {}: cut short?", h.n_points,
                              (file_bytes - h.points_at) / h.point_bytes));
  }
  for (std::size_t k = 0; k < 3; ++k) {
    if (!std::isfinite(h.scale[k]) || h.scale[k] == 0 || !std::isfinite(h.offset[k])) {
      return refuse(fmt::format("has a scale {} or offset {} that is no use", h.scale[k], h.offset[k]));
    }
  }
  return h;
}

/// Takes what a projection record says; other records are not looked at.
void take_record(const std::string& user, std::uint16_t id, const Blob& data, LasPoints& points) {
  if (user != "LASF_Projection") return;
  ByteCursor in(data);
  if (id == 2112) {
    points.wkt = fixed_text(data);
  } else if (id == 34735) {
    points.keys.directory.clear();
    while (in.left() >= 2) points.keys.directory.push_back(in.take<std::uint16_t>());
  } else if (id == 34736) {
    points.keys.doubles.clear();
    while (in.left() >= 8) points.keys.doubles.push_back(in.take<double>());
  } else if (id == 34737) {
    points.keys.text = fixed_text(data);
  }
}

/// Walks `n` records from `at`; they may not reach beyond `end`. Extended ones have 64-bit lengths.
Outcome<void> read_records(const ReadAt& read, std::uint64_t at, std::uint64_t end, std::uint64_t n, bool extended,
                           LasPoints& points) {
  const std::size_t header_bytes = extended ? kEvlrHeader : kVlrHeader;
  if (n > kMostRecords) return refuse(fmt::format("announces {} variable length records", n));
  for (std::uint64_t k = 0; k < n; ++k) {
    if (at > end || end - at < header_bytes)
      return refuse(fmt::format("record {} of {} lies beyond its place", k + 1, n));
    const Blob header = read(at, header_bytes);
    ByteCursor in(header);
    in.take_bytes(2);
    const std::string user = fixed_text(in.take_bytes(16));
    const auto id = in.take<std::uint16_t>();
    const std::uint64_t length = extended ? in.take<std::uint64_t>() : in.take<std::uint16_t>();
    if (header.size() < header_bytes) return refuse(fmt::format("ends inside record {} of {}", k + 1, n));
    at += header_bytes;
    if (length > end - at)
      return refuse(fmt::format("record {} of {} ({} bytes) lies beyond its place", k + 1, n, length));
    if (user == "LASF_Projection" && length <= kLargestRecord) {
      const Blob data = read(at, static_cast<std::size_t>(length));
      if (data.size() < length) return refuse(fmt::format("ends inside record {} of {}", k + 1, n));
      take_record(user, id, data, points);
    }
    at += length;
  }
  return {};
}

}  // namespace

Outcome<LasPoints> read_las(const ReadAt& read, std::uint64_t file_bytes, const ClassFilter& classes) {
  const auto header = read_header(read, file_bytes);
  if (!header) return refuse(header.error());
  const Header& h = *header;
  LasPoints points;
  if (auto ok = read_records(read, h.header_bytes, h.points_at, h.n_vlrs, false, points); !ok)
    return refuse(ok.error());
  if (h.n_evlrs > 0) {
    if (auto ok = read_records(read, h.evlrs_at, file_bytes, h.n_evlrs, true, points); !ok) return refuse(ok.error());
  }
  const bool wide_class = h.format >= 6;
  for (std::uint64_t first = 0; first < h.n_points; first += kPointsAtOnce) {
    const auto n = static_cast<std::size_t>(std::min<std::uint64_t>(kPointsAtOnce, h.n_points - first));
    const Blob bytes = read(h.points_at + first * h.point_bytes, n * h.point_bytes);
    if (bytes.size() < n * h.point_bytes) return refuse(fmt::format("cannot be read at point {}", first));
    for (std::size_t k = 0; k < n; ++k) {
      ByteCursor in(BlobView(bytes).subspan(k * h.point_bytes, h.point_bytes));
      std::array<double, 3> position{};
      for (std::size_t a = 0; a < 3; ++a) position[a] = in.take<std::int32_t>() * h.scale[a] + h.offset[a];
      in.take_bytes(3);  // intensity, return numbers
      const auto flags = in.take<std::uint8_t>();
      const std::uint8_t number = wide_class ? in.take<std::uint8_t>() : flags & 0x1f;
      const bool withheld = (flags & (wide_class ? 0x04 : 0x80)) != 0;
      if (withheld) {
        ++points.n_withheld;
        continue;
      }
      ++points.n_of_class[number];
      if (!classes[number]) continue;
      points.x.push_back(position[0]);
      points.y.push_back(position[1]);
      points.z.push_back(position[2]);
    }
  }
  return points;
}

std::string describe_classes(const LasPoints& points) {
  std::string found;
  for (std::size_t c = 0; c < points.n_of_class.size(); ++c) {
    if (points.n_of_class[c] > 0) found += fmt::format("{}{} ({})", found.empty() ? "" : ", ", c, points.n_of_class[c]);
  }
  return found.empty() ? "it has no points" : "classes found: " + found + "; choose with --class";
}

}  // namespace tind::client
