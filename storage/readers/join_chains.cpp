// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/join_chains.hpp"

#include <algorithm>
#include <array>
#include <optional>
#include <tuple>
#include <utility>

namespace tind {
namespace {

using Vertices = std::vector<BreakVertex>;

bool before(const BreakVertex& a, const BreakVertex& b) { return std::tie(a.x, a.y) < std::tie(b.x, b.y); }
bool same_point(const BreakVertex& a, const BreakVertex& b) { return a.x == b.x && a.y == b.y; }
bool is_closed(const Vertices& v) { return same_point(v.front(), v.back()); }
bool lexicographic(const Vertices& a, const Vertices& b) {
  return std::lexicographical_compare(a.begin(), a.end(), b.begin(), b.end(), before);
}

/// One end of a chain: 0 its first vertex, 1 its last.
struct End {
  std::size_t chain = 0;
  std::size_t side = 0;
};

const BreakVertex& vertex(const std::vector<KindChain>& chains, const End& e) {
  const Vertices& v = chains[e.chain].chain.vertices;
  return e.side == 0 ? v.front() : v.back();
}

/// For each chain's ends the end that continues it.
using Links = std::vector<std::array<std::optional<End>, 2>>;

Links find_links(const std::vector<KindChain>& chains) {
  std::vector<End> ends;
  for (std::size_t i = 0; i < chains.size(); ++i) {
    ends.push_back({i, 0});
    ends.push_back({i, 1});
  }
  std::sort(ends.begin(), ends.end(), [&](const End& a, const End& b) {
    const BreakVertex &p = vertex(chains, a), &q = vertex(chains, b);
    return std::tie(p.x, p.y, a.chain, a.side) < std::tie(q.x, q.y, b.chain, b.side);
  });
  Links links(chains.size());
  for (std::size_t i = 0; i < ends.size();) {
    std::size_t next = i + 1;
    while (next < ends.size() && same_point(vertex(chains, ends[i]), vertex(chains, ends[next]))) ++next;
    const End a = ends[i], b = ends[next - 1];
    const KindChain &c = chains[a.chain], &d = chains[b.chain];
    if (next - i == 2 && a.chain != b.chain && c.is_shore == d.is_shore && c.chain.weight == d.chain.weight &&
        c.chain.first_level == d.chain.first_level) {
      links[a.chain][a.side] = b;
      links[b.chain][b.side] = a;
    }
    i = next;
  }
  return links;
}

/// A ring of several pieces starts at its smallest vertex; so does a ring that was one piece and that nothing meets.
void make_canonical(Vertices& v, bool is_free) {
  if (is_free && is_closed(v)) {
    v.pop_back();
    std::rotate(v.begin(), std::min_element(v.begin(), v.end(), before), v.end());
    v.push_back(v.front());
  }
  Vertices reversed(v.rbegin(), v.rend());
  if (lexicographic(reversed, v)) v = std::move(reversed);
}

}  // namespace

std::vector<KindChain> join_chains(std::vector<KindChain> chains) {
  const Links links = find_links(chains);
  std::vector<BreakVertex> nodes;  // ends of all chains
  for (const KindChain& c : chains) {
    nodes.push_back(c.chain.vertices.front());
    nodes.push_back(c.chain.vertices.back());
  }
  std::sort(nodes.begin(), nodes.end(), before);
  std::vector<bool> used(chains.size(), false);
  std::vector<KindChain> out;
  for (std::size_t i = 0; i < chains.size(); ++i) {
    if (used[i]) continue;
    // Back to where the chain begins, or around the ring to here.
    End start{i, 0};
    while (const auto& link = links[start.chain][start.side]) {
      start = {link->chain, 1 - link->side};
      if (start.chain == i) break;
    }
    KindChain joined{{{}, chains[i].chain.first_level, chains[i].chain.weight}, chains[i].is_shore};
    Vertices& v = joined.chain.vertices;
    std::size_t n_pieces = 0;
    for (std::optional<End> at = start; at && !used[at->chain]; ++n_pieces) {
      used[at->chain] = true;
      Vertices& piece = chains[at->chain].chain.vertices;
      if (at->side == 1) std::reverse(piece.begin(), piece.end());
      v.insert(v.end(), piece.begin() + (v.empty() ? 0 : 1), piece.end());
      at = links[at->chain][1 - at->side];
    }
    const auto [from, to] = std::equal_range(nodes.begin(), nodes.end(), v.front(), before);
    // Two ends at the first vertex are the ring's own.
    make_canonical(v, to - from == 2);
    out.push_back(std::move(joined));
  }
  std::sort(out.begin(), out.end(),
            [](const KindChain& a, const KindChain& b) { return lexicographic(a.chain.vertices, b.chain.vertices); });
  return out;
}

}  // namespace tind
