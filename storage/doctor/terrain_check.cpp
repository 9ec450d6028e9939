// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/doctor/terrain_check.hpp"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <vector>

namespace tind {
namespace {

constexpr std::uint32_t kMostSteps = 32767;
constexpr std::uint32_t kShortIndexVertices = 65536;

// A delta chain. A value outside 0..32767 fails the reader.
std::vector<std::uint32_t> read_chain(ByteReader& in, std::uint32_t n) {
  std::vector<std::uint32_t> values(n);
  std::int64_t value = 0;
  for (std::uint32_t& out : values) {
    const auto code = in.fixed<std::uint16_t>();
    value += (code >> 1) ^ -(code & 1);
    if (value < 0 || value > kMostSteps) {
      in.set_failed();
      return {};
    }
    out = static_cast<std::uint32_t>(value);
  }
  return values;
}

std::uint32_t read_index(ByteReader& in, bool is_long) {
  return is_long ? in.fixed<std::uint32_t>() : in.fixed<std::uint16_t>();
}

}  // namespace

std::string find_terrain_fault(ByteView tile, std::uint64_t n_triangles) {
  ByteReader in(tile);
  std::array<double, 10> head{};  // center, sphere and its radius, occlusion point
  for (std::size_t k = 0; k < 3; ++k) head[k] = in.fixed<double>();
  const auto minimum = in.fixed<float>(), maximum = in.fixed<float>();
  for (std::size_t k = 3; k < head.size(); ++k) head[k] = in.fixed<double>();
  for (const double v : head) {
    if (!std::isfinite(v)) return "its header has a number that is none";
  }
  if (!std::isfinite(minimum) || !std::isfinite(maximum) || minimum > maximum) return "its height range is none";
  const auto n = in.fixed<std::uint32_t>();
  if (n == kShortIndexVertices) return "it has exactly 65,536 vertices, which CesiumJS cannot read";
  const bool is_long = n > kShortIndexVertices;
  if (!in.ok() || n < 4 || n > in.remaining() / 6) return fmt::format("it cannot have {} vertices", n);
  const auto u = read_chain(in, n), v = read_chain(in, n), h = read_chain(in, n);
  if (!in.ok()) return "a vertex lies outside the tile";
  if (is_long) in.raw((4 - in.position() % 4) % 4);
  const auto n_read = in.fixed<std::uint32_t>();
  // Rounding positions takes triangles away, never adds one.
  if (n_read == 0 || n_read > n_triangles) return fmt::format("it has {} triangles, the body {}", n_read, n_triangles);
  std::uint32_t highest = 0;
  for (std::uint64_t k = 0; k < 3 * std::uint64_t{n_read}; ++k) {
    const std::uint32_t code = read_index(in, is_long);
    if (!in.ok() || code > highest || highest - code >= n) return fmt::format("triangle {} names no vertex", k / 3);
    if (code == 0) ++highest;
  }
  constexpr std::array<const char*, 4> kNames = {"west", "south", "east", "north"};
  for (std::size_t b = 0; b < 4; ++b) {
    const auto n_border = in.fixed<std::uint32_t>();
    if (n_border < 2) return fmt::format("its {} border has {} vertices", kNames[b], n_border);
    const auto& across = b % 2 == 0 ? u : v;
    const auto& along = b % 2 == 0 ? v : u;
    const std::uint32_t line = b < 2 ? 0 : kMostSteps;
    std::uint32_t before = 0;
    for (std::uint32_t k = 0; k < n_border; ++k) {
      const std::uint32_t index = read_index(in, is_long);
      if (!in.ok() || index >= n || across[index] != line || along[index] < before) {
        return fmt::format("its {} border has a vertex that is not there", kNames[b]);
      }
      before = along[index];
    }
  }
  return in.finished() ? "" : "it has bytes behind the borders";
}

}  // namespace tind
