// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <vector>

#include "core/break_line.hpp"

namespace tind {

/// A chain and whether it is a lake's shore.
struct KindChain {
  BreakChain chain;
  bool is_shore = false;
};

/// Joins chains that meet in their ends where exactly two do, of one kind, first_level and weight: a road in a hundred
/// features, or a ring that was cut at its first vertex, is one chain again. The result depends on the set of chains
/// alone: each runs from its smaller end, rings that nothing else meets start at their smallest (x, y); ascending by
/// vertices. Precondition: chains meet in end vertices alone.
std::vector<KindChain> join_chains(std::vector<KindChain> chains);

}  // namespace tind
