// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/doctor/line_checks.hpp"

#include <fmt/format.h>

namespace tind {

namespace {

bool is_horizontal(const PieceKey& key) { return key.kind == PieceKind::kEdgeH; }

PieceKey corner_at(const PieceKey& edge, bool is_end) {
  const bool h = is_horizontal(edge);
  return {PieceKind::kCorner, edge.level, edge.i + (is_end && h ? 1u : 0u), edge.j + (is_end && !h ? 1u : 0u)};
}

// True iff the line is a tile side at the level above, too. Precondition: level > 0.
bool has_edge_above(const PieceKey& key) { return (is_horizontal(key) ? key.j : key.i) % 2 == 0; }

PieceKey edge_above(const PieceKey& key) {
  return {key.kind, static_cast<std::uint8_t>(key.level - 1), key.i / 2, key.j / 2};
}

// Half `half` of an edge, one level deeper.
PieceKey edge_below(const PieceKey& key, std::uint32_t half) {
  const bool h = is_horizontal(key);
  return {key.kind, static_cast<std::uint8_t>(key.level + 1), 2 * key.i + (h ? half : 0), 2 * key.j + (h ? 0 : half)};
}

std::string vertex_text(std::int64_t t, std::int32_t z, int entry) {
  return fmt::format("(t {}, z {}, entry {})", t, z, entry);
}

class EdgeCheck {
 public:
  EdgeCheck(const PieceSource& pieces, const PieceKey& key) : pieces_(pieces), key_(key) {}

  Faults run() {
    const auto edge = pieces_.edge(key_);
    if (!edge) return {};
    edge_ = *edge;
    side_ = pieces_.lattice().tile_side(key_.level);
    if (!edge_.inner.empty() && edge_.inner.back().t >= side_) {
      fault(fmt::format("its last vertex is {} steps along a side of {}", edge_.inner.back().t, side_));
      return std::move(faults_);
    }
    check_pole();
    if (key_.level == 0 || !has_edge_above(key_)) {
      check_first();
    } else if (const auto above = pieces_.edge(edge_above(key_))) {
      check_nested(*above);
    } else if (!pieces_.has(edge_above(key_))) {
      fault("the edge above it on its line is missing");
    }
    return std::move(faults_);
  }

 private:
  void fault(std::string what) { faults_.push_back({name_of(key_), std::move(what)}); }

  void check_pole() {
    const bool is_pole = is_horizontal(key_) && (key_.j == 0 || key_.j == TileKey::count_y(key_.level));
    const auto pole = is_pole ? pieces_.corner(corner_at(key_, false)) : std::nullopt;
    if (!pole) return;
    for (const EdgeVertex& v : edge_.inner) {
      if (v.z == pole->z) continue;
      return fault(fmt::format("lies along a pole of height {}, but has a vertex of height {}", pole->z, v.z));
    }
  }

  // No level above has the line: all its vertices enter here.
  void check_first() {
    const auto check = [&](std::uint8_t entry, const std::string& whose) {
      if (entry != key_.level && faults_.empty()) {
        fault(fmt::format("{} has entry level {} on a line that begins at level {}", whose, entry, key_.level));
      }
    };
    check(edge_.start_entry, "its start corner");
    for (const EdgeVertex& v : edge_.inner) check(v.entry, "a vertex");
    check(edge_.end_entry, "its end corner");
  }

