// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/result.hpp"

namespace tind {

/// A line for the user to look at.
struct OutputLine {
  std::vector<std::array<double, 3>> vertices;  ///< Longitude, latitude in degrees, height in metres; at least 2.
  std::string kind;                             ///< "stream", "shore" or "breakline".
  std::optional<int> strahler;                  ///< Streams: Strahler order.
  std::optional<double> area_km2;               ///< Streams: drained area.
  int first_level = 0;                          ///< The coarsest level that draws the line.
};

struct OutputLayer {
  std::string name;  ///< Not empty, unique in its file, for example "level_10".
  std::vector<OutputLine> lines;
};

/// Writes a GeoPackage with a LineString Z layer (EPSG:4326) for each of `layers` and the fields kind, strahler,
/// area_km2, first_level; QGIS opens it as it is. Same layers, same bytes (with one version of GDAL): the time of
/// change in it is fixed. The file appears under its name when it is complete; a leftover of an interrupted run is
/// overwritten. With `force` an existing file is replaced. kInvalidInput: `path` does not end in .gpkg, exists (without
/// force), or a layer's name is empty or taken. kIo: GDAL cannot write there.
Result<void> write_lines(const std::string& path, std::span<const OutputLayer> layers, bool force);

}  // namespace tind
