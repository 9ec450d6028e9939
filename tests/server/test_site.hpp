// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

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

/// Writes a pyramid of levels 0 and 1 (ten tiles, all stored). Every side has `n_side` inner vertices, every tile one
/// interior vertex. The body of tile `changed` is another than it would be without.
void write_pyramid(const std::string& path, std::uint32_t n_side = 60, std::optional<TileKey> changed = std::nullopt);

/// Writes some files that pass for CesiumJS, and one outside of it at `directory`/secret.txt.
std::string write_cesium(const std::string& directory);

}  // namespace tind::test
