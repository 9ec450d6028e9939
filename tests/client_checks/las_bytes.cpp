// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client_checks/las_bytes.hpp"

#include <array>
#include <cmath>
#include <fstream>

namespace tind::test {
namespace {

constexpr std::array<std::uint16_t, 11> kPointBytes = {20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67};

template <class T>
void put(std::vector<std::uint8_t>& out, T value) {
  const std::size_t at = out.size();
  out.resize(at + sizeof(T));
  poke(out, at, value);
}

void put_text(std::vector<std::uint8_t>& out, const std::string& text, std::size_t width) {
  const std::size_t at = out.size();
  out.resize(at + width);
  std::memcpy(out.data() + at, text.data(), std::min(width, text.size()));
}

void put_record(std::vector<std::uint8_t>& out, const LasRecord& record, bool extended) {
  put(out, std::uint16_t{0});
  put_text(out, record.user, 16);
  put(out, record.id);
  if (extended) {
    put(out, static_cast<std::uint64_t>(record.data.size()));
  } else {
    put(out, static_cast<std::uint16_t>(record.data.size()));
  }
  put_text(out, "a record", 32);
  out.insert(out.end(), record.data.begin(), record.data.end());
}

}  // namespace

LasRecord text_record(std::uint16_t id, const std::string& text) {
  LasRecord record;
  record.id = id;
  record.data.assign(text.begin(), text.end());
  record.data.push_back(0);
  return record;
}

LasRecord shorts_record(const std::vector<std::uint16_t>& values) {
  LasRecord record;
  record.id = 34735;
  for (const auto v : values) put(record.data, v);
  return record;
}

LasRecord doubles_record(const std::vector<double>& values) {
  LasRecord record;
  record.id = 34736;
  for (const auto v : values) put(record.data, v);
  return record;
}

std::vector<std::uint8_t> las_bytes(const LasPlan& plan) {
  const std::uint16_t header_bytes = plan.minor == 4 ? 375 : plan.minor == 3 ? 235 : 227;
  const auto point_bytes = static_cast<std::uint16_t>(kPointBytes[plan.format] + plan.extra_bytes);
  std::uint32_t points_at = header_bytes;
  for (const auto& record : plan.records) points_at += 54 + static_cast<std::uint32_t>(record.data.size());
  const auto n = static_cast<std::uint32_t>(plan.points.size());
  std::vector<std::uint8_t> out;
  put_text(out, "LASF", 24);
  put(out, std::uint8_t{1});
  put(out, static_cast<std::uint8_t>(plan.minor));
  put_text(out, "", 94 - 26);
  put(out, header_bytes);
  put(out, points_at);
  put(out, static_cast<std::uint32_t>(plan.records.size()));
  put(out, plan.format);
  put(out, point_bytes);
  put(out, plan.format >= 6 ? std::uint32_t{0} : n);
  put_text(out, "", 20);
  for (int k = 0; k < 3; ++k) put(out, plan.scale);
  for (const double offset : {plan.x_offset, plan.y_offset, plan.z_offset}) put(out, offset);
  put_text(out, "", 48);
  if (plan.minor >= 3) put(out, std::uint64_t{0});
  if (plan.minor == 4) {
    put(out, plan.extended_records.empty() ? std::uint64_t{0} : points_at + std::uint64_t{n} * point_bytes);
    put(out, static_cast<std::uint32_t>(plan.extended_records.size()));
    put(out, std::uint64_t{n});
    put_text(out, "", 15 * 8);
  }
  for (const auto& record : plan.records) put_record(out, record, false);
  for (const LasPoint& p : plan.points) {
    const std::size_t start = out.size();
    put(out, static_cast<std::int32_t>(std::lround((p.x - plan.x_offset) / plan.scale)));
    put(out, static_cast<std::int32_t>(std::lround((p.y - plan.y_offset) / plan.scale)));
    put(out, static_cast<std::int32_t>(std::lround((p.z - plan.z_offset) / plan.scale)));
    put(out, std::uint16_t{77});
    put(out, std::uint8_t{0x11});
    if (plan.format >= 6) {
      put(out, static_cast<std::uint8_t>(p.withheld ? 0x04 : 0));
      put(out, p.classification);
    } else {
      put(out, static_cast<std::uint8_t>((p.classification & 0x1f) | (p.withheld ? 0x80 : 0)));
    }
    out.resize(start + point_bytes, 0xee);
  }
  for (const auto& record : plan.extended_records) put_record(out, record, true);
  return out;
}

void write_las(const std::string& path, const LasPlan& plan) {
  const auto bytes = las_bytes(plan);
  std::ofstream out(path, std::ios::binary);
  out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
}

}  // namespace tind::test
