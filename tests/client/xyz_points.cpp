// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/xyz_points.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cctype>
#include <optional>
#include <string>

namespace tind::client {
namespace {

/// Fields of a line. Commas and semicolons part fields that may be empty, blanks and tabs come in any number.
std::vector<std::string_view> split(std::string_view line) {
  const auto is_blank = [](char c) { return c == ' ' || c == '\t' || c == '\r'; };
  const char mark = line.find(',') != line.npos ? ',' : line.find(';') != line.npos ? ';' : ' ';
  std::vector<std::string_view> fields;
  std::size_t at = 0;
  const auto trimmed = [&](std::string_view field) {
    while (!field.empty() && (is_blank(field.front()) || field.front() == '"')) field.remove_prefix(1);
    while (!field.empty() && (is_blank(field.back()) || field.back() == '"')) field.remove_suffix(1);
    return field;
  };
  while (at < line.size()) {
    std::size_t end = at;
    while (end < line.size() && (mark == ' ' ? !is_blank(line[end]) : line[end] != mark)) ++end;
    if (mark != ' ' || end > at) fields.push_back(trimmed(line.substr(at, end - at)));
    at = end + 1;
  }
  return fields;
}

std::optional<double> number(std::string_view field) {
  if (!field.empty() && field.front() == '+') field.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), value);
  if (error != std::errc() || end != field.data() + field.size() || field.empty()) return std::nullopt;
  return value;
}

/// 0 x, 1 y, 2 z, -1 none of them.
int axis_of(std::string_view name) {
  std::string lower(name);
  std::transform(lower.begin(), lower.end(), lower.begin(), [](unsigned char c) { return std::tolower(c); });
  static constexpr std::array<std::array<const char*, 5>, 3> kNames = {{{"x", "lon", "longitude", "easting", "east"},
                                                                        {"y", "lat", "latitude", "northing", "north"},
                                                                        {"z", "elevation", "height", "h", "elev"}}};
  for (int axis = 0; axis < 3; ++axis) {
    for (const char* known : kNames[static_cast<std::size_t>(axis)]) {
      if (lower == known) return axis;
    }
  }
  return -1;
}

}  // namespace

Outcome<XyzPoints> read_xyz(std::string_view text) {
  XyzPoints points;
  std::array<std::size_t, 3> column = {0, 1, 2};
  bool first = true;
  std::size_t line_number = 0;
  if (text.substr(0, 3) == "\xef\xbb\xbf") text.remove_prefix(3);
  while (!text.empty()) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    const std::string_view line = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    ++line_number;
    const auto fields = split(line);
    const bool blank = std::all_of(fields.begin(), fields.end(), [](std::string_view f) { return f.empty(); });
    if (blank || fields.front().substr(0, 1) == "#") continue;
    if (first && !number(fields[0])) {
      std::array<bool, 3> found{};
      for (std::size_t k = 0; k < fields.size(); ++k) {
        const int axis = axis_of(fields[k]);
        if (axis < 0 || found[static_cast<std::size_t>(axis)]) continue;
        found[static_cast<std::size_t>(axis)] = true;
        column[static_cast<std::size_t>(axis)] = k;
      }
      if (!(found[0] && found[1] && found[2])) {
        return refuse(
            fmt::format("line {}: names no columns x, y, z (or lon, lat, elevation; easting, northing)", line_number));
      }
      first = false;
      continue;
    }
    first = false;
    std::array<double, 3> value{};
    for (std::size_t a = 0; a < 3; ++a) {
      const auto read = column[a] < fields.size() ? number(fields[column[a]]) : std::nullopt;
      if (!read) return refuse(fmt::format("line {}: column {} is no number", line_number, column[a] + 1));
      value[a] = *read;
    }
    points.x.push_back(value[0]);
    points.y.push_back(value[1]);
    points.z.push_back(value[2]);
  }
  return points;
}

}  // namespace tind::client
