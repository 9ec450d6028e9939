// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/assembler.hpp"

#include <functional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace tind {
namespace {

using testing::ElementsAre;

constexpr TileKey kKey{1, 2, 1};
constexpr std::int64_t kSide = 65536;

Lattice lattice() {
  Lattice lattice;
  lattice.level = 1;
  return lattice;
}

TilePieces sound_pieces() {
  TilePieces p;
  p.corners = {Corner{10}, Corner{20}, Corner{30}, Corner{40}};
  p.edges[0] = {0, 1, {{100, 1, 1}, {200, 2, 0}}};
  p.edges[1] = {1, 0, {{300, 3, 1}}};
  p.edges[2] = {1, 0, {{400, 4, 0}, {500, 5, 1}}};  // stored W->E
  p.edges[3] = {0, 1, {{600, 6, 1}, {700, 7, 0}}};  // stored S->N
  p.body.n_side = {2, 1, 2, 2};
  p.body.interior = {{1000, 2000, 50}};
  for (std::uint32_t k = 0; k < 11; ++k) p.body.triangles.push_back({k, (k + 1) % 11, 11});
  p.body.virtual_triangles = {{0, 1, 0, 0, {}}};
  p.body.stats.n_posts = 9;
  return p;
}

TEST(Assembler, PutsTheRingInLocalOrderAndTurnsNorthAndWest) {
  const auto node = assemble(lattice(), kKey, sound_pieces());
  ASSERT_TRUE(node) << node.error().message;
  EXPECT_THAT(node->vertices,
              ElementsAre(LocalVertex{0, 0, 10}, LocalVertex{100, 0, 1}, LocalVertex{200, 0, 2},
                          LocalVertex{kSide, 0, 20}, LocalVertex{kSide, 300, 3}, LocalVertex{kSide, kSide, 30},
                          LocalVertex{500, kSide, 5}, LocalVertex{400, kSide, 4}, LocalVertex{0, kSide, 40},
                          LocalVertex{0, 700, 7}, LocalVertex{0, 600, 6}, LocalVertex{1000, 2000, 50}));
  EXPECT_THAT(node->side_entries[0], ElementsAre(0, 1, 0, 1));
  EXPECT_THAT(node->side_entries[1], ElementsAre(1, 1, 0));
  EXPECT_THAT(node->side_entries[2], ElementsAre(0, 1, 0, 1));
  EXPECT_THAT(node->side_entries[3], ElementsAre(1, 0, 1, 0));
  EXPECT_EQ(node->key, kKey);
  EXPECT_EQ(node->stats.n_posts, 9u);
  EXPECT_EQ(node->triangles.size(), 11u);
  EXPECT_EQ(node->virtual_triangles.size(), 1u);
}

TEST(Assembler, RefusesPiecesThatDoNotFit) {
  const std::vector<std::pair<std::string, std::function<void(TilePieces&)>>> hostile = {
      {"edge shorter than the body says", [](auto& p) { p.edges[2].inner.pop_back(); }},
      {"body counts more than the edge has", [](auto& p) { p.body.n_side[3] = 0xffffffff; }},
      {"edge vertex on the corner", [](auto& p) { p.edges[0].inner.front().t = 0; }},
      {"edge vertex beyond the side", [](auto& p) { p.edges[1].inner.back().t = kSide; }},
      {"edge vertices out of order", [](auto& p) { std::swap(p.edges[3].inner[0].t, p.edges[3].inner[1].t); }},
      {"edge vertices at one point", [](auto& p) { p.edges[2].inner[1].t = p.edges[2].inner[0].t; }},
      {"interior vertex on the border", [](auto& p) { p.body.interior[0].x = 0; }},
      {"interior vertex outside", [](auto& p) { p.body.interior[0].y = kSide + 5; }},
      {"interior vertex far outside", [](auto& p) { p.body.interior[0].y = std::int64_t{-1} << 60; }},
      {"triangle index too high", [](auto& p) { p.body.triangles[4][1] = 12; }},
      {"virtual triangle without a triangle", [](auto& p) { p.body.virtual_triangles[0].triangle = 11; }},
      {"virtual triangle beyond its border", [](auto& p) { p.body.virtual_triangles[0].interval = 3; }},
  };
  for (const auto& [name, damage] : hostile) {
    TilePieces pieces = sound_pieces();
    damage(pieces);
    const auto node = assemble(lattice(), kKey, std::move(pieces));
    ASSERT_FALSE(node) << name;
    EXPECT_EQ(node.error().kind, ErrorKind::kCorrupt) << name;
    EXPECT_NE(node.error().message.find("1/2/1"), std::string::npos) << node.error().message;
  }
  EXPECT_FALSE(assemble(lattice(), {2, 0, 0}, sound_pieces()));  // below the lattice
  EXPECT_FALSE(assemble(lattice(), {1, 4, 0}, sound_pieces()));
}

}  // namespace
}  // namespace tind
