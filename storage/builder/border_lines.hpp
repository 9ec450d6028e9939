// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <tuple>
#include <unordered_map>
#include <utility>
#include <vector>

#include "core/border_line.hpp"
#include "core/triangulator.hpp"

namespace tind {

/// Refined border lines, found by the side of any stored tile. const access is thread safe.
class BorderLines {
 public:
  explicit BorderLines(const Lattice& lattice) : lattice_(lattice) {}

  /// Adds the vertices of one stretch, as refine_root_edge gives them.
  void add(const RootEdge& root, std::vector<LineVertex> vertices);
  /// All vertices of any level on the side of a stored tile. `line` and `along` in tile sides of `level`.
  std::span<const LineVertex> side(bool vertical, int level, std::int64_t line, std::int64_t along) const;
  /// Border b (ring order) of a tile, in stored direction.
  std::span<const LineVertex> border(const TileKey& tile, int b) const;

 private:
  using Key = std::tuple<bool, int, std::int64_t, std::int64_t>;
  struct KeyHash {
    std::size_t operator()(const Key& k) const noexcept {
      const auto [vertical, level, line, along] = k;
      std::uint64_t h = morton_code(static_cast<std::uint32_t>(line), static_cast<std::uint32_t>(along));
      h ^= (static_cast<std::uint64_t>(level) * 2 + (vertical ? 1 : 0)) << 57;
      return std::hash<std::uint64_t>{}(h * 0x9E3779B97F4A7C15ull);
    }
  };
  const Lattice& lattice_;
  std::unordered_map<Key, std::vector<LineVertex>, KeyHash> lines_;
};

/// Sets border b (ring order) of a tile's task and its envelope. `part`: all vertices of any level on that side, in
/// stored direction; those of the tile's own level make the ring.
void set_border(const Lattice& lattice, std::span<const LineVertex> part, int b, TileTask& task);

}  // namespace tind