  // This edge is half of `above`.
  void check_nested(const EdgeChain& above) {
    const std::uint32_t half = (is_horizontal(key_) ? key_.i : key_.j) % 2;
    const std::int64_t offset = half * side_;
    std::vector<EdgeVertex> expected;
    std::optional<EdgeVertex> middle;
    for (EdgeVertex v : above.inner) {
      if (v.t == side_) middle = v;
      v.t -= offset;
      if (v.t > 0 && v.t < side_) expected.push_back(v);
    }
    std::size_t next = 0;
    for (const EdgeVertex& v : edge_.inner) {
      if (v.entry == key_.level) continue;
      if (next < expected.size() && v == expected[next]) {
        ++next;
        continue;
      }
      return fault(fmt::format("its vertex {} is not on the line at level {}, which has {} there",
                               vertex_text(v.t, v.z, v.entry), key_.level - 1,
                               next < expected.size()
                                   ? vertex_text(expected[next].t, expected[next].z, expected[next].entry)
                                   : "no further one"));
    }
    if (next < expected.size()) {
      const EdgeVertex& v = expected[next];
      return fault(fmt::format("it lacks the vertex {} that the line has at level {}", vertex_text(v.t, v.z, v.entry),
                               key_.level - 1));
    }
    check_end(false, half == 0, above.start_entry, edge_.start_entry, middle);
    check_end(true, half == 1, above.end_entry, edge_.end_entry, middle);
  }

  // One of the two corners: an end of the edge above, or in the middle of it.
  void check_end(bool is_end, bool is_outer, std::uint8_t entry_above, std::uint8_t entry,
                 const std::optional<EdgeVertex>& middle) {
    const char* const name = is_end ? "end" : "start";
    const int expected = is_outer ? entry_above : middle ? middle->entry : key_.level;
    if (entry != expected) {
      fault(fmt::format("its {} corner has entry level {}, but {} on the line at level {}", name, entry, expected,
                        key_.level - 1));
    }
    const auto corner = pieces_.corner(corner_at(key_, is_end));
    std::optional<std::int32_t> z;
    if (is_outer) {
      if (const auto above = pieces_.corner(corner_at(edge_above(key_), is_end))) z = above->z;
    } else if (middle) {
      z = middle->z;
    }
    if (corner && z && corner->z != *z) {
      faults_.push_back(
          {name_of(corner_at(key_, is_end).canonical()),
           fmt::format("its height is {}, on the line at level {} it is {}", corner->z, key_.level - 1, *z)});
    }
  }

  const PieceSource& pieces_;
  PieceKey key_;
  EdgeChain edge_;
  std::int64_t side_ = 0;
  Faults faults_;
};

// Appends the vertices strictly inside `key`, `offset` added to their places. False: a piece does not decode.
bool append_finest(const PieceSource& pieces, const PieceKey& key, std::int64_t offset, std::vector<LinePoint>& out) {
  const auto edge = pieces.edge(key);
  if (!edge) return false;
  const bool is_deepest = key.level >= pieces.manifest.bottom_level;
  const std::int64_t half_side = is_deepest ? 0 : pieces.lattice().tile_side(key.level + 1);
  const bool has_half[2] = {!is_deepest && pieces.has(edge_below(key, 0)),
                            !is_deepest && pieces.has(edge_below(key, 1))};
  const auto append_own = [&](std::int64_t first, std::int64_t behind) {
    for (const EdgeVertex& v : edge->inner) {
      if (v.t >= first && v.t < behind) out.push_back({offset + v.t, v.entry});
    }
  };
  if (!has_half[0] && !has_half[1]) {
    append_own(0, pieces.lattice().tile_side(key.level));
    return true;
  }
  const std::uint32_t known = has_half[0] ? 0 : 1;
  const auto neighbour = pieces.edge(edge_below(key, known));
  if (!neighbour) return false;
  for (std::uint32_t half = 0; half < 2; ++half) {
    if (half == 1) out.push_back({offset + half_side, known == 0 ? neighbour->end_entry : neighbour->start_entry});
    if (!has_half[half]) {
      append_own(half == 0 ? 0 : half_side + 1, half == 0 ? half_side : 2 * half_side);
    } else if (!append_finest(pieces, edge_below(key, half), offset + half * half_side, out)) {
      return false;
    }
  }
  return true;
}

}  // namespace

Faults check_edge(const PieceSource& pieces, const PieceKey& key) { return EdgeCheck(pieces, key.canonical()).run(); }

std::optional<std::vector<LinePoint>> finest_line(const PieceSource& pieces, const PieceKey& key) {
  std::vector<LinePoint> points;
  if (!append_finest(pieces, key.canonical(), 0, points)) return std::nullopt;
  return points;
}

}  // namespace tind
