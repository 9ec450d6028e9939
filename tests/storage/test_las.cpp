// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/storage/test_las.hpp"

#include <cmath>
#include <cstring>

namespace tind::test {
namespace {

void put_text(std::vector<std::uint8_t>& bytes, std::size_t at, const std::string& text) {
  for (std::size_t i = 0; i < text.size(); ++i) bytes[at + i] = static_cast<std::uint8_t>(text[i]);
}

std::vector<std::uint8_t> bytes_of(const std::string& text) {
  std::vector<std::uint8_t> bytes(text.begin(), text.end());
  bytes.push_back(0);
  return bytes;
}

template <class T>
std::vector<std::uint8_t> bytes_of(const std::vector<T>& values) {
  std::vector<std::uint8_t> bytes(values.size() * sizeof(T));
  if (!values.empty()) std::memcpy(bytes.data(), values.data(), bytes.size());
  return bytes;
}

void append_record(std::vector<std::uint8_t>& bytes, bool extended, const std::string& user, std::uint16_t id,
                   const std::vector<std::uint8_t>& body) {
  const std::size_t at = bytes.size();
  bytes.resize(at + (extended ? 60 : 54));
  put_text(bytes, at + 2, user);
  put_at(bytes, at + 18, id);
  if (extended) {
    put_at(bytes, at + 20, static_cast<std::uint64_t>(body.size()));
  } else {
    put_at(bytes, at + 20, static_cast<std::uint16_t>(body.size()));
  }
  bytes.insert(bytes.end(), body.begin(), body.end());
}

}  // namespace

std::vector<std::uint8_t> make_las(const LasTestSpec& spec, const std::vector<LasTestPoint>& points) {
  constexpr std::size_t kHeader[] = {227, 227, 227, 235, 375};
  constexpr std::size_t kRecord[] = {20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67};
  const std::size_t header = kHeader[spec.version_minor];
  const std::size_t record = kRecord[spec.point_format] + spec.extra_bytes;
  std::vector<std::uint8_t> bytes(header);
  put_text(bytes, 0, "LASF");
  bytes[24] = 1;
  bytes[25] = static_cast<std::uint8_t>(spec.version_minor);
  put_at(bytes, 94, static_cast<std::uint16_t>(header));
  bytes[104] = static_cast<std::uint8_t>(spec.point_format);
  put_at(bytes, 105, static_cast<std::uint16_t>(record));
  const auto n = static_cast<std::uint32_t>(points.size());
  if (spec.version_minor < 4 || spec.legacy_count) put_at(bytes, 107, n);
  for (std::size_t i = 0; i < 3; ++i) {
    put_at(bytes, 131 + 8 * i, spec.scale[i]);
    put_at(bytes, 155 + 8 * i, spec.offset[i]);
  }

  std::uint32_t n_vlrs = 0;
  const auto vlr = [&](const std::string& user, std::uint16_t id, const std::vector<std::uint8_t>& body) {
    append_record(bytes, false, user, id, body);
    ++n_vlrs;
  };
  vlr("somebody else", 7, {1, 2, 3});
  if (!spec.geo_keys.empty()) vlr("LASF_Projection", 34735, bytes_of(spec.geo_keys));
  if (!spec.geo_doubles.empty()) vlr("LASF_Projection", 34736, bytes_of(spec.geo_doubles));
  if (!spec.geo_ascii.empty()) vlr("LASF_Projection", 34737, bytes_of(spec.geo_ascii));
  if (!spec.wkt.empty() && !spec.wkt_at_end) vlr("LASF_Projection", 2112, bytes_of(spec.wkt));
  if (spec.laszip) vlr("laszip encoded", 22204, std::vector<std::uint8_t>(34));
  put_at(bytes, 100, n_vlrs);
  put_at(bytes, 96, static_cast<std::uint32_t>(bytes.size()));

  for (const LasTestPoint& p : points) {
    const std::size_t at = bytes.size();
    bytes.resize(at + record, 0xa5);  // what else a record holds is noise
    const double xyz[] = {p.x, p.y, p.z};
    for (std::size_t i = 0; i < 3; ++i) {
      put_at(bytes, at + 4 * i, static_cast<std::int32_t>(std::lround((xyz[i] - spec.offset[i]) / spec.scale[i])));
    }
    if (spec.point_format >= 6) {
      bytes[at + 15] = p.withheld ? 0x04 : 0x00;
      bytes[at + 16] = static_cast<std::uint8_t>(p.classification);
    } else {
      bytes[at + 15] = static_cast<std::uint8_t>(p.classification | (p.withheld ? 0x80 : 0x00) | 0x40);  // key point
    }
  }
  if (spec.version_minor >= 4) {
    put_at(bytes, 247, static_cast<std::uint64_t>(points.size()));
    if (!spec.wkt.empty() && spec.wkt_at_end) {
      put_at(bytes, 235, static_cast<std::uint64_t>(bytes.size()));
      put_at(bytes, 243, std::uint32_t{1});
      append_record(bytes, true, "LASF_Projection", 2112, bytes_of(spec.wkt));
    }
  }
  return bytes;
}

std::vector<std::uint16_t> keys_of_epsg(std::uint16_t code) {
  return {1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, code};
}

std::vector<std::uint16_t> keys_of_geographic(std::uint16_t code, std::uint16_t vertical_unit) {
  std::vector<std::uint16_t> keys = {1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, code};
  if (vertical_unit != 0) {
    keys[3] = 4;
    keys.insert(keys.end(), {4099, 0, 1, vertical_unit});
  }
  return keys;
}

}  // namespace tind::test
