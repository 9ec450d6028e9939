// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "tests/client/pyramid.hpp"

namespace tind::client {

/// A quadtree cut of the globe: both roots, and every divided node divided into its four children.
struct Cut {
  std::string kind;                 ///< How it was made, for messages.
  std::vector<std::uint8_t> split;  ///< Per node: 1 iff divided. Set only where all ancestors are divided too.
  std::vector<std::int32_t> leaves;
};

/// Cut number `index` of a run: the same for the same seed. The first few are adversarial (everything divided; nothing
/// divided; a deepest tile alone amid the coarsest possible neighbours; one side of a line deep, the other not), the
/// others random with strongly mixed levels, biased so that tiles with data get deep.
Cut plan_cut(const Pyramid& pyramid, std::uint64_t seed, int index);

}  // namespace tind::client
