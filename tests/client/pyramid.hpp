// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <unordered_map>
#include <vector>

#include "tests/client/manifest_view.hpp"
#include "tests/client/tile.hpp"

namespace tind::client {

/// A tile in scope of the run. Index -1: there is none.
struct Node {
  TileId id;
  int coverage = 0;  ///< As the manifest's rows say.
  std::int32_t parent = -1;
  std::array<std::int32_t, 4> children{-1, -1, -1, -1};    ///< SW, SE, NW, NE: all four or none.
  std::array<std::int32_t, 4> neighbours{-1, -1, -1, -1};  ///< Same level, beyond border b; x wraps.
  std::unique_ptr<Tile> tile;                              ///< Null until fetched, or when it could not be read.

  bool splittable() const { return children[0] >= 0; }
};

/// The tiles that a run looks at: all that are stored, or a sample that is closed under parents and siblings. Nodes are
/// sorted by level, then Morton order. Filled in once; after that const access is thread safe.
class Pyramid {
 public:
  /// Takes every stored tile, or a seeded sample: random tiles with their ancestors and siblings until `fraction` is
  /// reached.
  Pyramid(const ManifestView& manifest, double fraction, std::uint64_t seed);

  std::vector<Node>& nodes() { return nodes_; }
  const std::vector<Node>& nodes() const { return nodes_; }
  const Node& node(std::int32_t index) const { return nodes_[static_cast<std::size_t>(index)]; }
  std::int32_t find(const TileId& id) const;
  const LatticeFrame& frame() const { return frame_; }
  int bottom_level() const { return bottom_level_; }
  /// A fraction below 1 was asked for: totals cannot be compared with the manifest.
  bool is_sample() const { return is_sample_; }

  /// Drops the children of nodes where one of them could not be read: the cuts then treat the node as undivided.
  void unlink_unread();

  /// The line that finer tiles form along border b of node `from` when the node `beyond` at the other side (same level)
  /// is divided as `split` says: stored direction, t in steps from the W or S end of `from`'s side, every joint of two
  /// tiles once. `split(index)`: true iff that node is divided; asked only for nodes that have children.
  template <class Split>
  std::vector<SideVertex> line_beyond(const Node& from, int b, std::int32_t beyond, const Split& split) const {
    std::vector<SideVertex> line;
    append_line(from, b, beyond, split, line);
    return line;
  }

 private:
  template <class Split>
  void append_line(const Node& from, int b, std::int32_t index, const Split& split,
                   std::vector<SideVertex>& line) const {
    // Children that touch the border facing `from`, which is the opposite of b, in stored direction.
    static constexpr int kFacing[4][2] = {{2, 3}, {0, 2}, {0, 1}, {1, 3}};
    const Node& n = node(index);
    if (n.splittable() && split(index)) {
      for (const int c : kFacing[b]) append_line(from, b, n.children[static_cast<std::size_t>(c)], split, line);
      return;
    }
    const bool vertical = b == 1 || b == 3;
    const std::int64_t offset =
        vertical ? frame_.origin_y(n.id) - frame_.origin_y(from.id) : frame_.origin_x(n.id) - frame_.origin_x(from.id);
    auto side = stored_side(*n.tile, (b + 2) % 4);
    for (auto& v : side) v.t += offset;
    const bool joined = !line.empty() && line.back().t == side.front().t && line.back().z == side.front().z &&
                        line.back().entry == side.front().entry;
    line.insert(line.end(), side.begin() + (joined ? 1 : 0), side.end());
  }

  LatticeFrame frame_;
  int bottom_level_ = 0;
  bool is_sample_ = false;
  std::vector<Node> nodes_;
  std::unordered_map<std::uint64_t, std::int32_t> index_;
};

}  // namespace tind::client
