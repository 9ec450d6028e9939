// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "storage/doctor/fault.hpp"
#include "storage/doctor/piece_source.hpp"

namespace tind {

/// A vertex of a border line: lattice steps from the start of some edge, and its entry level.
struct LinePoint {
  std::int64_t t = 0;
  std::uint8_t entry = 0;
};

/// What docs/format.md 1, 4 and 5 say of one stored edge: places ascend inside the side; entry levels; along a pole all
/// heights equal; and, where the edge above it on the same line is stored, the vertices of both are the same but for
/// those that entered at this level, corners included. Nothing about pieces that are missing or do not decode: they are
/// found elsewhere.
Faults check_edge(const PieceSource& pieces, const PieceKey& key);

/// All vertices strictly inside an edge that its line has at this level or a deeper stored one, ascending. nullopt: a
/// piece does not decode.
std::optional<std::vector<LinePoint>> finest_line(const PieceSource& pieces, const PieceKey& key);

}  // namespace tind
