// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/tile_rows.hpp"

#include <algorithm>

namespace tind {
namespace {

using Runs = std::vector<TileRun>;

bool in_order(const TileRun& a, const TileRun& b) { return a.y != b.y ? a.y < b.y : a.x_first < b.x_first; }

// Appends what of `run` is in none of `others`, which are sorted.
void append_without(const TileRun& run, const Runs& others, Runs& out) {
  auto other = std::lower_bound(others.begin(), others.end(), run, [](const TileRun& a, const TileRun& b) {
    return a.y != b.y ? a.y < b.y : a.x_last < b.x_first;
  });
  TileRun rest = run;
  for (; other != others.end() && other->y == run.y && other->x_first <= run.x_last; ++other) {
    if (other->x_first > rest.x_first) {
      out.push_back(rest);
      out.back().x_last = other->x_first - 1;
    }
    if (other->x_last >= run.x_last) return;
    rest.x_first = std::max(rest.x_first, other->x_last + 1);
  }
  out.push_back(rest);
}

}  // namespace

TileRows rows_of(const Manifest& manifest) {
  TileRows rows;
  for (const LevelInfo& level : manifest.levels) rows.push_back(level.rows);
  return rows;
}

bool has_tile(const TileRows& rows, const TileKey& key) {
  if (!key.valid() || key.level >= rows.size()) return false;
  const Runs& runs = rows[key.level];
  const auto after = std::upper_bound(runs.begin(), runs.end(), key, [](const TileKey& k, const TileRun& run) {
    return k.y != run.y ? k.y < run.y : k.x < run.x_first;
  });
  return after != runs.begin() && (after - 1)->y == key.y && key.x <= (after - 1)->x_last;
}

TileRows own_rows(const Manifest& manifest, const TileRows& base) {
  TileRows own(manifest.levels.size());
  const Runs none;
  for (std::size_t level = 0; level < own.size(); ++level) {
    for (const TileRun& run : manifest.levels[level].rows) {
      if (run.coverage == TileCoverage::kReal) own[level].push_back(run);
      if (run.coverage == TileCoverage::kPartial)
        append_without(run, level < base.size() ? base[level] : none, own[level]);
    }
  }
  return own;
}

TileRows join_rows(const TileRows& first, const TileRows& second) {
  TileRows joined = first;
  joined.resize(std::max(first.size(), second.size()));
  for (std::size_t level = 0; level < second.size(); ++level) {
    const Runs before = joined[level];
    for (const TileRun& run : second[level]) append_without(run, before, joined[level]);
    std::sort(joined[level].begin(), joined[level].end(), in_order);
  }
  return joined;
}

}  // namespace tind
