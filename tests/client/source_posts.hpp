// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "tests/client/byte_cursor.hpp"

namespace tind::client {

/// What the user may say about the sources; what is absent comes from the files.
struct SourceOptions {
  std::optional<double> nodata;
  std::optional<double> metres_per_unit;
};

/// The source's own posts, read anew from its files: a post is a cell's centre. Row 0 is the southernmost, column 0 the
/// westernmost; row-major. Heights in metres, NaN where there is no post.
struct SourcePosts {
  double west_deg = 0, south_deg = 0;  ///< Post (0, 0).
  double lon_spacing_deg = 0, lat_spacing_deg = 0;
  std::int64_t n_rows = 0, n_cols = 0;
  std::vector<float> heights_m;
  /// Where several sources (or both ends of a grid that closes around the globe) hold different values: row * n_cols +
  /// column -> the values beside the one in heights_m.
  std::unordered_map<std::int64_t, std::vector<float>> other_values;
  double disagreement_m = 0;  ///< Largest distance of two values of one post.
  bool rounded = false;       ///< A value in metres was not a float; heights_m is off by up to half an ulp.
  std::uint64_t n_posts = 0;  ///< Posts with a height.
  std::vector<std::string> names;

  double longitude_deg(std::int64_t column) const { return west_deg + static_cast<double>(column) * lon_spacing_deg; }
  double latitude_deg(std::int64_t row) const { return south_deg + static_cast<double>(row) * lat_spacing_deg; }
};

/// Reads one or more rasters (any that GDAL opens; a .zip is looked into) that share one grid. Band 1; unit, scale,
/// offset and nodata from the file unless `options` say otherwise. The only code of the client that uses GDAL.
Outcome<SourcePosts> read_source_posts(const std::vector<std::string>& paths, const SourceOptions& options);

}  // namespace tind::client
