// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>
#include <vector>

#include "tests/client/source_posts.hpp"

namespace tind::client {

/// By its name: .las, .laz, .xyz, .csv or .txt.
bool is_point_file(const std::string& path);

/// Reads the points of all files and keeps, of those that round to one position of the claim's lattice, the lowest one.
Outcome<SourcePosts> read_points(const std::vector<std::string>& paths, const SourceOptions& options,
                                 const GridClaim& claim);

}  // namespace tind::client
