// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/doctor/piece_source.hpp"

#include <utility>

#include "storage/doctor/value_check.hpp"
#include "storage/piece_blob.hpp"

namespace tind {

std::optional<Corner> PieceSource::corner(const PieceKey& key) const {
  const auto value = snapshot.find(key.canonical());
  if (!value) return std::nullopt;
  const auto record = unpack_strictly(*value);
  if (!record) return std::nullopt;
  const auto corner = decode_corner(*record);
  return corner ? std::optional(*corner) : std::nullopt;
}

std::optional<EdgeChain> PieceSource::edge(const PieceKey& key) const {
  const auto value = snapshot.find(key.canonical());
  if (!value) return std::nullopt;
  const auto record = unpack_strictly(*value);
  if (!record) return std::nullopt;
  auto edge = decode_edge(*record);
  return edge ? std::optional(std::move(*edge)) : std::nullopt;
}

}  // namespace tind
