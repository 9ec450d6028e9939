// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/join_chains.hpp"

#include <algorithm>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace tind {
namespace {

using ::testing::ElementsAre;
using Xs = std::vector<std::int64_t>;

/// A chain on a row of points; the height says which.
KindChain chain(std::initializer_list<std::int64_t> xs, bool is_shore = false, int first_level = 0) {
  KindChain out;
  for (const std::int64_t x : xs) out.chain.vertices.push_back({x, x * x % 7, static_cast<double>(x)});
  out.chain.first_level = first_level;
  out.is_shore = is_shore;
  return out;
}

std::vector<Xs> xs_of(const std::vector<KindChain>& chains) {
  std::vector<Xs> out;
  for (const KindChain& c : chains) {
    out.emplace_back();
    for (const BreakVertex& v : c.chain.vertices) {
      out.back().push_back(v.x);
      EXPECT_EQ(v.height_m, static_cast<double>(v.x));
    }
  }
  return out;
}

TEST(JoinChains, WhatMeetsTwoByTwoIsOneChain) {
  const auto joined = join_chains({chain({5, 4, 3}), chain({9, 7, 5}), chain({3, 1}), chain({20, 21})});
  EXPECT_THAT(xs_of(joined), ElementsAre(Xs{1, 3, 4, 5, 7, 9}, Xs{20, 21}));
}

TEST(JoinChains, NodesOfThreeStay) {
  const auto joined = join_chains({chain({1, 2, 3}), chain({3, 5}), chain({8, 3})});
  EXPECT_THAT(xs_of(joined), ElementsAre(Xs{1, 2, 3}, Xs{3, 5}, Xs{3, 8}));
}

TEST(JoinChains, OtherKindsStayApart) {
  EXPECT_EQ(join_chains({chain({1, 2}), chain({2, 3}, true)}).size(), 2U);
  EXPECT_EQ(join_chains({chain({1, 2}), chain({2, 3}, false, 4)}).size(), 2U);
  KindChain heavy = chain({2, 3});
  heavy.chain.weight = 9;
  EXPECT_EQ(join_chains({chain({1, 2}), heavy}).size(), 2U);
}

TEST(JoinChains, PiecesOfARingAreARingFromItsSmallestPoint) {
  EXPECT_THAT(xs_of(join_chains({chain({5, 3, 1, 9}), chain({5, 7, 9})})), ElementsAre(Xs{1, 3, 5, 7, 9, 1}));
  EXPECT_THAT(xs_of(join_chains({chain({5, 3, 1, 9, 5})})), ElementsAre(Xs{1, 3, 5, 9, 1}));
}

TEST(JoinChains, RingThatALineReachesStartsThere) {
  const auto joined = join_chains({chain({5, 3, 1, 9, 5}), chain({5, 30})});
  EXPECT_THAT(xs_of(joined), ElementsAre(Xs{5, 3, 1, 9, 5}, Xs{5, 30}));
}

TEST(JoinChains, OrderAndDirectionDoNotMatter) {
  std::vector<KindChain> chains{chain({1, 2}), chain({2, 3}), chain({3, 4}),
                                chain({3, 6}), chain({4, 9}), chain({6, 9})};
  const auto expected = xs_of(join_chains(chains));
  EXPECT_THAT(expected, ElementsAre(Xs{1, 2, 3}, Xs{3, 4, 9, 6, 3}));
  for (int i = 0; i < 20; ++i) {
    std::rotate(chains.begin(), chains.begin() + 1 + i % 3, chains.end());
    std::reverse(chains[2].chain.vertices.begin(), chains[2].chain.vertices.end());
    EXPECT_EQ(xs_of(join_chains(chains)), expected);
  }
}

TEST(JoinChains, NoChainsNoChains) { EXPECT_TRUE(join_chains({}).empty()); }

}  // namespace
}  // namespace tind
