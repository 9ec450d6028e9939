// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "server/site.hpp"

namespace tind::test {

/// A directory that goes away with the object.
struct TemporaryDirectory {
  std::string path;
  TemporaryDirectory();
  ~TemporaryDirectory();
  TemporaryDirectory(const TemporaryDirectory&) = delete;
  TemporaryDirectory& operator=(const TemporaryDirectory&) = delete;
};

/// Writes a pyramid with all tiles of `n_levels` levels (two: ten tiles). Every side has `n_side` inner vertices, every
/// tile one interior vertex. The body of tile `changed` is another than it would be without. `coverage`: of each tile;
/// without it all are real.
void write_pyramid(const std::string& path, std::uint32_t n_side = 60, std::optional<TileKey> changed = std::nullopt,
                   int n_levels = 2, const std::function<TileCoverage(const TileKey&)>& coverage = {});

/// Writes some files that pass for CesiumJS, and one outside of it at `directory`/secret.txt.
std::string write_cesium(const std::string& directory);

}  // namespace tind::test
