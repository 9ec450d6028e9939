// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <optional>
#include <string>

#include "core/format/bytes.hpp"
#include "core/result.hpp"

namespace tind {

/// A file that may be served.
struct StaticFile {
  std::string path;   ///< Canonical, below the root.
  std::string stamp;  ///< Changes with the file: size and time of modification.
  const char* content_type;
  bool compressible;
};

/// Looks up `relative` (a CesiumRoute's path) below `root` (canonical). nullopt: no such regular file, or a link that
/// leads outside.
std::optional<StaticFile> find_static_file(const std::string& root, const std::string& relative);

/// All bytes of a file found before. kIo when it cannot be read any more.
Result<Bytes> read_static_file(const StaticFile& file);

}  // namespace tind
