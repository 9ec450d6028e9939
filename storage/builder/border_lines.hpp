// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
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

/// The stretch that has the side of a stored tile. `line` and `along` in tile sides of `level`.
RootEdge root_of(const Lattice& lattice, bool vertical, int level, std::int64_t line, std::int64_t along);

/// The tile whose middle line a stretch of level 1 or finer lies on.
TileKey parent_of(const Lattice& lattice, const RootEdge& root);

/// Refined border lines, found by the side of any stored tile. const access is thread safe.
class BorderLines {
 public:
  explicit BorderLines(const Lattice& lattice) : lattice_(lattice) {}

  /// Adds the vertices of one stretch, as refine_root_edge gives them, or puts them in the place of those before.
  void add(const RootEdge& root, std::vector<LineVertex> vertices);
  bool has(const RootEdge& root) const { return lines_.contains(key_of(root)); }
  /// All vertices of any level on the side of a stored tile. `line` and `along` in tile sides of `level`.
  std::span<const LineVertex> side(bool vertical, int level, std::int64_t line, std::int64_t along) const;
  /// The stretches that a stored tile's borders are cut out of, in ring order.
  static std::array<RootEdge, 4> roots_of(const Lattice& lattice, const TileKey& tile);
  /// Border b (ring order) of a tile, in stored direction.
  std::span<const LineVertex> border(const TileKey& tile, int b) const;

 private:
  using Key = std::tuple<bool, int, std::int64_t, std::int64_t>;
  static Key key_of(const RootEdge& root) { return {root.vertical, root.level, root.at, root.start}; }
  struct KeyHash {
    std::size_t operator()(const Key& k) const noexcept {
      const auto [vertical, level, at, start] = k;
      std::uint64_t h = static_cast<std::uint64_t>(at) * 0x9E3779B97F4A7C15ull + static_cast<std::uint64_t>(start);
      h ^= (static_cast<std::uint64_t>(level) * 2 + (vertical ? 1 : 0)) << 57;
      h = (h ^ h >> 32) * 0x9E3779B97F4A7C15ull;
      return std::hash<std::uint64_t>{}(h ^ h >> 29);
    }
  };
  const Lattice& lattice_;
  std::unordered_map<Key, std::vector<LineVertex>, KeyHash> lines_;
};

/// Sets border b (ring order) of a tile's task and its envelope. `part`: all vertices of any level on that side, in
/// stored direction; those of the tile's own level make the ring.
void set_border(const Lattice& lattice, std::span<const LineVertex> part, int b, TileTask& task);

}  // namespace tind
